"""The coverage planner, the default of `plan`: search each room independently, and join the rooms by OMPL.

`coverage_spins` plans for robots that turn in place, `coverage_cars` for cars. The rooms are searched in
parallel (`parallel_search`), with the same result on any number of processors. `stop_and_spin`, the older
planner of robots that turn in place, completes single headings that earlier runs have missed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners.methods.anytime import plan_anytime
from planners.methods.coverage_cars import plan_cars
from planners.methods.coverage_spins import plan_spins
from planners.methods.stop_and_spin import bins_to_visit, plan_stop_and_spin
from planners.task import PlannedDrive, Task

OPEN_SHARE = 0.25
"""Maximum share of missing bins after earlier runs; cells above it are covered again as a whole
(`python -m benchmarks.plan_options resume`)."""
SCATTERED_SHARE = 0.75
"""If more than half of the missing bins are in cells with at most this share missing, stops are planned
instead of a search (`python -m benchmarks.plan_options resume`)."""


def plan_coverage(task: Task) -> PlannedDrive:
    """Visit every reachable bin that is still missing.

    Raises
    ------
    PlanError : Every bin is covered already, or no room can be reached.
    KeyboardInterrupt : Ctrl-C came before any drive was found.
    """
    if task.order == "anytime":
        return plan_anytime(task)
    return _plan_turning(task) if task.vehicle.drive == "diff" else plan_cars(task)


def _plan_turning(task: Task) -> PlannedDrive:
    """Plan for a robot that turns in place: by the search, or by stops if most missing headings are scattered.

    Cells with many missing bins are covered again as a whole. One turn passes all headings of a cell,
    scattered headings need nearly the same turn, and the search finds longer paths between them.
    """
    missing = bins_to_visit(task)
    unmet = replace(task.coverage, counts=np.zeros_like(task.coverage.counts))
    todo = bins_to_visit(replace(task, coverage=unmet))
    left, all_bins = (bins.sum(axis=2, keepdims=True) for bins in (missing, todo))
    if 2 * left[left <= SCATTERED_SHARE * all_bins].sum() > left.sum():
        return plan_stop_and_spin(task)
    wanted = missing | (todo & (left > OPEN_SHARE * all_bins))
    return plan_spins(replace(task, coverage=replace(task.coverage, counts=np.where(wanted, 0, 1))))
