"""The planner of given poses: visit each and stand still there for a scan, in an order that saves time."""

from __future__ import annotations

import numpy as np

from planners import order
from planners.curve import CurveBuilder
from planners.errors import PlanError
from planners.joins.paths import connect
from planners.methods.stop_and_spin import standing_places
from planners.settings import LOG
from planners.task import JoinCounts, PlannedDrive, Task
from planners.types import Floats, Ints


def plan_views(task: Task) -> PlannedDrive:
    """Drive through the poses of `task.targets`: straight where that is clear, else by OMPL.

    Raises
    ------
    PlanError : The vehicle cannot turn in place, there are no targets, or the robot cannot be at a target.
    """
    if task.vehicle.drive != "diff":
        raise PlanError(
            f"planner views turns on the spot, which drive {task.vehicle.drive!r} cannot do; use drive: diff"
        )
    if task.targets is None or len(task.targets) == 0:
        raise PlanError("planner views needs poses to visit; give at least one")
    _check(task, task.targets)
    targets = task.targets[_order(task, task.targets)]
    start = targets[0] if task.start is None else task.start
    builder = CurveBuilder(start, task.vehicle.limits)
    ends = np.concatenate([start[None, :2], targets[:, :2]])
    paths, joins = connect(ends[:-1], ends[1:], reach=task.reach, barriers=task.barriers, seed=task.seed)
    for k, (target, path) in enumerate(zip(targets, paths, strict=True)):
        if path is not None and not np.allclose(path[0], builder.pose[:2], atol=1e-9):
            path, joins = _reconnect(task, builder.pose[:2], target, joins)  # the view before was not reached
        if path is not None:
            builder.follow(path)
            builder.face(float(target[2]))
            builder.wait(LOG.dwell_periods / task.rate, "view")
        if task.progress:
            task.progress(k + 1, len(targets))
    return PlannedDrive(curve=builder.curve(), stops=np.array(builder.stops).reshape(-1, 4), joins=joins)


def _check(task: Task, targets: Floats) -> None:
    """Reject targets at which the robot cannot be."""
    if targets.ndim != 2 or targets.shape[1] != 3 or not np.isfinite(targets).all():
        raise PlanError(f"poses to visit have shape {targets.shape}, expected (n, 3) of finite x, y, phi")
    tight = task.barriers.distances(targets[:, :2]) < task.reach.clearance - 1e-9
    tight |= ~task.arena.contains(targets[:, :2])
    if tight.any():
        x, y, _ = targets[int(tight.argmax())]
        raise PlanError(
            f"the robot cannot be at ({x:.2f}, {y:.2f}): it is outside, or less than {task.reach.clearance:.2f} m "
            "from a wall; choose another pose"
        )


def _order(task: Task, targets: Floats) -> Ints:
    """Order the poses (n, 3) by the travel times between their cells."""
    if len(targets) == 1:
        return np.zeros(1, dtype=np.int64)
    limits = task.vehicle.limits
    cells = standing_places(task.reach, task.barriers, task.reach.cells()[:, :, None])
    points = targets[:, :2] if task.start is None else np.concatenate([targets[:, :2], task.start[None, :2]])
    near = np.array([((cells.places - point) ** 2).sum(axis=1).argmin() for point in points])
    cost = order.travel_times(cells, np.repeat(near, 2), limits.v, limits.v / limits.a)
    first = None if task.start is None else 2 * len(targets)
    tour = order.tour(cost, first, np.random.default_rng(task.seed))
    return np.array([k for k, _ in tour if k < len(targets)], dtype=np.int64)


def _reconnect(
    task: Task, here: Floats, target: Floats, joins: JoinCounts
) -> tuple[Floats | None, JoinCounts]:
    """Find a path to a target from the robot's actual place."""
    paths, more = connect(
        here[None], target[None, :2], reach=task.reach, barriers=task.barriers, seed=task.seed
    )
    return paths[0], joins + more
