"""Check a trajectory from its samples alone: limits, continuity, no slip, certified clearance.

Nothing here is shared with what draws trajectories: distances come from shapely, motion from differences.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.arena import Arena, wrap
from planners.settings import CHECK
from planners.trajectory import Trajectory
from planners.types import Floats
from planners.vehicle import Vehicle

KINDS = ("v", "omega", "a", "alpha", "curvature", "continuity", "clearance")


@dataclass(frozen=True, kw_only=True)
class TrajectoryCheck:
    """What is wrong with a trajectory."""

    violations: Mapping[str, int]
    """Samples that exceed v, omega, a, alpha, curvature, continuity (pose against twist), or clearance."""
    min_clearance: float
    """[m] least distance of base_link to a wall, between the samples too; 0 where the robot leaves free space."""

    @property
    def count(self) -> int:
        """Count of all violations."""
        return sum(self.violations.values())


def check(trajectory: Trajectory, arena: Arena, vehicle: Vehicle) -> TrajectoryCheck:
    """Check the samples, and what lies between two of them as far as the limits bound it."""
    return check_parts([trajectory], arena, vehicle)


def check_parts(parts: Iterable[Trajectory], arena: Arena, vehicle: Vehicle) -> TrajectoryCheck:
    """Check a long trajectory in parts, of which each begins with the last sample of the one before.

    A violation at such a sample counts in both. Parts are checked side by side on all processors, as many at a time.
    """
    total, least = dict.fromkeys(KINDS, 0), np.inf
    examine = partial(_check_part, arena=arena, walls=_Walls.of(arena), vehicle=vehicle)
    left = iter(parts)
    n = os.cpu_count() or 1
    with ThreadPoolExecutor(n) as threads:
        size = 1  # shapely makes its indices in the first part, and only reads them afterwards
        while wave := list(islice(left, size)):
            for counts, nearest in threads.map(examine, wave):
                for kind, count in counts.items():
                    total[kind] += count
                least = min(least, nearest)
            size = n
    return TrajectoryCheck(violations=total, min_clearance=least)


@dataclass(frozen=True, eq=False)
class _Walls:
    """What the robot may not touch, to be searched."""

    lines: NDArray[np.object_]
    tree: shapely.STRtree

    @classmethod
    def of(cls, arena: Arena) -> _Walls:
        lines = barriers(arena)
        return cls(lines, shapely.STRtree(lines))


def _check_part(
    part: Trajectory, *, arena: Arena, walls: _Walls, vehicle: Vehicle
) -> tuple[dict[str, int], float]:
    """Return the violations of each kind, and the least proven distance [m]."""
    found = _motion(part, vehicle)
    found["clearance"], nearest = _clearance(part, arena, walls, vehicle.footprint_radius)
    return found, nearest


def _motion(trajectory: Trajectory, vehicle: Vehicle) -> dict[str, int]:
    """Count what exceeds a limit, or does not follow from the sample before."""
    limits, dt = vehicle.limits, np.diff(trajectory.stamps)
    v, omega = trajectory.twists.T
    most = 1 + CHECK.limit_share
    found = {
        "v": int((abs(v) > limits.v * most).sum()),
        "omega": int((abs(omega) > limits.omega * most).sum()),
        "a": int((abs(np.diff(v)) > limits.a * most * dt + 2e-6).sum()),
        # a car that follows arcs of one radius turns its wheel at once where they meet
        "alpha": int((abs(np.diff(omega)) > limits.alpha * most * dt + 2e-6).sum())
        * (vehicle.drive == "diff"),
        "continuity": _jumps(trajectory, 0.25 if vehicle.drive == "diff" else 0.5),
    }
    if vehicle.drive != "diff":
        found["curvature"] = int((abs(omega) * limits.turning_radius > abs(v) * most + 1e-6).sum())
    if vehicle.drive == "dubins":
        found["v"] += int((v < -1e-6).sum())
    return found


def barriers(arena: Arena) -> NDArray[np.object_]:
    """Return every straight piece of wall, and of the rim of free space, as shapely lines (n,)."""
    rim = shapely.boundary(arena.free)
    rings = [np.asarray(line.coords)[:, :2] for line in getattr(rim, "geoms", [rim])]
    pieces = [np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]
    return np.asarray(shapely.linestrings(np.concatenate([arena.walls, *pieces])))


def _jumps(trajectory: Trajectory, part: float) -> int:
    """Count steps that are not what the mean twist makes of the pose before (Simpson's rule on the chord).

    part : of a change of the twist over one sample that its mean may leave out; a half where it jumps
    """
    dt = np.diff(trajectory.stamps)
    turn = wrap(np.diff(trajectory.poses[:, 2]))
    mean = 0.5 * (trajectory.twists[1:] + trajectory.twists[:-1]) * dt[:, None]  # (n - 1, 2) [m, rad]
    middle = trajectory.poses[:-1, 2] + 0.5 * turn
    way = np.diff(trajectory.poses[:, :2], axis=0)
    ahead = way[:, 0] * np.cos(middle) + way[:, 1] * np.sin(middle)
    aside = way[:, 1] * np.cos(middle) - way[:, 0] * np.sin(middle)
    # within one sample v and omega may change by a dt and alpha dt: bound what their mean leaves out
    change = abs(np.diff(trajectory.twists, axis=0))
    loose_m = CHECK.slip + 0.25 * change[:, 0] * dt
    loose_rad = CHECK.slip + part * change[:, 1] * dt
    bent = 0.25 * abs(mean[:, 0]) * (abs(turn) + loose_rad)
    wrong = (abs(ahead - mean[:, 0]) > loose_m + bent * abs(turn)) | (abs(aside) > CHECK.slip + bent)
    wrong |= abs(wrap(turn - mean[:, 1])) > loose_rad
    return int(wrong.sum())


def _clearance(trajectory: Trajectory, arena: Arena, walls: _Walls, radius: float) -> tuple[int, float]:
    """Count samples whose surroundings are not proven free; return the least distance that is proven.

    The distance to the nearest wall changes by no more than the way driven, so a sample with distance d and a
    step s to the next proves d - s/2 up to half-way there.
    """
    places = trajectory.poses[:, :2]
    steps = np.hypot(*np.diff(places, axis=0).T)
    moved = np.concatenate([[True], steps > 0])
    distance = _distances(places[moved], walls)[np.cumsum(moved) - 1]
    distance[~arena.contains(places)] = 0.0
    half = np.zeros(len(places))
    half[:-1] = 0.5 * steps
    half[1:] = np.maximum(half[1:], 0.5 * steps)
    proven = np.maximum(distance - half, 0.0)
    return int((proven < radius - 1e-6).sum()), float(proven.min())


def _distances(points: Floats, walls: _Walls) -> Floats:
    """Return (n,) [m] exact distances where they can be the least of all, and safe bounds of them elsewhere."""

    def exact(some: Floats) -> Floats:
        where = shapely.points(some)
        return np.asarray(shapely.distance(where, walls.lines[walls.tree.nearest(where)]), dtype=np.float64)

    anchors = np.arange(0, len(points), CHECK.anchor_stride)
    near = np.minimum(np.arange(len(points)) // CHECK.anchor_stride, len(anchors) - 1)
    known = exact(points[anchors])
    bound: Floats = known[near] - np.hypot(*(points - points[anchors[near]]).T)
    bound[anchors] = known
    open_ = np.flatnonzero(bound < known.min() + CHECK.exact_margin)
    bound[open_] = exact(points[open_])
    return bound
