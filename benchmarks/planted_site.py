"""A real log as runs and a map: short surfaces from its even scans, measurements in windows of its odd scans."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial import cKDTree

from logs import Run, pair
from planners.arena import Arena
from planners.types import Floats, Ints
from sensorgraph import build
from sensorgraph.graph import Sensorgraph
from sensorgraph.world.open_borders import open_borders
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import Robot, default_robot

MAP_MAX_RANGE = 12.0  # [m] the map is made up to here; a longer reading counts as nothing seen
MAP_MIN_RANGE = 0.05  # [m] a shorter reading is broken
N_MEASURED = 90  # of a scan that are measured, evenly spread
MAX_STEP = 3.0  # [s] without a scan: a dense log is broken here
SPARSE_STEP = 1.0  # [s] between scans: the log is taken as one stretch, whose map needs all of them
SPARSE_WINDOW = 72  # scans of a window of such a log
MAP_CELL = 0.08  # [m]
RANGE_SIGMA = 0.015  # [m]
SCANS_IN_GRAPH = 200  # of a window against a graph
N_SCANS_IN_GRAPH = 100  # of these that are taken
MAX_WINDOWS = 20  # of a log, evenly spread over its second half: commissioning with more takes long
N_SPREAD, SCANS_SPREAD = 3, 200  # samples of a whole log against a map of pixels, and scans of each
MIN_KNOWN = 0.4  # share of its rays that meet a wall of the graph before unknown space


def ends(poses: Floats, ranges: Floats, bearings: Floats) -> tuple[Floats, Ints]:
    """Return where rays end (n, 2) [m], and of which scan each is."""
    seen = np.isfinite(ranges) & (ranges > 2 * MAP_MIN_RANGE) & (ranges < MAP_MAX_RANGE)
    scan, ray = np.nonzero(seen)
    angle = poses[scan, 2] + bearings[ray]
    r = ranges[seen]
    return poses[scan, :2] + r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), scan


def surfaces(
    poses: Floats, ranges: Floats, bearings: Floats, *, reach: float = 0.12, narrow: float = 0.008
) -> Floats:
    """Lay a short wall through each cell that three scans have met: (n, 2, 2) [m].

    Its line is the principal direction of the points around, weighted by distance (`reach`) and, robustly, by how far
    they are off the line (`narrow`).
    """
    points, scan = ends(poses, ranges, bearings)
    cells, index = np.unique(np.floor(points / MAP_CELL).astype(np.intp), axis=0, return_inverse=True)
    index = index.ravel()
    met = np.bincount(np.unique(index * len(poses) + scan) // len(poses), minlength=len(cells))
    centre = np.stack([np.bincount(index, p) for p in points.T], axis=1) / np.bincount(index)[:, None]
    good = np.flatnonzero(met >= 3)
    centre = centre[good]
    _, fine, count = np.unique(
        np.floor(points / 0.02).astype(np.intp), axis=0, return_inverse=True, return_counts=True
    )
    dots = np.stack([np.bincount(fine.ravel(), p) for p in points.T], axis=1) / count[:, None]
    near = cKDTree(dots).query_ball_point(centre, reach)
    j = np.concatenate([np.array(k, dtype=np.intp) for k in near])
    i = np.repeat(np.arange(len(good)), [np.size(k) for k in near])
    away = dots[j] - centre[i]
    kernel = count[j] * np.exp(-0.5 * (away**2).sum(axis=1) / (reach / 2) ** 2)
    weight = kernel
    for turn in range(6):
        total = np.bincount(i, weight)
        middle = np.stack([np.bincount(i, weight * a) for a in away.T], axis=1) / total[:, None]
        d = away - middle[i]
        xx, yy, xy = (
            np.bincount(i, weight * a) / total for a in (d[:, 0] ** 2, d[:, 1] ** 2, d[:, 0] * d[:, 1])
        )
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        off = d[:, 1] * along[i, 0] - d[:, 0] * along[i, 1]
        weight = kernel / (1 + (off / max(narrow, 0.04 * 0.5**turn)) ** 2)
    foot = centre + middle - (middle * along).sum(axis=1)[:, None] * along
    own = np.full(len(cells), -1)
    own[good] = np.arange(len(good))
    mine = own[index]
    kept = mine >= 0
    place = ((points[kept] - foot[mine[kept]]) * along[mine[kept]]).sum(axis=1)
    low, high = np.full(len(good), np.inf), np.full(len(good), -np.inf)
    np.minimum.at(low, mine[kept], place)
    np.maximum.at(high, mine[kept], place)
    return np.stack([foot + (low - 0.01)[:, None] * along, foot + (high + 0.01)[:, None] * along], axis=1)


def pruned(walls: Floats, poses: Floats, ranges: Floats, bearings: Floats) -> Floats:
    """Leave out surfaces that more rays pass through than meet."""
    for _ in range(3):
        expected, wall = cast_laser(walls, poses, bearings, 1e4)
        known = (wall >= 0) & ~np.isnan(ranges)
        excess = np.where(known, ranges, 0.0) - np.where(known, expected, 0.0)
        passed = np.bincount(wall[known & (excess > 0.15)], minlength=len(walls))
        stopped = np.bincount(wall[known & (np.abs(excess) < 0.15)], minlength=len(walls))
        walls = walls[(stopped >= np.maximum(1, passed)) | (stopped + passed == 0)]
    return walls


def aligned(walls: Floats, poses: Floats, ranges: Floats, bearings: Floats) -> Floats:
    """Move each pose a little so that its scan lies on the surfaces (point to line, robust)."""
    tangent = walls[:, 1] - walls[:, 0]
    tangent /= np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
    width = np.array([0.012, 0.012, np.radians(0.25)])
    delta = np.zeros_like(poses)
    for _ in range(3):
        at = poses + delta
        expected, wall = cast_laser(walls, at, bearings, 1e4)
        seen = (wall >= 0) & np.isfinite(ranges)
        angle = at[:, 2:] + bearings
        ux, uy = np.cos(angle), np.sin(angle)
        nx, ny = tangent[np.where(seen, wall, 0), 1], -tangent[np.where(seen, wall, 0), 0]
        across = ux * nx + uy * ny
        off = (np.where(seen, ranges, 0.0) - np.where(seen, expected, 0.0)) * across
        r = np.where(seen, ranges, 0.0)
        rows = np.stack([nx, ny, r * (ux * ny - uy * nx)], axis=-1)
        weight = seen * (np.abs(across) > 0.2) / (1 + (off / RANGE_SIGMA) ** 2) ** 2 / (2 * RANGE_SIGMA) ** 2
        matrix = np.einsum("nmi,nm,nmj->nij", rows, weight, rows) + np.diag(width**-2)
        right = -np.einsum("nmi,nm->ni", rows, weight * off) - delta / width**2
        delta = delta + np.linalg.solve(matrix, right[..., None])[..., 0]
    return poses + delta


def site(poses: Floats, ranges: Floats, bearings: Floats) -> Arena:
    """Make a map of short surfaces, its own scans laid on it three times."""
    at = poses
    for turn in range(4):
        walls = pruned(surfaces(at, ranges, bearings), at, ranges, bearings)
        if turn < 3:
            at = aligned(walls, poses, ranges, bearings)
    low, high = walls.min(axis=(0, 1)) - 1, walls.max(axis=(0, 1)) + 1
    return Arena(
        free=shapely.box(*low, *high),
        walls=walls,
        names=tuple(f"site/edge_{k}" for k in range(len(walls))),
        surfaces=("wall",) * len(walls),
    )


def limited(ranges: Floats) -> Floats:
    """Code readings beyond MAP_MAX_RANGE as nothing seen, those below MAP_MIN_RANGE as broken."""
    return np.where(ranges < MAP_MIN_RANGE, np.nan, np.where(ranges > MAP_MAX_RANGE, np.inf, ranges))


def measured_rays(log: Run) -> Ints:
    """Return which rays of the log are measured."""
    every = max(1, log.sensor.n_rays // N_MEASURED)
    return np.arange(every // 2, log.sensor.n_rays, every)


def measurement(log: Run, scans: Ints) -> Run:
    """Return some scans of the log, some 90 rays of each."""
    rays = measured_rays(log)
    sensor = replace(log.sensor, bearings=log.sensor.bearings[rays], range_max=MAP_MAX_RANGE)
    return replace(
        log,
        sensor=sensor,
        stamps=log.stamps[scans],
        ranges=limited(log.ranges[scans][:, rays]),
        pose_stamps=log.stamps[scans],
        poses=log.poses[scans],
    )


def robot_of(log: Run, resolution: float) -> Robot:
    """Describe the laser, and what the poses of such a log deserve."""
    usual = default_robot()
    sensor = replace(
        measurement(log, np.arange(1)).sensor,
        range_min=0.0,
        sigma=RANGE_SIGMA,
        resolution=resolution,
        height=0.3,
    )
    tolerances = replace(usual.tolerances, pose_xy=0.012, pose_yaw=float(np.radians(0.25)))
    return replace(usual, sensor=sensor, tolerances=tolerances)


@dataclass(frozen=True)
class LogWindow:
    """A stretch of the log, and the map of its surroundings."""

    name: str
    scans: Ints
    arena: Arena


def windows(log: Run) -> Iterator[LogWindow]:
    """Cut the log where it is broken, and every stretch into two halves of odd scans; a sparse log is one stretch."""
    is_sparse = np.median(np.diff(log.stamps)) > SPARSE_STEP
    breaks = [] if is_sparse else np.flatnonzero(np.diff(log.stamps) > MAX_STEP) + 1
    cuts = [0, *breaks, log.n_scans]
    for low, high in pairwise(cuts):
        even, odd = np.arange(low, high, 2), np.arange(low + 1, high, 2)
        arena = site(log.poses[even], log.ranges[even], log.sensor.bearings)
        for part in np.array_split(odd, len(odd) // SPARSE_WINDOW if is_sparse else 2):
            yield LogWindow(f"{part[0]}-{part[-1]}", part, arena)


def graph_of_first_half(log: Run, path: Path) -> Sensorgraph:
    """Build a graph of every second scan of the log's first half, or read it where it is kept."""
    if not path.exists():
        some = np.arange(0, log.n_scans // 2, 2)
        build(replace(log, stamps=log.stamps[some], ranges=log.ranges[some])).save(path)
    return Sensorgraph.load(path)


def windows_in_graph(
    log: Run, arena: Arena, *, first: int = 0, n_scans: int = SCANS_IN_GRAPH
) -> Iterator[LogWindow]:
    """Cut a located log, from its scan `first` on, into windows; those mostly in unknown space are left out."""
    borders = open_borders(arena)
    judged = np.arange(first, log.n_scans)
    parts = np.array_split(judged, max(2, round(len(judged) / n_scans)))
    for part in parts[:: -(-len(parts) // MAX_WINDOWS)]:
        scans = part[:: max(1, len(part) // N_SCANS_IN_GRAPH)]
        run = measurement(log, scans)
        lasers = laser_poses(run.poses, run.sensor.mount)
        at_wall, at_border = (
            cast_laser(lines, lasers, run.sensor.bearings, MAP_MAX_RANGE)[0]
            for lines in (arena.walls, borders)
        )
        if (at_wall < at_border).mean() > MIN_KNOWN:
            yield LogWindow(f"{part[0]}-{part[-1]}", scans, arena)


def spread_over_log(log: Run, arena: Arena) -> Iterator[LogWindow]:
    """Take some of the scans of a located log, evenly spread over all of it, N_SPREAD times."""
    scans = np.linspace(0, log.n_scans - 1, N_SPREAD * SCANS_SPREAD).astype(np.intp)
    for k in range(N_SPREAD):
        yield LogWindow(
            f"{k + 1} of {N_SPREAD}, one scan in {log.n_scans // SCANS_SPREAD}", scans[k::N_SPREAD], arena
        )


def scans_alone(log: Run) -> Run:
    """Return the scans of a located log that have a pose, without its wheels; pose k is that of scan k."""
    none, located = np.zeros(0), pair(log)
    return replace(
        log,
        stamps=log.stamps[located.paired],
        ranges=log.ranges[located.paired],
        pose_stamps=log.stamps[located.paired],
        poses=located.poses[located.paired],
        odom_stamps=none,
        odometry=np.zeros((0, 3)),
        odom_twists=np.zeros((0, 2)),
        pose_covariances=np.zeros((0, 3, 3)),
    )
