"""What the search leaves: OMPL drives to the nearest of all missing bins, all it crosses counts, and so on.

One query holds a pose in every missing bin as its goals (`ob.GoalStates`); the straight or shortest move comes first
where it is clear. A robot that turns in place passes all headings that are missing where it arrives. Where enough is
missing at the end of a car's way, the search takes over again from there: so a car comes over floors that the search's
own flood gives up on, to the first room of a resumed plan, and to the bins that its lattice cannot meet. A bin is
given up when a query for it was in vain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from planners.arena import Bools, Floats, wrap
from planners.car_connect import CarWay, connect_cars
from planners.connect import Joins, connect_nearest
from planners.coverage_planner import DWELL, Task, places
from planners.order import Ints
from planners.primitives import aim
from planners.search import Visit
from planners.search_cars import arcs_of, geared, redriven
from planners.search_detours import with_detours
from planners.search_drive import drive_of, ground_of
from planners.search_flood import Ways
from planners.search_log import PHASES, met, missed
from planners.search_table import GEARS, driving
from planners.search_words import NONE, part_of
from planners.steering import Curve, Pen, joined

IDLE = 12
"""Queries in a row after which no fewer bins are missing, at most: a way on from before the end may cut others off."""
MOST_GOALS = 400
"""Of one query, the nearest ones."""
BACK = (4.0, 16.0, 64.0, 256.0)
"""[s] before the end of a drive from where a way on is looked for."""
AGAIN = 12
"""Missing bins from which on the search takes over."""
SEARCHES = 3
"""Times that one bin is searched for, at most."""
NEAR = 3.0
"""[m] within which they are."""
FEW = 9
POSES = np.array(
    [(x, y, turn) for turn in (0.0, -0.3, 0.3) for x in (0.0, -0.3, 0.3) for y in (0.0, -0.3, 0.3)]
)
"""Goals within a bin, in parts of it; the first FEW where there are many bins."""
TURNED = np.array([0.0, -0.3, 0.3])
"""Goals at the place of a bin that is farthest from walls, in parts of its heading: slits hold no other."""

TURNS = 2
"""Times that a robot stops in a cell for what is missing there, at most."""
TIGHT = 1e-9
"""[m] moves shorter than this are none."""

SearchOn = Callable[[Bools, Floats, int], Visit | None]
"""(bins wanted, pose (3,) to begin at, seed) -> drive; None where it gets no bin."""


@dataclass(eq=False)
class CarRepair:
    """Completes the drive of a car."""

    task: Task
    todo: Bools
    """(nx, ny, n_phi)"""
    here: Floats
    """(3,) where the car is."""
    search: SearchOn
    curves: list[Curve] = field(default_factory=list)
    joins: Joins = field(default_factory=Joins)

    def __post_init__(self) -> None:
        self.lost: Bools = np.zeros_like(self.todo)
        """(nx, ny, n_phi) bins that no way was found to."""
        self._in_vain: Bools = np.zeros_like(self.todo)
        """(nx, ny, n_phi) bins of queries that OMPL found no way for."""
        self._kept: tuple[list[Curve], float, Bools] = [], 0.0, self._none()
        """All curves but the last, their time [s], and what a log of each phase meets on them."""
        self.tried: Ints = np.zeros(self.todo.shape, dtype=np.int64)
        """(nx, ny, n_phi) how often each bin was searched for."""
        self._ways = Ways(self.task)
        limits, drive = self.task.robot.limits, self.task.robot.drive
        self._is_forward_only = len(GEARS[drive]) == 1
        table = driving(limits, self.task.coverage.headings, self.task.rate, GEARS[drive])
        self.aside = table.first
        """[rad] from the middle of a heading bin to the headings that the search likes."""

    def take(self, curve: Curve) -> None:
        """Drive on along a curve that starts here."""
        self.curves = [*self.curves, curve]
        self.here = curve.sample(np.array([curve.duration]))[0][0]

    def comes_to(self, pose: Floats, before: tuple[float, ...] = (0.0, *BACK)) -> bool:
        """Drive to a pose (3,) from so much [s] `before` the last drive ended, or more; False where no way is found.

        A drive may end where OMPL finds no way out in its time: what is cut off is missing again.
        """
        if np.allclose(self.here[:2], pose[:2]) and abs(wrap(self.here[2] - pose[2])) < 1e-9:
            return True
        for back in before:
            kept = self._until(back)
            if back and not kept:
                break
            begin = kept[-1].sample(np.array([kept[-1].duration]))[0][0] if back else self.here
            way = self._way(begin, pose[None], 0)
            if way is not None and way.curve is not None:
                self.curves = kept
                self.take(way.curve)
                return True
        return False

    def floods_to(self, wanted: Bools) -> bool:
        """Drive to one of the bins `wanted` by a flood of the whole floor; False where that finds no way.

        Where the lattice of the flood holds no way on from here, one may lead on from somewhat earlier.
        """
        if not self._is_forward_only:
            return False
        kept, here, before = self.curves, self.here, self.missing()
        for back, anew in ((0.0, False), *((back, False) for back in BACK[:-1]), (0.0, True)):
            self.curves, self.here = kept, here
            if back:
                if not (shorter := self._until(back)):
                    continue
                *self.curves, last = shorter
                self.take(last)
            curve = self._ways.to_one_of(wanted, self.here, anew=anew)
            if curve is None:
                continue
            self.take(curve)
            if (before & ~self.missing()).any():  # else too short a stay for some phase of the log
                self.joins += Joins(flooded=1)
                return True
        self.curves, self.here = kept, here
        return False

    def enters(self, room: Bools, begin: Floats, curve: Curve, seed: int) -> None:
        """Drive through a room, bins (nx, ny, n_phi), by the curve that begins at a pose (3,), or from where a way leads."""
        if self.comes_to(begin, (0.0,)):
            self.take(curve)
        elif self.floods_to(room & self.missing()):
            visit = self.search(room & self.missing(), self.here, seed)
            if visit is not None:
                self.take(visit.curve)
        elif self.comes_to(begin, BACK):
            self.take(curve)

    def _until(self, back: float) -> list[Curve]:
        """Return the curves without the last `back` [s]; none where that is more than the last of them."""
        if back == 0.0 or not self.curves:
            return self.curves
        *before, curve = self.curves
        last = int(np.searchsorted(curve.starts, curve.duration - back, side="right")) - 1
        return [*before, redriven(curve, 0, last, self.task.robot.limits)] if last > 0 else []

    def missing(self) -> Bools:
        """Return (nx, ny, n_phi) what the log of some phase misses, but for what is lost."""
        last, clock, seen = self._kept
        if self.curves[: len(last)] != last:  # some drive was cut, or all shortened
            last, clock, seen = [], 0.0, self._none()
        grid, rate = self.task.coverage, self.task.rate
        for curve in self.curves[len(last) : -1]:
            seen |= met(curve, grid, rate, clock)
            clock += curve.duration
        self._kept = self.curves[:-1], clock, seen
        if self.curves:
            seen = seen | met(self.curves[-1], grid, rate, clock)
        return np.asarray(self.todo & ~seen.all(axis=0) & ~self.lost)

    def passes_by(self, speed: float) -> None:
        """Insert detours at some speed [m/s] into what was driven, to bins beside it that are missing, or lost."""
        lost, self.lost = self.lost, np.zeros_like(self.lost)
        missing = self.missing()
        bins, goals = goals_in(missing, self.here, self.aside, self.task)
        if self.curves and len(bins):
            task, curve = self.task, joined(self.curves)
            limits, is_backward = task.robot.limits, len(GEARS[task.robot.drive]) > 1
            ground = ground_of(task.reach, self.todo, limits, speed, task.rate, is_backward=is_backward)
            arcs = arcs_of(curve)
            drive, _ = drive_of(curve.poses[0], part_of(arcs, arcs.length > NONE), ground)
            own = np.ravel_multi_index(tuple(bins.T), missing.shape)
            longer = with_detours(drive, goals, own, ground)
            if len(longer.length) > len(drive.length):
                self.curves = [geared(curve.poses[0], longer.length, longer.bend, longer.gear, limits, speed)]
        self.lost = lost & self.missing()

    def _none(self) -> Bools:
        return np.zeros((PHASES, *self.todo.shape), dtype=np.bool_)

    def run(self) -> None:
        """Drive to missing bins until none is left, or all that is left is lost."""
        fewest, idle = self.todo.size, 0
        for round_ in count():
            missing = self.missing()
            n = int(missing.sum())
            fewest, idle = min(n, fewest), 0 if n < fewest else idle + 1
            if n == 0:
                return
            if idle > IDLE:
                self.lost |= missing
                return
            near = missing & (self.tried < SEARCHES) & self._around()[:, :, None]
            if self.curves and near.sum() >= AGAIN and self._searched(near, round_):
                continue
            self._drive_to_one_of(missing, round_)

    def _drive_to_one_of(self, missing: Bools, round_: int) -> None:
        """Drive to one of some bins by OMPL, or by a flood where OMPL finds no way; lose what both come to in vain."""
        bins, goals = goals_in(missing & ~self._in_vain, self.here, self.aside, self.task)
        if self._is_forward_only and len(bins):  # it may be trapped in a corner
            leads_back = self._ways.leads_back(goals, self.here)
            bins, goals = bins[leads_back], goals[leads_back]
        way = self._way(self.here, goals, round_) if len(bins) else None
        if way is None:
            self._in_vain[tuple(bins.T)] = True
            if not self.floods_to(missing):
                self.lost[tuple(bins.T)] = True
                if not len(bins):  # no free place within any: slits between the raster's nodes
                    self.lost |= missing
            return
        goal = tuple(bins[way.goal])
        if way.curve is not None:
            self.take(way.curve)
        self.lost[goal] = self.missing()[goal]  # driven to, but not long enough within it

    def _around(self) -> Bools:
        """Return the cells (nx, ny) near here: a search does not get to others."""
        rows, columns = np.indices(self.todo.shape[:2])
        i, k = _cell(self.here, self.task)
        return np.asarray(np.hypot(rows - i, columns - k) * self.task.reach.cell <= NEAR)

    def _searched(self, wanted: Bools, round_: int) -> bool:
        """Let the search go on from here; say whether it got something."""
        visit = self.search(wanted, self.here, self.task.seed + round_)
        self.tried += wanted
        if visit is None or visit.left >= wanted.sum():
            return False
        self.take(visit.curve)
        return True

    def _way(self, start: Floats, goals: Floats, round_: int) -> CarWay | None:
        task = self.task
        ways, joins = connect_cars(
            start[None],
            [goals],
            reach=task.reach,
            barriers=task.barriers,
            robot=task.robot,
            seed=task.seed + round_,
        )
        self.joins += joins
        return ways[0]


@dataclass(eq=False)
class SpinRepair:
    """Completes the drive of a robot that turns in place: to the nearest cell that misses headings, and a turn there."""

    task: Task
    missing: Bools
    """(nx, ny, n_phi)"""
    here: Floats
    """(3,) where the robot stands."""
    curves: list[Curve] = field(default_factory=list)
    stops: list[tuple[float, float, float, float]] = field(default_factory=list)
    joins: Joins = field(default_factory=Joins)

    def __post_init__(self) -> None:
        self.missing = self.missing.copy()
        self.lost: Bools = np.zeros_like(self.missing)
        """(nx, ny, n_phi) bins that no way was found to."""

    def run(self) -> None:
        """Drive to missing bins until none is left, or all that is left is lost."""
        cells = places(self.task.reach, self.task.barriers, self.missing)
        visits = np.zeros(len(cells.index), dtype=np.int64)
        for round_ in range(TURNS * len(visits)):
            wanted = np.flatnonzero(self.missing[tuple(cells.index.T)].any(axis=1) & (visits < TURNS))
            if not len(wanted):
                break
            path, joins = connect_nearest(
                self.here[:2],
                cells.places[wanted],
                reach=self.task.reach,
                barriers=self.task.barriers,
                seed=self.task.seed + round_,
            )
            self.joins += joins
            if path is None:
                self.lost = self.missing.copy()
                break
            at = wanted[np.hypot(*(cells.places[wanted] - path[-1]).T).argmin()]
            visits[at] += 1
            self._visit(path, self.missing[tuple(cells.index[at])])

    def _visit(self, path: Floats, need: Bools) -> None:
        """Drive along a path (k, 2) [m] and turn through the headings `need` (n_phi,) at its end."""
        task = self.task
        width = 2 * np.pi / task.coverage.headings
        pen = Pen(self.here, task.robot.limits, spin=width * task.rate / DWELL)
        lead(pen, path)
        pen.turn(aim(pen, None, need, (0.0, 0.0)).angle, "spin")
        pen.wait(1.0 / task.rate)
        self.curves.append(pen.curve())
        self.stops += pen.stops
        self.here = pen.pose
        self.missing &= missed(self.curves[-1], self.missing, task.coverage, task.rate)


def lead(pen: Pen, path: Floats) -> None:
    """Drive along a path (k, 2) [m] from where the pen is."""
    for corner in path[1:]:
        way = corner - pen.pose[:2]
        length = float(np.hypot(*way))
        if length > TIGHT:
            pen.turn(float(wrap(np.float64(np.arctan2(way[1], way[0]) - pen.pose[2]))), "turn")
            pen.move(length, "move" if len(path) == 2 else "join")


def goals_in(missing: Bools, here: Floats, aside: float, task: Task) -> tuple[Ints, Floats]:
    """Return poses (n, 3) in the bins that are missing, the nearest first, and the bin (n, 3) of each.

    Parameters
    ----------
    aside : [rad] from the middle of a heading bin to the headings that the search likes
    """
    reach, grid = task.reach, task.coverage
    bins = np.argwhere(missing)
    bins = bins[np.argsort(np.hypot(*(bins[:, :2] - _cell(here, task)).T), kind="stable")[:MOST_GOALS]]
    shares = POSES if len(bins) * len(POSES) <= MOST_GOALS else POSES[:FEW]  # (p, 3)
    own = np.repeat(bins, len(shares), axis=0)
    x, y, turn = np.tile(shares, (len(bins), 1)).T
    deepest, turns = np.repeat(bins, len(TURNED), axis=0), np.tile(TURNED, len(bins))
    places = np.concatenate(
        [
            reach.origin + (own[:, :2] + 0.5 + np.column_stack([x, y])) * reach.cell,
            reach.deepest(deepest[:, :2]),
        ]
    )
    bins, turn = np.concatenate([own, deepest]), np.append(turn, turns)
    heading = (bins[:, 2] + turn) * (2 * np.pi / grid.headings) + aside
    node = np.floor((places - reach.origin) / reach.step).astype(np.int64)
    free = reach.mask[node[:, 0], node[:, 1]]
    return bins[free], np.column_stack([places, wrap(heading)])[free]


def _cell(pose: Floats, task: Task) -> Floats:
    return np.asarray((pose[:2] - task.reach.origin) / task.reach.cell - 0.5)
