"""Record what the embedded robot perceives: Driven -> Run, with the noise that robot.yaml states."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import shapely

from logs.run import OccupancyMap, RangeSensor, Run
from planners.arena import Arena, Floats, wrap
from sensorgraph.world.drive import Driven, odometry
from sensorgraph.world.raycast import Hits, cast, cast_rays, laser_poses
from sensorgraph.world.robot_file import RobotFile

EPOCH_NS = 1_704_067_200_000_000_000
"""[ns] 2024-01-01T00:00:00Z, when every simulated run starts: the same seed gives the same bytes."""
BLOCK = 1000  # scans cast between two ticks of the progress

Progress = Callable[[int, int], None]


def scan_stamps(driven: Driven, sensor: RangeSensor) -> Floats:
    """Return the stamps (n_scans,) [s] of the first rays, at the sensor's rate; the last sweep ends in the run."""
    return np.arange(0.0, driven.stamps[-1] - sensor.sweep_time + 1e-9, 1.0 / sensor.rate)


def perceive(
    driven: Driven, arena: Arena, sensor: RangeSensor, stamps: Floats, *, progress: Progress | None = None
) -> Hits:
    """Cast ideal scans taken at stamps (n_scans,) [s]; with a sweep every ray has its own time and pose."""
    parts = []
    for start in range(0, len(stamps), BLOCK):
        some = stamps[start : start + BLOCK]
        parts.append(
            _swept(driven, arena, sensor, some)
            if sensor.sweep_time > 0
            else cast(arena, driven.at(some), sensor)
        )
        if progress is not None:
            progress(start + len(some), len(stamps))
    return Hits(
        ranges=np.concatenate([hits.ranges for hits in parts]),
        incidence=np.concatenate([hits.incidence for hits in parts]),
        wall=np.concatenate([hits.wall for hits in parts]),
    )


def measure(ranges: Floats, sensor: RangeSensor, rng: np.random.Generator) -> Floats:
    """Turn ideal ranges (n_scans, n_rays) into readings: noise, resolution, limits (REP-117)."""
    hit = np.isfinite(ranges)
    noise = rng.normal(size=ranges.shape) * sensor.sigma
    readings = np.where(hit, ranges + noise, ranges)
    if sensor.resolution > 0:
        readings = np.round(readings / sensor.resolution) * sensor.resolution
    readings = np.where(hit & (readings > sensor.range_max), np.inf, readings)
    return np.where(hit & (readings < sensor.range_min), -np.inf, readings)


def simulate(
    driven: Driven,
    arena: Arena,
    robot: RobotFile,
    *,
    rng: np.random.Generator,
    meta: Mapping[str, str] | None = None,
    attachments: Mapping[str, bytes] | None = None,
    progress: Progress | None = None,
) -> Run:
    """Log a drive as the robot would: scans, reference poses, odometry and commands, each at its own rate."""
    sensor = robot.sensor
    stamps = scan_stamps(driven, sensor)
    hits = perceive(driven, arena, sensor, stamps, progress=progress)
    ranges = measure(hits.ranges, sensor, rng)
    pose_stamps = np.append(np.arange(0.0, driven.stamps[-1], 1.0 / robot.pose.rate), driven.stamps[-1])
    sigma = [robot.pose.sigma_xy, robot.pose.sigma_xy, robot.pose.sigma_yaw]
    poses = driven.at(pose_stamps) + rng.normal(size=(len(pose_stamps), 3)) * sigma
    odom_stamps, odom_poses, odom_twists = odometry(driven, robot, rng)
    return Run(
        sensor=sensor,
        stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
        odom_stamps=odom_stamps,
        odometry=odom_poses,
        odom_twists=odom_twists,
        cmd_stamps=driven.cmd_stamps,
        commands=driven.commands,
        epoch_ns=EPOCH_NS,
        meta=dict(meta or {}),
        attachments=dict(attachments or {}),
    )


def occupancy(arena: Arena, *, resolution: float = 0.05, most: int = 4_000_000) -> OccupancyMap:
    """Rasterise an arena for /map: free 0, crossed by a wall 100, elsewhere unknown -1.

    The resolution [m] is made coarser where the grid would have more than `most` cells.
    """
    x0, y0, x1, y1 = arena.bounds
    resolution = max(resolution, float(np.sqrt((x1 - x0) * (y1 - y0) / most)))
    x0, y0 = x0 - 2 * resolution, y0 - 2 * resolution
    nx, ny = int((x1 - x0) / resolution) + 3, int((y1 - y0) / resolution) + 3
    x, y = np.meshgrid(x0 + (np.arange(nx) + 0.5) * resolution, y0 + (np.arange(ny) + 0.5) * resolution)
    shapely.prepare(arena.free)
    data = np.where(arena.contains(np.stack([x, y], axis=-1)), 0, -1).astype(np.int8)  # (ny, nx)
    for a, b in arena.walls:
        n = int(np.hypot(*(b - a)) / resolution * 4) + 2
        points = a + np.linspace(0, 1, n)[:, None] * (b - a)
        column, row = ((points - [x0, y0]) / resolution).astype(np.intp).T
        data[row.clip(0, ny - 1), column.clip(0, nx - 1)] = 100
    return OccupancyMap(data=data, resolution=resolution, origin=np.array([x0, y0, 0.0]))


def _swept(driven: Driven, arena: Arena, sensor: RangeSensor, stamps: Floats) -> Hits:
    """Cast scans whose ray i is taken at stamp + sweep_time i / n_rays."""
    late = sensor.sweep_time * np.arange(sensor.n_rays) / sensor.n_rays
    poses = driven.at(stamps[:, None] + late)  # (n_scans, n_rays, 3)
    lasers = laser_poses(poses.reshape(-1, 3), sensor.mount).reshape(poses.shape)
    return cast_rays(arena, lasers[..., :2], lasers[..., 2] + sensor.bearings, sensor)
