"""Record what the simulated robot perceives: ExecutedDrive -> Run, with the noise of robot.yaml.

Scans come from a `Scene`, with or without effects, so that simulation and `diagnose` share one model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from logs.run import OccupancyMap, RangeSensor, Run
from planners.arena import Arena, wrap
from planners.groups import members
from sensorgraph.types import Floats, Progress
from sensorgraph.world.drive import ExecutedDrive, odometry
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import Robot
from sensorgraph.world.scene import Scene, Transform, draw_readings

EPOCH_NS = 1_704_067_200_000_000_000
"""[ns] 2024-01-01T00:00:00Z, start of every simulated run: the same seed gives the same bytes."""
SCANS_PER_STEP = 1000  # scans between two progress updates


def scan_stamps(driven: ExecutedDrive, sensor: RangeSensor) -> Floats:
    """Return the stamps (n_scans,) [s] of ray 0, at the sensor's rate; the last scan ends within the drive."""
    first = np.arange(
        0.0,
        driven.stamps[-1] - sensor.scan_duration - max(sensor.first_ray_delay, 0.0) + 1e-9,
        1.0 / sensor.rate,
    )
    return first + sensor.ray_0_after_first


def simulate(
    driven: ExecutedDrive,
    arena: Arena,
    robot: Robot,
    *,
    rng: np.random.Generator,
    effects: Sequence[Transform] = (),
    seed: int = 0,
    drivetrain: Drivetrain | None = None,
    meta: Mapping[str, str] | None = None,
    attachments: Mapping[str, bytes] | None = None,
    perceive: Callable[[int, Floats], Floats] | None = None,
    progress: Progress | None = None,
) -> Run:
    """Log a drive as the robot would: scans, reference poses, odometry and commands, each at its own rate.

    Parameters
    ----------
    effects : Effects on the scan channel: deviations of sensor and room from robot.yaml and map.
    seed : Seed of walking people; noise comes from `rng`.
    perceive : (number of the first scan, poses) -> readings (n, n_rays) [m], instead of the arena. Poses are
        (n, 3), or (n, n_rays, 3) for the rays of a sweep.
    drivetrain : Drivetrain that measures the odometry; None: as in robot.yaml.
    """
    sensor = robot.sensor
    stamps = scan_stamps(driven, sensor)
    parts = []
    for start in range(0, len(stamps), SCANS_PER_STEP):
        part = stamps[start : start + SCANS_PER_STEP]
        if perceive is not None:
            when = part[:, None] + sensor.ray_delays if sensor.has_ray_delays else part
            parts.append(perceive(start, driven.at(when)))
        else:
            scene = Scene(
                arena=arena, sensor=sensor, stamps=part, motion=driven.at, span=float(stamps[-1]), seed=seed
            )
            scene.run(effects)
            parts.append(draw_readings(scene, rng))
        if progress is not None:
            progress(start + len(parts[-1]), len(stamps))
    ranges = np.concatenate(parts)
    pose_stamps = np.append(np.arange(0.0, driven.stamps[-1], 1.0 / robot.pose.rate), driven.stamps[-1])
    sigma = [robot.pose.sigma_xy, robot.pose.sigma_xy, robot.pose.sigma_yaw]
    poses = driven.at(pose_stamps) + rng.normal(size=(len(pose_stamps), 3)) * sigma
    odom_stamps, odom_poses, odom_twists = odometry(driven, robot, rng, drivetrain=drivetrain)
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


def occupancy_map(
    arena: Arena, *, resolution: float = 0.05, most: int = 4_000_000, margin: float | None = None
) -> OccupancyMap:
    """Rasterise an arena for /map: free 0, wall 100, elsewhere unknown -1.

    Walls that lie whole cells from the outermost ones are in the middle of their cells, where a reader
    assumes them. The resolution [m] becomes coarser if the grid would exceed `most` cells.

    Parameters
    ----------
    margin : [m] Margin around the walls at which the map ends; None: all free space is included. In a
        sensorgraph the free space extends to the range of the laser where nothing stops the rays.
    """
    x0, y0, x1, y1 = arena.bounds
    if margin is not None and len(arena.walls):
        ends = arena.walls.reshape(-1, 2)
        x0, y0 = np.maximum([x0, y0], ends.min(axis=0) - margin)
        x1, y1 = np.minimum([x1, y1], ends.max(axis=0) + margin)
    resolution = max(resolution, float(np.sqrt((x1 - x0) * (y1 - y0) / most)))
    x0, y0 = x0 - 2.5 * resolution, y0 - 2.5 * resolution  # the outermost walls in the middle of their cells
    nx, ny = int((x1 - x0) / resolution) + 3, int((y1 - y0) / resolution) + 3
    x: Floats = np.asarray(x0 + (np.arange(nx) + 0.5) * resolution, dtype=np.float64)
    y: Floats = np.asarray(y0 + (np.arange(ny) + 0.5) * resolution, dtype=np.float64)
    data = np.where(arena.contains_grid(x, y).T, 0, -1).astype(np.int8)  # (ny, nx)
    start, step = arena.walls[:, 0], arena.walls[:, 1] - arena.walls[:, 0]
    n = (np.hypot(*step.T) / resolution * 4).astype(np.intp) + 2  # points of a wall, four to a cell
    wall, number = members(n)
    points = start[wall] + (number / (n[wall] - 1))[:, None] * step[wall]
    column, row = ((points - [x0, y0]) / resolution).astype(np.intp).T
    data[row.clip(0, ny - 1), column.clip(0, nx - 1)] = 100
    return OccupancyMap(data=data, resolution=resolution, origin=np.array([x0, y0, 0.0]))
