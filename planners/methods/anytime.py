"""Anytime order of a coverage plan: every prefix shows as much as possible, and the whole drive is complete.

The drive has three phases:

1. Rounds of views through the floor, chosen by what the sensor has not seen (`overview`), for the first
   minutes.
2. Rounds of spins, chosen the same way. Each spin completes a cell, which the final search then leaves out. A
   round
   therefore costs the plan only its transits.
3. A search that completes all remaining cells.

Without a survey, phases 1 and 2 are replaced by a spin in one cell of every 3 m block.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners import order
from planners.curve import join_curves
from planners.errors import PlanError
from planners.methods.coverage_spins import plan_spins
from planners.methods.overview import FIRST_ROUND, choose_spins, overview
from planners.methods.stop_and_spin import StopAndSpinPlanner, bins_to_visit, standing_places
from planners.order import CellGraph
from planners.report import reference_time
from planners.search.log_phases import met
from planners.task import PlannedDrive, Survey, Task
from planners.types import Bools, Floats, Ints, Progress

VIEW_SHARE = 0.03
"""Total duration of the rounds of views, as a share of the reference time; as the others, set with
`python -m benchmarks.error_by_minutes --arena office` (seed 1)."""
SPIN_SHARE = 0.135
"""End of the last round of spins, as a share of the reference time; with more, the office takes more than 1.25 of it."""
SPIN_GROWTH = 0.5
"""Duration of each round of spins, as a share of the drive before it."""
LOOK_PERIOD = 0.2
"""[s] between scans of a drive that are marked as seen."""
BLOCK = 3.0
"""[m] side of blocks: without a survey, one cell of each block is completed before all others
(`python -m benchmarks.coverage_planners --order anytime`)."""


def plan_anytime(task: Task) -> PlannedDrive:
    """Plan a drive that shows most first and is complete at its end.

    Raises
    ------
    PlanError : A priority is given, or every bin is covered already.
    KeyboardInterrupt : Ctrl-C came before any drive was found.
    """
    if task.priority is not None:
        raise PlanError("a priority excludes the order anytime; leave out `priority` or use order fast")
    drive = _AnytimeDrive(task, bins_to_visit(task))
    try:
        reference, survey = reference_time(task.coverage, task.vehicle), task.survey
        if survey is None:
            drive.spin(_one_in_each(drive.missing, BLOCK, task))
        else:
            drive.look(survey, VIEW_SHARE * reference)
            drive.spin_by_survey(survey, SPIN_SHARE * reference)
        if not drive.is_enough:
            drive.complete()
    except KeyboardInterrupt:
        if not drive.parts:
            raise
        drive.interrupted = True
    return drive.planned()


class _AnytimeDrive:
    """The drive so far, and the bins that it has not covered."""

    def __init__(self, task: Task, todo: Bools) -> None:
        self.task, self.todo, self.missing = task, todo, todo.copy()
        self.total = int(todo.sum())
        self.parts: list[PlannedDrive] = []
        self.interrupted = False
        self.clock = 0.0

    @property
    def is_enough(self) -> bool:
        """Whether planning can end."""
        budget = self.task.budget
        return self.interrupted or not self.missing.any() or (budget is not None and self.clock > budget)

    @property
    def here(self) -> Floats | None:
        """(3,) end pose of the drive so far."""
        if not self.parts:
            return self.task.start
        return self.parts[-1].curve.end

    def add(self, part: PlannedDrive) -> None:
        """Append a drive that begins where this one ends, and remove its bins from the missing ones."""
        task, curve = self.task, part.curve
        self.missing &= ~met(curve, task.coverage, task.rate, self.clock).all(axis=0)
        self.parts.append(part)
        self.clock += curve.duration
        self.interrupted |= part.interrupted
        if task.progress and task.budget is None:  # with a budget, most bins stay missing
            task.progress(self.total - int(self.missing.sum()), self.total)

    def _mark(self, survey: Survey) -> None:
        """Mark as seen what the last part shows, and report the progress of the overview."""
        curve = self.parts[-1].curve
        survey.mark(curve.sample(np.arange(0.0, curve.duration, LOOK_PERIOD))[0])
        budget = self.task.budget
        of = "" if budget is None else f" of {budget / 60:.0f}"
        self.task.show_status(f"overview, {self.clock / 60:.0f}{of} min of driving so far")

    def look(self, survey: Survey, until: float) -> None:
        """Drive rounds of views up to a time [s] of the drive, or until planning can end."""
        for part in overview(self.task, survey, self.here, driven=self.clock, until=until):
            self.add(part)
            self._mark(survey)
            if self.is_enough:
                return

    def spin_by_survey(self, survey: Survey, until: float) -> None:
        """Drive rounds of spins, which complete cells, up to a time [s] of the drive or until planning can end."""
        rng = np.random.default_rng(self.task.seed)
        while (here := self.here) is not None and not self.is_enough and self.clock < until:
            length = min(max(FIRST_ROUND, SPIN_GROWTH * self.clock), until - self.clock)
            cells = choose_spins(self.task, survey, here, self.missing & self._open(), length, rng)
            if not cells.any():
                return
            self.spin(cells)
            self._mark(survey)

    def spin(self, cells: Bools) -> None:
        """Complete cells (nx, ny, 1) with one spin each."""
        wanted = np.asarray(self.missing & cells)
        self.add(_SpinTour(self._part(wanted), wanted).run())

    def complete(self) -> None:
        """Complete all cells.

        Open cells are covered again as a whole: their scattered missing bins would cost a search more than
        all bins.
        """
        self.add(plan_spins(self._part(np.asarray(self.missing | self.todo & self._open()))))

    def _open(self) -> Bools:
        """Return the open cells (nx, ny, 1): those with more than half of their bins missing."""
        return np.asarray(2 * self.missing.sum(axis=2, keepdims=True) > self.todo.sum(axis=2, keepdims=True))

    def _part(self, wanted: Bools) -> Task:
        """Return the task to cover the bins `wanted` (nx, ny, n_phi) from the end of the drive so far."""
        grid = replace(self.task.coverage, counts=np.where(wanted, 0, 1))
        left = int((self.missing & wanted).sum())
        return replace(self.task, coverage=grid, start=self.here, progress=self._progress(left))

    def _progress(self, wanted: int) -> Progress | None:
        """Return a progress callback that maps the progress of a part with `wanted` bins to the whole drive."""
        tick, done, total = self.task.progress, self.total - int(self.missing.sum()), self.total
        if tick is None or self.task.budget is not None:
            return None
        whole = tick  # narrows the type for the lambda
        return lambda n, of: whole(done + round(n * wanted / max(of, 1)), total)

    def planned(self) -> PlannedDrive:
        """Return all parts as one drive."""
        lost = [part.lost for part in self.parts if part.lost is not None]
        joins = self.parts[0].joins
        for part in self.parts[1:]:
            joins += part.joins
        return PlannedDrive(
            curve=join_curves([part.curve for part in self.parts]),
            stops=np.concatenate([part.stops for part in self.parts]),
            joins=joins,
            interrupted=self.interrupted,
            lost=np.asarray(np.any(lost, axis=0)) if lost else None,
        )


class _SpinTour(StopAndSpinPlanner):
    """Spins in scattered cells, ordered to save driving time."""

    def _sequence(self, cells: CellGraph, todo: Bools) -> Ints:
        reach, limits = self.task.reach, self.task.vehicle.limits
        floor = standing_places(reach, self.task.barriers, reach.cells()[:, :, None] | todo)
        return order.visiting_order(floor, cells.places, self._here(), limits, self.task.seed)


def _one_in_each(missing: Bools, block: float, task: Task) -> Bools:
    """Return the cells (nx, ny, 1) with missing bins, one in each block with sides of `block` [m].

    It is the cell with the largest reachable area; ties go to the cell nearest to the middle of the block.
    """
    cells, size = np.asarray(missing.any(axis=2)), max(round(block / task.reach.cell), 1)
    row, column = np.indices(cells.shape, dtype=np.int64)
    number: Ints = row // size * -(-cells.shape[1] // size) + column // size
    off = np.asarray(np.hypot(row % size - (size - 1) / 2, column % size - (size - 1) / 2))
    choice = np.flatnonzero(cells)
    area = task.reach.areas().ravel()[choice].round(1)
    best = choice[np.lexsort((off.ravel()[choice], -area, number.ravel()[choice]))]
    _, first = np.unique(number.ravel()[best], return_index=True)
    out = np.zeros(cells.size, dtype=np.bool_)
    out[best[first]] = True
    return out.reshape(*cells.shape, 1)
