"""Joins of cars: paths in the state space of Reeds and Shepp or of Dubins, from a pose to the nearest of several goals.

The quickest words to the nearest goals are tried first. If all are blocked, RRTConnect searches, and its path is
shortened. (A roadmap is no alternative: OMPL's roadmaps are undirected, and a Dubins car's paths are directed.)
OMPL runs in a separate process (`ompl_car_paths`). It returns the poses between which it drives shortest curves.
Their arcs are those of the shortest words. The car drives a chain of arcs, certified by exact distances.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from planners.arena import wrap
from planners.cars.arc_path import BIN_STEP
from planners.cars.car_curve import curve_of_arcs
from planners.cars.reeds_shepp import (
    MAX_ARCS,
    Arcs,
    Pose,
    arc_end,
    concatenate_arcs,
    empty_arcs,
    quickest_word,
    take_arcs,
)
from planners.clearance import Barriers
from planners.curve import Curve
from planners.joins.ompl_process import CLEARANCE_SLACK, call_ompl
from planners.joins.paths import floor_arrays
from planners.reach import Reach
from planners.search.motion_primitives import GEAR_CHANGE_COST
from planners.task import JoinCounts
from planners.types import Bools, Floats
from planners.vehicle import SHORTEST_ARC, Vehicle

N_DIRECT_GOALS = 16
"""Number of goals to which the quickest word is tried before OMPL samples."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CarPath:
    """A path from a pose to one of the goals."""

    curve: Curve | None
    """None if the car is already at the goal."""
    goal: int
    """Index of the goal."""


def connect_car(
    start: Floats, goals: Floats, *, reach: Reach, barriers: Barriers, vehicle: Vehicle, seed: int
) -> tuple[CarPath | None, JoinCounts]:
    """Find a path from a start (3,) to one of the goals (m, 3) [m, m, rad].

    Returns
    -------
    The path, None if none was found; and its count.

    Raises
    ------
    PlanError : OMPL is not installed, or its process failed.
    """
    within = np.flatnonzero(_are_connected(goals, reach))
    if not len(within):
        return None, JoinCounts(failed=1)

    def first_clear(tries: Iterator[tuple[Arcs, int]]) -> tuple[CarPath | None, float]:
        for arcs, goal in tries:
            path = _certified_drive(start, arcs, int(within[goal]), barriers, reach.clearance, vehicle)
            if path is not None:
                return path, float(arcs.length.sum())
        return None, 0.0

    path, _ = first_clear(_direct(start, goals[within], vehicle))
    if path is not None:
        return path, JoinCounts(direct=1)
    path, length = first_clear(_planned(start, goals[within], reach, vehicle, seed))
    return path, JoinCounts(planned=1, planned_m=length) if path is not None else JoinCounts(failed=1)


def _direct(start: Floats, goals: Floats, vehicle: Vehicle) -> Iterator[tuple[Arcs, int]]:
    """Yield the quickest words to the nearest goals (m, 3) that have one, and the index of the goal of each."""
    words = [_word(start, goal, 0, 0, vehicle) for goal in goals]
    lengths = np.array([np.inf if word is None else word.length.sum() for word in words])
    for k in np.argsort(lengths, kind="stable")[:N_DIRECT_GOALS].tolist():
        if (word := words[k]) is not None:
            yield word, k


def _planned(
    start: Floats, goals: Floats, reach: Reach, vehicle: Vehicle, seed: int
) -> Iterator[tuple[Arcs, int]]:
    """Yield paths by OMPL, the quickest first, and the index of the goal (m, 3) of each."""
    response = call_ompl(
        "planners.joins.ompl_car_paths",
        seed=seed,
        start=start,
        goals=goals,
        radius=vehicle.limits.turning_radius,
        backward=vehicle.drive == "reeds_shepp",
        **floor_arrays(reach),
    )
    found = []
    for poses in (
        np.split(response["poses"], np.cumsum(response["lengths"])[:-1]) if len(response["lengths"]) else []
    ):
        arcs = concatenate_arcs([_shortest(a, b, vehicle) for a, b in pairwise(poses)])
        apart = goals - poses[-1]
        goal = int(np.argmin(abs(np.column_stack([apart[:, :2], wrap(apart[:, 2])])).max(axis=1)))
        cost = float(arcs.length.sum()) + _gear_change_cost(vehicle) * int((np.diff(arcs.gear) != 0).sum())
        found.append((cost, arcs, goal))
    for _, arcs, goal in sorted(found, key=lambda one: one[0]):
        for tried in _without_steering_chatter(start, arcs, vehicle):
            yield tried, goal


