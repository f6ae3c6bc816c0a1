"""Baselines: exploration without a plan, as in the trajectories of Nehmzow and Billings."""

from __future__ import annotations

import numpy as np
import shapely

from planners.arena import wrap
from planners.curve import CurveBuilder
from planners.errors import PlanError
from planners.joins.paths import join
from planners.task import JoinCounts, PlannedDrive, Task
from planners.types import Floats

WALL_ACCURACY = 1e-3
"""[m] accuracy of the distance to a wall ahead."""
MIN_BOUNCE = 0.05
"""[m] minimum free distance ahead after a bounce; with it, no drive gets stuck in the square."""
WALL_DISTANCE = 0.15
"""[m] beyond the clearance, the distance of wall following."""


def random_bounce(task: Task) -> PlannedDrive:
    """Drive straight until a wall is near, turn to a random free heading, and repeat for `task.duration`.

    Raises
    ------
    PlanError : The vehicle cannot turn in place.
    """
    _only_in_place(task, "random_bounce")
    rng = np.random.default_rng(task.seed)
    builder = CurveBuilder(_start(task, rng), task.vehicle.limits)
    bounces = 0
    while builder.clock < _duration(task):
        distance = _free_distance(task, builder.pose)
        if distance > WALL_ACCURACY:
            builder.move(distance, "move")
        bounces += 1
        heading = _open_heading(task, builder.pose, rng)
        builder.turn(float(wrap(heading - builder.pose[2])), "turn")
        if task.progress:
            task.progress(int(min(builder.clock, _duration(task))), int(_duration(task)))
    return PlannedDrive.of(builder, JoinCounts(direct=bounces))


def _open_heading(task: Task, pose: Floats, rng: np.random.Generator) -> float:
    """Return the first random heading with free space ahead."""
    for _ in range(200):
        heading = float(rng.uniform(-np.pi, np.pi))
        if (
            _free_distance(task, np.array([pose[0], pose[1], heading]), MIN_BOUNCE)
            >= MIN_BOUNCE - WALL_ACCURACY
        ):
            return heading
    return float(pose[2] + np.pi)  # the path by which the robot came is free


def _free_distance(task: Task, pose: Floats, most: float | None = None) -> float:
    """Return the free distance [m] ahead, at most `most`, with an accuracy of `WALL_ACCURACY`."""
    ahead = np.array([np.cos(pose[2]), np.sin(pose[2])])
    x0, y0, x1, y1 = task.arena.bounds
    low, high = 0.0, float(np.hypot(x1 - x0, y1 - y0)) if most is None else most
    while high - low > WALL_ACCURACY:
        distances = np.linspace(low, high, 24)[1:]
        here = np.repeat(pose[None, :2], len(distances), axis=0)
        clear = task.barriers.are_clear(here, here + distances[:, None] * ahead, task.reach.clearance)
        first = len(distances) if clear.all() else int(clear.argmin())
        if first == len(distances):
            return high
        low, high = (float(distances[first - 1]) if first else low), float(distances[first])
    return low


def wall_following(task: Task) -> PlannedDrive:
    """Follow the longest wall within reach at a constant distance, lap after lap, for `task.duration`.

    Raises
    ------
    PlanError : The vehicle cannot turn in place, no wall can be followed, or OMPL finds no path along it.
    """
    _only_in_place(task, "wall_following")
    rng = np.random.default_rng(task.seed)
    start = _start(task, rng)
    ring = _ring(task)
    first = int(np.hypot(*(ring - start[:2]).T).argmin())
    ring = np.roll(ring, -first, axis=0)
    ring = np.concatenate([ring, ring[:1]])
    laps, joins = join(task, ring[:-1], ring[1:])
    path = np.concatenate([ring[:1], *(leg[1:] for leg in laps if leg is not None)])
    lead, first_join = join(task, start[None, :2], ring[:1])
    if lead[0] is None or joins.failed:
        raise PlanError(
            f"OMPL found no path along the wall from ({start[0]:.2f}, {start[1]:.2f}); choose another start"
        )
    builder = CurveBuilder(start, task.vehicle.limits)
    corners = [*lead[0][1:], *path[1:]]
    lap = 0
    while builder.clock < _duration(task):
        corner = corners[lap] if lap < len(corners) else path[1 + (lap - len(corners)) % (len(path) - 1)]
        lap += 1
        leg = corner - builder.pose[:2]
        builder.turn(float(wrap(np.arctan2(leg[1], leg[0]) - builder.pose[2])), "turn")
        builder.move(float(np.hypot(*leg)), "lane")
        if task.progress:
            task.progress(int(min(builder.clock, _duration(task))), int(_duration(task)))
    return PlannedDrive.of(builder, joins + first_join)


def _ring(task: Task) -> Floats:
    """Return the longest line (n, 2) [m] at a constant distance from walls, counter-clockwise."""
    for beyond in (WALL_DISTANCE, WALL_DISTANCE / 2, 0.01):
        inner = task.arena.free.buffer(-(task.reach.clearance + beyond), join_style="mitre", mitre_limit=2.0)
        parts = [part for part in getattr(inner, "geoms", [inner]) if not part.is_empty]
        reached = [part for part in parts if task.reach.nearest(part.exterior.coords[0]) is not None]
        if reached:
            rings = [ring for part in reached for ring in (part.exterior, *part.interiors)]
            ring = max(rings, key=lambda line: float(line.length))
            points = np.asarray(ring.simplify(0.01).coords)[:-1, :2]
            return points if shapely.LinearRing(points).is_ccw else points[::-1]
    raise PlanError("no wall can be followed within reach of the start; choose another start")


def _start(task: Task, rng: np.random.Generator) -> Floats:
    """Return the start of the task, or a random reachable pose."""
    if task.start is not None:
        return task.start
    i, j = np.nonzero(task.reach.mask & (task.reach.distance > task.reach.clearance + MIN_BOUNCE))
    if not len(i):
        i, j = np.nonzero(task.reach.mask)
    pick = int(rng.integers(len(i)))
    return np.array(
        [*task.reach.nodes((i[pick : pick + 1], j[pick : pick + 1]))[0], rng.uniform(-np.pi, np.pi)]
    )


def _duration(task: Task) -> float:
    assert task.duration is not None
    return task.duration


def _only_in_place(task: Task, name: str) -> None:
    if task.vehicle.drive != "diff":
        raise PlanError(
            f"planner {name} turns on the spot, which drive {task.vehicle.drive!r} cannot do; use drive: diff"
        )
