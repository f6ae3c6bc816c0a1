"""Battery runs: a drive cut into sessions that start at the dock and return to it in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csgraph

from planners.curve import join_curves
from planners.errors import PlanError
from planners.rooms import cell_graph
from planners.sections import (
    PathCache,
    cut_points,
    drive_along,
    end_poses,
    longest_section,
    minutes,
    section_of,
    section_up_to,
)
from planners.task import PlannedDrive, Task
from planners.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """One run that starts and ends at the dock."""

    driven: PlannedDrive
    out_s: float
    """[s] from the dock to the first covering move."""
    home_s: float
    """[s] from the last covering move to the dock."""


def check_battery(task: Task, battery: float, dock: Floats) -> None:
    """Reject a battery that is too small for the farthest cell and back, before planning.

    Raises
    ------
    PlanError : The battery is too small.
    """
    reach = task.reach
    at = tuple(np.floor((dock[:2] - reach.origin) / reach.cell).astype(np.int64))
    here = int(np.ravel_multi_index(at, reach.shape))
    steps = csgraph.dijkstra(cell_graph(reach), directed=False, indices=[here])[0].reshape(reach.shape)
    todo = (task.coverage.reachable & (task.coverage.counts == 0)).any(axis=2)
    steps = np.where(todo & np.isfinite(steps), steps, 0.0)
    far = np.unravel_index(int(steps.argmax()), steps.shape)
    least = (
        2 * float(steps[far]) * reach.cell / np.sqrt(2) / task.vehicle.limits.v
    )  # a path over n cell borders is at least n cell / √2 long
    if least > battery:
        x, y = reach.origin + (np.array(far) + 0.5) * reach.cell
        raise PlanError(too_small(battery, x, y, least))


def too_small(battery: float, x: float, y: float, least: float) -> str:
    """Return the error message for a place (x, y) [m] that needs a battery of at least `least` [s]."""
    return (
        f"a battery of {battery / 60:g} min is too small: from the dock to ({x:.2f}, {y:.2f}) and back takes "
        f"{minutes(least)} min at least; use a larger one, or move the dock"
    )


def battery_sessions(driven: PlannedDrive, task: Task, *, battery: float, dock: Floats) -> list[Session]:
    """Cut a drive into runs that start and end at the dock (3,), each within `battery` [s].

    Without a priority, the runs are ordered so that early runs are spread over the floor.

    Raises
    ------
    PlanError : A place needs more than one battery, or no path leads to the dock.
    """
    curve, vehicle, cache = driven.curve, task.vehicle, PathCache(task)
    found: list[Session] = []
    middles: list[Floats] = []
    first = 0
    while first < len(curve.starts):
        begin, _ = end_poses(section_of(curve, first, len(curve.starts), vehicle))
        out = cache.transit(dock, begin)
        cut = longest_section(curve, first, battery - out.duration, dock, cache, vehicle)
        if cut is None:
            last = int(cut_points(curve, vehicle)[cut_points(curve, vehicle) > first][0])
            least = out.duration + section_up_to(curve, first, last, dock, cache, vehicle).duration
            raise PlanError(too_small(battery, float(begin[0]), float(begin[1]), least))
        assert cut.home is not None
        parts = [part for part in (out.curve, cut.part, cut.home.curve) if part is not None]
        run = drive_along(parts, out.joins + cut.home.joins, task)
        found.append(Session(driven=run, out_s=out.duration, home_s=cut.home.duration))
        middles.append(cut.part.poses[:, :2].mean(axis=0))
        first = cut.last
    return found if task.priority is not None else [found[k] for k in farthest_first(np.array(middles))]


def farthest_first(points: Floats) -> list[int]:
    """Order points (n, 2) by farthest-first traversal: the next point is the one farthest from all before it."""
    order, far = [0], np.hypot(*(points - points[0]).T)
    while len(order) < len(points):
        far[order] = -1.0
        order.append(int(far.argmax()))
        far = np.minimum(far, np.hypot(*(points - points[order[-1]]).T))
    return order


def chain_sessions(runs: list[Session], whole: PlannedDrive) -> PlannedDrive:
    """Join all runs into one drive, one after the other."""
    joins = whole.joins
    for run in runs:
        joins += run.driven.joins
    return PlannedDrive(
        curve=join_curves([run.driven.curve for run in runs]),
        stops=np.concatenate([run.driven.stops for run in runs]),
        joins=joins,
        interrupted=whole.interrupted,
    )
