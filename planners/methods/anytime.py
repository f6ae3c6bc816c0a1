"""The anytime order of a coverage plan: a drive of which every prefix is worth its minutes, and whose end is complete.

It begins with an overview (`overview`): rounds through the floor by what the sensor has not seen. Then it completes
single cells evenly over the floor, one in every block of 3 m, unless a graph of earlier runs says where to look; then
it looks where least was seen for further rounds; and at last it completes all cells. What was met before counts, so
that the whole takes little longer than the order `fast`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners import order
from planners.curve import join_curves
from planners.errors import PlanError
from planners.methods.coverage_spins import plan_spins
from planners.methods.overview import overview
from planners.methods.settings import ANYTIME, OVERVIEW
from planners.methods.stop_and_spin import StopAndSpinPlanner, bins_to_visit, standing_places
from planners.order import CellGraph
from planners.report import reference_time
from planners.search.log_phases import met
from planners.task import PlannedDrive, Task
from planners.types import Bools, Floats, Ints, Progress


def plan_anytime(task: Task) -> PlannedDrive:
    """Plan a drive that shows most first, and is complete at its end.

    Raises
    ------
    PlanError : a priority is given, or every bin is covered already
    KeyboardInterrupt : Ctrl-C came before anything was found
    """
    if task.priority is not None:
        raise PlanError("a priority is an order of its own; leave out the order anytime")
    drive = _AnytimeDrive(task, bins_to_visit(task))
    try:
        reference = reference_time(task.coverage, task.vehicle)
        if drive.look(OVERVIEW.share * reference, OVERVIEW.growth):
            return drive.planned()
        is_informed = task.survey is not None and task.survey.asks_a_graph
        for level in () if is_informed else ANYTIME.blocks:
            if drive.complete(level) and drive.is_enough:
                return drive.planned()
        if not drive.look(OVERVIEW.later_share * reference, OVERVIEW.later_growth):
            drive.complete(task.reach.cell)
    except KeyboardInterrupt:
        if not drive.parts:
            raise
        drive.interrupted = True
    return drive.planned()


class _AnytimeDrive:
    """The drive so far, and what it has met."""

    def __init__(self, task: Task, todo: Bools) -> None:
        self.task, self.missing = task, todo
        self.total = int(todo.sum())
        self.parts: list[PlannedDrive] = []
        self.interrupted = False
        self.clock = 0.0

    @property
    def is_enough(self) -> bool:
        """Whether nothing more need be planned."""
        budget = self.task.budget
        return self.interrupted or not self.missing.any() or (budget is not None and self.clock > budget)

    @property
    def here(self) -> Floats | None:
        """(3,) where the drive so far ends."""
        if not self.parts:
            return self.task.start
        curve = self.parts[-1].curve
        return np.asarray(curve.sample(np.array([curve.duration]))[0][0])

    def add(self, part: PlannedDrive) -> None:
        """Append a drive that begins where this one ends."""
        task = self.task
        self.missing &= ~met(part.curve, task.coverage, task.rate, self.clock).all(axis=0)
        self.parts.append(part)
        self.clock += part.curve.duration
        self.interrupted |= part.interrupted
        if task.progress and task.budget is None:  # a budget leaves most bins out
            task.progress(self.total - int(self.missing.sum()), self.total)

    def look(self, until: float, growth: float) -> bool:
        """Drive rounds of an overview until so many seconds of the drive; True if nothing more need be planned."""
        task = self.task
        if task.survey is not None:
            for part in overview(task, task.survey, self.here, driven=self.clock, until=until, growth=growth):
                self.add(part)
                self._mark(part)
                of = "" if task.budget is None else f" of {task.budget / 60:.0f}"
                task.say(f"overview, {self.clock / 60:.0f}{of} min of driving so far")
                if self.is_enough:
                    return True
        return False

    def _mark(self, part: PlannedDrive) -> None:
        """Count what a part shows as seen."""
        if self.task.survey is not None:
            seen = np.arange(0.0, part.curve.duration, OVERVIEW.look_period)
            self.task.survey.mark(part.curve.sample(seen)[0])

    def complete(self, block: float) -> bool:
        """Complete one cell in every block of that side [m]; False if there is none to complete."""
        task = self.task
        wanted = self.missing & _one_in_each(
            self._whole(), self.missing, max(round(block / task.reach.cell), 1), task
        )
        if not wanted.any():
            return False
        if block > task.reach.cell:
            task.say(f"a spin in every {block:g} m, after {self.clock / 60:.0f} min of driving")
        grid = replace(task.coverage, counts=np.where(wanted, 0, 1))
        part = replace(task, coverage=grid, start=self.here, progress=self._progress(int(wanted.sum())))
        is_last = block <= task.reach.cell
        self.add(plan_spins(part) if is_last else _SpinTour(part, wanted).run())
        if not is_last:
            self._mark(self.parts[-1])
        return True

    def _whole(self) -> Bools:
        """(nx, ny) cells that count and miss nothing."""
        return np.asarray(self.task.coverage.reachable.any(axis=2) & ~self.missing.any(axis=2))

    def _progress(self, wanted: int) -> Progress | None:
        """Return the progress of a level that completes so many bins, as a part of the whole."""
        tick, done, total = self.task.progress, self.total - int(self.missing.sum()), self.total
        if tick is None or self.task.budget is not None:
            return None
        whole = tick  # known to be a function, also within the next one
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
    """Spins in cells that lie apart, in an order that saves driving."""

    def _sequence(self, cells: CellGraph, todo: Bools) -> Ints:
        reach, limits = self.task.reach, self.task.vehicle.limits
        floor = standing_places(reach, self.task.barriers, reach.cells()[:, :, None] | todo)
        number = np.full(reach.shape, -1)
        number[tuple(floor.index.T)] = np.arange(len(floor.index))
        near = number[tuple(cells.index.T)]
        here = self._here()
        if here is not None:
            near = np.append(near, ((floor.places - here[:2]) ** 2).sum(axis=1).argmin())
        cost = order.travel_times(floor, np.repeat(near, 2), limits.v, limits.v / limits.a)
        first = None if here is None else 2 * len(cells.index)
        found = order.tour(cost, first, np.random.default_rng(self.task.seed))
        return np.array([k for k, _ in found if k < len(cells.index)])


def _one_in_each(whole: Bools, missing: Bools, size: int, task: Task) -> Bools:
    """Return (nx, ny, 1) one cell with missing bins of every block of `size` x `size` cells that has no whole cell yet.

    It is the roomiest, and of these the nearest to the middle of its block.
    """
    cells = np.asarray(missing.any(axis=2))
    if size == 1:
        return np.asarray(cells[:, :, None])
    row, column = np.indices(cells.shape, dtype=np.int64)
    block: Ints = row // size * -(-cells.shape[1] // size) + column // size
    off = np.asarray(np.hypot(row % size - (size - 1) / 2, column % size - (size - 1) / 2))
    choice = np.flatnonzero(cells & ~np.asarray(np.isin(block, block[whole])))
    area = task.reach.areas().ravel()[choice].round(1)
    best = choice[np.lexsort((off.ravel()[choice], -area, block.ravel()[choice]))]
    _, first = np.unique(block.ravel()[best], return_index=True)
    out = np.zeros(cells.size, dtype=np.bool_)
    out[best[first]] = True
    return out.reshape(*cells.shape, 1)
