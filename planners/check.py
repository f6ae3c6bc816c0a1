"""Check a trajectory from its samples alone: limits, continuity, no slip, certified clearance.

The checks share no code with the planners: distances come from shapely, motion from finite differences.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.arena import Arena, wrap
from planners.trajectory import Trajectory
from planners.types import Floats
from planners.vehicle import Vehicle

LIMIT_SHARE = 0.01
"""Share of a limit by which it may be exceeded, due to the rounding of trajectory.csv (6 decimals at 50 Hz)."""
SLIP = 2e-4
"""[m, rad] Maximum difference of a pose from the integral of the twists over one sample, due to that rounding."""
ANCHOR_STRIDE = 10
"""Samples between two exact distances. Between them a lower bound is used where it suffices."""
EXACT_MARGIN = 0.01
"""[m] above the smallest exact distance, within which bounds are replaced by exact distances."""

KINDS = ("v", "omega", "a", "alpha", "curvature", "continuity", "clearance")


@dataclass(frozen=True, kw_only=True)
class TrajectoryCheck:
    """Violations of a trajectory."""

    violations: Mapping[str, int]
    """Number of samples that violate v, omega, a, alpha, curvature, continuity (pose against twist), or
clearance."""
    min_clearance: float
    """[m] smallest distance of base_link to a wall, also between samples; 0 where the robot leaves free space."""

    @property
    def count(self) -> int:
        """Number of all violations."""
        return sum(self.violations.values())


def check(trajectory: Trajectory, arena: Arena, vehicle: Vehicle) -> TrajectoryCheck:
    """Check the samples, and bound the motion between them by the limits."""
    return check_parts([trajectory], arena, vehicle)


def check_parts(parts: Iterable[Trajectory], arena: Arena, vehicle: Vehicle) -> TrajectoryCheck:
    """Check a long trajectory in parts; each part begins with the last sample of the one before.

    A violation at a shared sample counts in both parts. Parts are checked in parallel on all processors.
    """
    total, least = dict.fromkeys(KINDS, 0), np.inf
    examine = partial(_check_part, arena=arena, walls=_Walls.of(arena), vehicle=vehicle)
    left = iter(parts)
    n = os.cpu_count() or 1
    with ThreadPoolExecutor(n) as threads:
        size = 1  # shapely builds its indices in the first part; later parts only read them
        while wave := list(islice(left, size)):
            for counts, nearest in threads.map(examine, wave):
                for kind, count in counts.items():
                    total[kind] += count
                least = min(least, nearest)
            size = n
    return TrajectoryCheck(violations=total, min_clearance=least)


@dataclass(frozen=True, eq=False)
class _Walls:
    """Barriers of the robot, with a search tree."""

    lines: NDArray[np.object_]
    tree: shapely.STRtree

    @classmethod
    def of(cls, arena: Arena) -> _Walls:
        lines = barriers(arena)
        return cls(lines, shapely.STRtree(lines))


def _check_part(
    part: Trajectory, *, arena: Arena, walls: _Walls, vehicle: Vehicle
) -> tuple[dict[str, int], float]:
    """Return the number of violations of each kind, and the smallest proven distance [m]."""
    found = _motion(part, vehicle)
    found["clearance"], nearest = _clearance(part, arena, walls, vehicle.footprint_radius)
    return found, nearest


def _motion(trajectory: Trajectory, vehicle: Vehicle) -> dict[str, int]:
    """Count the samples that exceed a limit or do not follow from the sample before."""
    limits, dt = vehicle.limits, np.diff(trajectory.stamps)
    v, omega = trajectory.twists.T
    most = 1 + LIMIT_SHARE
    found = {
        "v": int((abs(v) > limits.v * most).sum()),
        "omega": int((abs(omega) > limits.omega * most).sum()),
        "a": int((abs(np.diff(v)) > limits.a * most * dt + 2e-6).sum()),
        # a car on arcs of one radius changes its curvature in a step where two arcs meet
        "alpha": int((abs(np.diff(omega)) > limits.alpha * most * dt + 2e-6).sum())
        * (vehicle.drive == "diff"),
        "continuity": _discontinuities(trajectory, 0.25 if vehicle.drive == "diff" else 0.5),
    }
    if vehicle.drive != "diff":
        found["curvature"] = int((abs(omega) * limits.turning_radius > abs(v) * most + 1e-6).sum())
    if vehicle.drive == "dubins":
        found["v"] += int((v < -1e-6).sum())
    return found


def barriers(arena: Arena) -> NDArray[np.object_]:
    """Return the straight pieces (n,) of all walls and of the border of free space, as shapely lines."""
    rim = shapely.boundary(arena.free)
    rings = [np.asarray(line.coords)[:, :2] for line in getattr(rim, "geoms", [rim])]
    pieces = [np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]
    return np.asarray(shapely.linestrings(np.concatenate([arena.walls, *pieces])))


def _discontinuities(trajectory: Trajectory, part: float) -> int:
    """Count samples whose pose does not follow from the one before by the mean twist.

    The chord of a step with mean twist (v, omega) has length v dt along the mean heading (Simpson's rule).
    Deviations up to `SLIP` plus what a change of the twist within one sample can cause are allowed.

    Parameters
    ----------
    part : Share of the change of the twist over one sample that its mean may miss; 0.5 where the twist jumps.
    """
    dt = np.diff(trajectory.stamps)
    turn = wrap(np.diff(trajectory.poses[:, 2]))
    mean = 0.5 * (trajectory.twists[1:] + trajectory.twists[:-1]) * dt[:, None]  # (n - 1, 2) [m, rad]
    middle = trajectory.poses[:-1, 2] + 0.5 * turn
    chord = np.diff(trajectory.poses[:, :2], axis=0)
    ahead = chord[:, 0] * np.cos(middle) + chord[:, 1] * np.sin(middle)
    aside = chord[:, 1] * np.cos(middle) - chord[:, 0] * np.sin(middle)
    # within one sample v and omega may change by a dt and alpha dt: bound the error of their mean
    change = abs(np.diff(trajectory.twists, axis=0))
    loose_m = SLIP + 0.25 * change[:, 0] * dt
    loose_rad = SLIP + part * change[:, 1] * dt
    bent = 0.25 * abs(mean[:, 0]) * (abs(turn) + loose_rad)
    wrong = (abs(ahead - mean[:, 0]) > loose_m + bent * abs(turn)) | (abs(aside) > SLIP + bent)
    wrong |= abs(wrap(turn - mean[:, 1])) > loose_rad
    return int(wrong.sum())


def _clearance(trajectory: Trajectory, arena: Arena, walls: _Walls, radius: float) -> tuple[int, float]:
    """Count samples whose surroundings are not proven free; return the smallest proven distance [m].

    The distance to the nearest wall changes by at most the distance driven. So two samples at distances d and d', a step s
    apart, prove (d + d' - s) / 2 between them. Where this could be the smallest distance or less than the radius, the
    distance of the step itself is used; the path deviates from it by at most a quarter of s times the turn.
    """
    places = trajectory.poses[:, :2]
    steps = np.hypot(*np.diff(places, axis=0).T)
    moved = np.concatenate([[True], steps > 0])
    distance = _distances(places[moved], walls)[np.cumsum(moved) - 1]
    inside = arena.contains(places)
    distance[~inside] = 0.0
    between = np.maximum(0.5 * (distance[1:] + distance[:-1] - steps), 0.0)
    near = inside[1:] & inside[:-1] & (steps > 0) & (between < max(float(distance.min()), radius))
    chords = shapely.linestrings(np.stack([places[:-1][near], places[1:][near]], axis=1))
    bent = 0.25 * steps[near] * abs(wrap(np.diff(trajectory.poses[:, 2])[near]))
    between[near] = np.maximum(between[near], _exact(chords, walls) - bent)
    proven = distance.copy()
    proven[:-1] = np.minimum(proven[:-1], between)
    proven[1:] = np.minimum(proven[1:], between)
    return int((proven < radius - 1e-6).sum()), float(proven.min())


def _exact(shapes: Any, walls: _Walls) -> Floats:
    """Return the distances (n,) [m] of points or lines (n,) of shapely to the walls."""
    return np.asarray(shapely.distance(shapes, walls.lines[walls.tree.nearest(shapes)]), dtype=np.float64)


def _distances(points: Floats, walls: _Walls) -> Floats:
    """Return distances (n,) [m] to walls: exact where they may be the smallest, lower bounds elsewhere.

    A distance d at a point proves d - |p - q| at another point q at distance |p - q|. Every
    `ANCHOR_STRIDE`-th point is exact and bounds the others.
    """
    anchors = np.arange(0, len(points), ANCHOR_STRIDE)
    near = np.minimum(np.arange(len(points)) // ANCHOR_STRIDE, len(anchors) - 1)
    known = _exact(shapely.points(points[anchors]), walls)
    bound: Floats = known[near] - np.hypot(*(points - points[anchors[near]]).T)
    bound[anchors] = known
    open_ = np.flatnonzero(bound < known.min() + EXACT_MARGIN)
    bound[open_] = _exact(shapely.points(points[open_]), walls)
    return bound
