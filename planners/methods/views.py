"""The planner of given poses: visit each and stand still there for a scan, in an order that saves time."""

from __future__ import annotations

import numpy as np

from planners import order
from planners.coverage import DWELL_PERIODS
from planners.curve import CurveBuilder
from planners.errors import PlanError
from planners.joins.paths import continued, join
from planners.methods.stop_and_spin import standing_places
from planners.task import PlannedDrive, Task
from planners.types import Floats, Progress


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
    floor = standing_places(task.reach, task.barriers, task.reach.cells()[:, :, None])
    places, limits = task.targets[:, :2], task.vehicle.limits
    targets = task.targets[order.visiting_order(floor, places, task.start, limits, task.seed)]
    start = targets[0] if task.start is None else task.start
    driven = drive_views(targets, start, task, task.progress)
    if driven is None:
        raise PlanError("no path leads to any pose to visit; choose another start")
    return driven


def drive_views(
    views: Floats, here: Floats, task: Task, progress: Progress | None = None
) -> PlannedDrive | None:
    """Drive from `here` (3,) through the views (n, 3) to which a path is found, with a scan at each; None: to none."""
    ends = np.concatenate([here[None, :2], views[:, :2]])
    paths, joins = join(task, ends[:-1], ends[1:])
    builder = CurveBuilder(here, task.vehicle.limits)
    for k, (view, leg) in enumerate(zip(views, paths, strict=True)):
        path, more = continued(leg, ends[k], builder.pose[:2], view[:2], task)
        joins += more
        if path is not None:
            builder.follow(path)
            builder.face(float(view[2]))
            builder.wait(DWELL_PERIODS / task.rate, "view")
        if progress:
            progress(k + 1, len(views))
    return PlannedDrive.of(builder, joins) if builder.clock > 0 else None


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
