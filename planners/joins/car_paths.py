"""Joins of cars: paths in the state space of Reeds and Shepp or of Dubins, from a pose to the nearest of several goals.

The shortest curve is tried first. If it is blocked, RRTConnect searches, and its path is shortened. (A
roadmap is no alternative: OMPL's roadmaps are undirected, and a Dubins car's paths are directed.) OMPL does
not return the arcs of its curves, so they are reconstructed from poses along them. The car drives a chain of
those arcs, certified by exact distances. OMPL runs in a separate process (`ompl_car_paths`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from planners.cars.car_curve import curve_of_arcs
from planners.cars.reeds_shepp import MAX_ARCS, Pose, arc_end, empty_arcs, quickest_word
from planners.clearance import Barriers
from planners.curve import Curve
from planners.joins.ompl_car_paths import ArcRows
from planners.joins.ompl_process import CLEARANCE_SLACK, call_ompl
from planners.joins.paths import floor_arrays
from planners.reach import Reach
from planners.search.motion_primitives import GEAR_CHANGE_COST
from planners.task import JoinCounts
from planners.types import Bools, Floats
from planners.vehicle import SHORTEST_ARC, Vehicle

CERTIFY_STEP = 0.004
"""[m] between the poses at which the clearance of a car's path is measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CarPath:
    """A path from a pose to one of the goals."""

    curve: Curve | None
    """None if the car is already at the goal."""
    goal: int
    """Index of the goal."""


def connect_cars(
    starts: Floats,
    goals: list[Floats],
    *,
    reach: Reach,
    barriers: Barriers,
    vehicle: Vehicle,
    seed: int,
) -> tuple[list[CarPath | None], JoinCounts]:
    """Find a path from each start (n, 3) to one of its goals, each (m, 3) [m, m, rad].

    Returns
    -------
    The paths, None where none was found; and their counts.

    Raises
    ------
    PlanError : OMPL is not installed, or its process failed.
    """
    within = [np.flatnonzero(_are_connected(own, reach)) for own in goals]
    response = call_ompl(
        "planners.joins.ompl_car_paths",
        seed=seed,
        starts=starts,
        goals=np.concatenate([own[kept] for own, kept in zip(goals, within, strict=True)]),
        counts=[len(kept) for kept in within],
        radius=vehicle.limits.turning_radius,
        backward=vehicle.drive == "reeds_shepp",
        gear_change_cost=_gear_change_cost(vehicle),
        **floor_arrays(reach),
    )
    found_arcs = np.split(response["arcs"], np.cumsum(response["lengths"])[:-1])
    paths: list[CarPath | None] = []
    joins = JoinCounts()
    for k, (start, own) in enumerate(zip(starts, found_arcs, strict=True)):
        found, straight = int(response["goal"][k]), bool(response["direct"][k])
        goal = int(within[k][found]) if found >= 0 else -1
        tried = _without_steering_chatter(start, own, vehicle) if goal >= 0 else iter(())
        made = (_certified_drive(start, arcs, goal, barriers, reach.clearance, vehicle) for arcs in tried)
        path = next((one for one in made if one is not None), None)
        paths.append(path)
        joins += JoinCounts(
            direct=int(path is not None and straight),
            planned=int(path is not None and not straight),
            failed=int(path is None),
            planned_m=float(own[:, 2].sum()) if path is not None and not straight else 0.0,
        )
    return paths, joins


def _without_steering_chatter(start: Floats, arcs: ArcRows, vehicle: Vehicle) -> Iterator[ArcRows]:
    """Yield the path with its steering chatter replaced by a word without any; last, yield the path itself.

    Steering chatter is a sequence of arcs so short that the wheels turn there and back within a sample. The
    replaced part grows by one arc on each side per attempt.
    """
    short = np.flatnonzero(arcs[:, 2] < SHORTEST_ARC)
    n, radius = len(arcs), vehicle.limits.turning_radius
    poses: list[Pose] = [(float(start[0]), float(start[1]), float(start[2]))]
    for gear, bend, length in arcs.tolist():
        poses.append(arc_end(poses[-1], length, int(bend), int(gear), radius))
    gears = [0, *arcs[:, 0].astype(int).tolist(), 0]
    buffer, word = empty_arcs(MAX_ARCS), np.empty(MAX_ARCS)
    for wide in range(1, n + 1) if len(short) else ():
        i, k = max(int(short[0]) - wide, 0), min(int(short[-1]) + wide + 1, n)
        ends = poses[i], poses[k], radius, gears[i], gears[k + 1]
        m = quickest_word(
            *ends, _gear_change_cost(vehicle), vehicle.drive == "reeds_shepp", SHORTEST_ARC, 0, word, buffer
        )
        if m >= 0:
            yield np.concatenate(
                [arcs[:i], np.column_stack([buffer.gear, buffer.bend, buffer.length])[:m], arcs[k:]]
            )
        if i == 0 and k == n:
            break
    yield arcs


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
    start: Floats, arcs: ArcRows, goal: int, barriers: Barriers, clearance: float, vehicle: Vehicle
) -> CarPath | None:
    """Return the drive along arcs; None if it violates the clearance.

    The clearance is reduced by the slack that OMPL is given.
    """
    if not len(arcs):
        return CarPath(curve=None, goal=goal)
    curve = curve_of_arcs(start, arcs[:, 2], arcs[:, 1], arcs[:, 0], vehicle.limits)
    n = int(np.ceil(curve.duration * vehicle.limits.v / CERTIFY_STEP)) + 1
    places = curve.sample(np.linspace(0.0, curve.duration, n))[0][:, :2]
    clear = barriers.distances(places).min() >= clearance - CLEARANCE_SLACK
    return CarPath(curve=curve, goal=goal) if clear else None