def _without_steering_chatter(start: Floats, arcs: Arcs, vehicle: Vehicle) -> Iterator[Arcs]:
    """Yield the path with its steering chatter replaced by a word without any; last, yield the path itself.

    Steering chatter is a sequence of arcs so short that the wheels turn there and back within a sample. The
    replaced part grows by one arc on each side per attempt.
    """
    short, n = np.flatnonzero(arcs.length < SHORTEST_ARC), len(arcs.length)
    poses = [_pose(start)]
    for length, bend, gear in zip(*(part.tolist() for part in arcs), strict=True):
        poses.append(arc_end(poses[-1], length, bend, gear, vehicle.limits.turning_radius))
    gears = [0, *arcs.gear.tolist(), 0]
    for wide in range(1, n + 1) if len(short) else ():
        i, k = max(int(short[0]) - wide, 0), min(int(short[-1]) + wide + 1, n)
        word = _word(np.array(poses[i]), np.array(poses[k]), gears[i], gears[k + 1], vehicle)
        if word is not None:
            yield concatenate_arcs([take_arcs(arcs, slice(i)), word, take_arcs(arcs, slice(k, None))])
        if i == 0 and k == n:
            break
    yield arcs


def _word(start: Floats, goal: Floats, gear_before: int, gear_after: int, vehicle: Vehicle) -> Arcs | None:
    """Return the quickest word from one pose (3,) to another without arcs too short to steer, or None."""
    return _arcs(start, goal, gear_before, gear_after, _gear_change_cost(vehicle), SHORTEST_ARC, vehicle)


def _shortest(start: Floats, goal: Floats, vehicle: Vehicle) -> Arcs:
    """Return the shortest word from one pose (3,) to another, as OMPL drives it."""
    word = _arcs(start, goal, 0, 0, 0.0, 0.0, vehicle)
    assert word is not None
    return word


def _arcs(
    start: Floats,
    goal: Floats,
    gear_before: int,
    gear_after: int,
    gear_change_cost: float,
    shortest: float,
    vehicle: Vehicle,
) -> Arcs | None:
    buffer, word, radius = empty_arcs(MAX_ARCS), np.empty(MAX_ARCS), vehicle.limits.turning_radius
    can_reverse = vehicle.drive == "reeds_shepp"
    n = quickest_word(
        _pose(start), _pose(goal), radius, gear_before, gear_after, gear_change_cost, can_reverse, shortest, 0, word,
        buffer,
    )  # fmt: skip
    return take_arcs(buffer, slice(n)) if n >= 0 else None


def _pose(pose: Floats) -> Pose:
    return float(pose[0]), float(pose[1]), float(pose[2])


def _gear_change_cost(vehicle: Vehicle) -> float:
    """Return the distance [m] that takes as long to drive as a gear change."""
    limits = vehicle.limits
    return GEAR_CHANGE_COST * limits.v_on_arc**2 / limits.a_on_arc


def _are_connected(goals: Floats, reach: Reach) -> Bools:
    """Return whether each goal (m, 3) is at or next to a reachable node of the raster; no path leads to the others."""
    near = ndimage.binary_dilation(reach.mask, np.ones((3, 3), dtype=np.bool_))
    at = np.floor((goals[:, :2] - reach.origin) / reach.step).astype(np.int64)
    inside = ((at >= 0) & (at < near.shape)).all(axis=1)
    at = at.clip(0, np.array(near.shape) - 1)
    return np.asarray(inside & near[at[:, 0], at[:, 1]])


def _certified_drive(
    start: Floats, arcs: Arcs, goal: int, barriers: Barriers, clearance: float, vehicle: Vehicle
) -> CarPath | None:
    """Return the drive along arcs; None if it violates the clearance.

    The clearance is reduced by the slack that OMPL is given.
    """
    if not len(arcs.length):
        return CarPath(curve=None, goal=goal)
    curve = curve_of_arcs(start, arcs.length, arcs.bend, arcs.gear, vehicle.limits)
    n = int(np.ceil(curve.duration * vehicle.limits.v / BIN_STEP)) + 1
    places = curve.sample(np.linspace(0.0, curve.duration, n))[0][:, :2]
    clear = barriers.distances(places).min() >= clearance - CLEARANCE_SLACK
    return CarPath(curve=curve, goal=goal) if clear else None
