"""What the search leaves to a car: OMPL drives to the nearest of all missing bins, all it crosses counts, and so on.

One query holds a pose in every missing bin as its goals (`ob.GoalStates`); the shortest move comes first where it is
clear. Where enough is missing at the end of a way, the search takes over again from there: so a car comes over floors
that the search's own flood gives up on, to the first room of a resumed plan, and to the bins that its lattice cannot
meet. Where OMPL finds no way, a car that only goes forward floods the floor for one. A bin is given up when both
were in vain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from planners.arena import wrap
from planners.cars.car_curve import curve_of_arcs
from planners.cars.detours import insert_detours
from planners.cars.reachability import ReachabilityPlanner
from planners.cars.shortcuts import arc_path_of
from planners.curve import Curve
from planners.joins.car_paths import CarPath, connect_cars
from planners.joins.settings import JOINS
from planners.methods.partial_drive import PartialDrive
from planners.methods.settings import CAR_REPAIR
from planners.search.motion_primitives import GEARS, car_primitives
from planners.search.room_drive import RoomDrive
from planners.task import JoinCounts, Task
from planners.types import Bools, Floats, Ints

POSES = np.array(
    [(x, y, turn) for turn in (0.0, -0.3, 0.3) for x in (0.0, -0.3, 0.3) for y in (0.0, -0.3, 0.3)]
)
"""Goals within a bin, in parts of it; the first CAR_REPAIR.few_goals where there are many bins."""
TURNED = np.array([0.0, -0.3, 0.3])
"""Goals at the place of a bin that is farthest from walls, in parts of its heading: slits hold no other."""
SearchOn = Callable[[Bools, Floats, int], RoomDrive | None]
"""(bins wanted, pose (3,) to begin at, seed) -> drive; None where it gets no bin."""


@dataclass(eq=False)
class CarRepair:
    """Completes the drive of a car."""

    task: Task
    todo: Bools
    """(nx, ny, n_phi)"""
    start: Floats
    """(3,) where the car is."""
    search: SearchOn
    joins: JoinCounts = field(default_factory=JoinCounts)

    def __post_init__(self) -> None:
        task, vehicle = self.task, self.task.vehicle
        self.drive = PartialDrive(grid=task.coverage, rate=task.rate, limits=vehicle.limits, here=self.start)
        self.lost: Bools = np.zeros_like(self.todo)
        """(nx, ny, n_phi) bins that no way was found to."""
        self.n_searches: Ints = np.zeros(self.todo.shape, dtype=np.int64)
        """(nx, ny, n_phi) how often each bin was searched for."""
        self._no_ompl_path: Bools = np.zeros_like(self.todo)
        """(nx, ny, n_phi) bins of queries that OMPL found no way for."""
        self._planner = ReachabilityPlanner(task) if len(GEARS[vehicle.drive]) == 1 else None
        """Of a car that only goes forward: another comes back from anywhere."""
        self.heading_offset = car_primitives(
            vehicle.limits, task.coverage.headings, task.rate, GEARS[vehicle.drive]
        ).first_heading
        """[rad] from the middle of a heading bin to the headings that the search likes."""

    def append_curve(self, curve: Curve) -> None:
        """Drive on along a curve that starts here."""
        self.drive = self.drive.extended(curve)

    def replace_all(self, curve: Curve) -> None:
        """Drive a curve in place of all that was driven."""
        self.drive = self.drive.replaced_by(curve)

    def missing(self) -> Bools:
        """Return (nx, ny, n_phi) what the log of some phase misses, but for what is lost."""
        return np.asarray(self.todo & ~self.drive.met & ~self.lost)

    def drive_to(self, pose: Floats, before: tuple[float, ...] = (0.0, *CAR_REPAIR.step_back)) -> bool:
        """Drive to a pose (3,) from so much [s] `without_last` the last drive ended, or more; False where no way is found.

        A drive may end where OMPL finds no way out in its time: what is cut off is missing again.
        """
        here = self.drive.here
        if np.allclose(here[:2], pose[:2]) and abs(wrap(here[2] - pose[2])) < 1e-9:
            return True
        for back in before:
            drive = self.drive.without_last(back)
            if drive is None:
                break
            way = self._connect(drive.here, pose[None], 0)
            if way is not None and way.curve is not None:
                self.drive = drive.extended(way.curve)
                return True
        return False

    def search_path_to(self, wanted: Bools) -> bool:
        """Drive to one of the bins `wanted` by a flood of the whole floor; False where that finds no way.

        Where the lattice of the flood holds no way on from here, one may lead on from somewhat earlier.
        """
        if self._planner is None:
            return False
        missing = self.missing()
        for back, explore in (
            (0.0, False),
            *((back, False) for back in CAR_REPAIR.step_back[:-1]),
            (0.0, True),
        ):
            drive = self.drive.without_last(back)
            curve = None if drive is None else self._planner.path_to_any(wanted, drive.here, explore=explore)
            if drive is None or curve is None:
                continue
            longer = drive.extended(curve)
            if (missing & longer.met).any():  # else too short a stay for some phase of the log
                self.drive = longer
                self.joins += JoinCounts(flooded=1)
                return True
        return False

    def enter_room(self, room: Bools, entry_arc: Floats, curve: Curve, seed: int) -> None:
        """Drive through a room, bins (nx, ny, n_phi), by the curve that begins at a pose (3,), or from where a way leads."""
        if self.drive_to(entry_arc, (0.0,)):
            self.append_curve(curve)
        elif self.search_path_to(room & self.missing()):
            visit = self.search(room & self.missing(), self.drive.here, seed)
            if visit is not None:
                self.append_curve(visit.curve)
        elif self.drive_to(entry_arc, CAR_REPAIR.step_back):
            self.append_curve(curve)

    def add_detours(self, speed: float) -> None:
        """Insert detours at some speed [m/s] into what was driven, to bins beside it that are missing, or lost."""
        lost, self.lost = self.lost, np.zeros_like(self.lost)
        missing = self.missing()
        bins, goals = goals_in(missing, self.drive.here, self.heading_offset, self.task)
        if self.drive.curves and len(bins):
            curve, limits = self.drive.curve, self.task.vehicle.limits
            drive, ground = arc_path_of(curve, self.todo, self.task, speed)
            own = np.ravel_multi_index(tuple(bins.T), missing.shape)
            longer = insert_detours(drive, goals, own, ground)
            if len(longer.length) > len(drive.length):
                self.replace_all(
                    curve_of_arcs(curve.poses[0], longer.length, longer.bend, longer.gear, limits, speed)
                )
        self.lost = lost & self.missing()

    def run(self) -> None:
        """Drive to missing bins until none is left, or all that is left is lost."""
        fewest, idle = self.todo.size, 0
        for round_ in count():
            missing = self.missing()
            n = int(missing.sum())
            fewest, idle = min(n, fewest), 0 if n < fewest else idle + 1
            if n == 0:
                return
            if idle > CAR_REPAIR.max_idle_queries:
                self.lost |= missing
                return
            near = missing & (self.n_searches < CAR_REPAIR.max_searches) & self._nearby_cells()[:, :, None]
            if (
                self.drive.curves
                and near.sum() >= CAR_REPAIR.search_from
                and self._search_nearby(near, round_)
            ):
                continue
            self._drive_to_one_of(missing, round_)

    def _drive_to_one_of(self, missing: Bools, round_: int) -> None:
        """Drive to one of some bins by OMPL, or by a flood where OMPL finds no way; lose what both come to in vain."""
        bins, goals = goals_in(missing & ~self._no_ompl_path, self.drive.here, self.heading_offset, self.task)
        if self._planner is not None and len(bins):  # it may be trapped in a corner
            can_return = self._planner.can_return(goals, self.drive.here)
            bins, goals = bins[can_return], goals[can_return]
        way = self._connect(self.drive.here, goals, round_) if len(bins) else None
        if way is None:
            self._no_ompl_path[tuple(bins.T)] = True
            if not self.search_path_to(missing):
                self.lost[tuple(bins.T)] = True
                if not len(bins):  # no free place within any: slits between the raster's nodes
                    self.lost |= missing
            return
        goal = tuple(bins[way.goal])
        if way.curve is not None:
            self.append_curve(way.curve)
        self.lost[goal] = self.missing()[goal]  # driven to, but not long enough within it

    def _nearby_cells(self) -> Bools:
        """Return the cells (nx, ny) near here: a search does not get to others."""
        rows, columns = np.indices(self.todo.shape[:2])
        i, k = _cell(self.drive.here, self.task)
        return np.asarray(np.hypot(rows - i, columns - k) * self.task.reach.cell <= CAR_REPAIR.search_radius)

    def _search_nearby(self, wanted: Bools, round_: int) -> bool:
        """Let the search go on from here; say whether it got something."""
        visit = self.search(wanted, self.drive.here, self.task.seed + round_)
        self.n_searches += wanted
        if visit is None or visit.left >= wanted.sum():
            return False
        self.append_curve(visit.curve)
        return True

    def _connect(self, start: Floats, goals: Floats, round_: int) -> CarPath | None:
        task = self.task
        travel_times, joins = connect_cars(
            start[None],
            [goals],
            reach=task.reach,
            barriers=task.barriers,
            vehicle=task.vehicle,
            seed=task.seed + round_,
        )
        self.joins += joins
        return travel_times[0]


def goals_in(missing: Bools, here: Floats, heading_offset: float, task: Task) -> tuple[Ints, Floats]:
    """Return poses (n, 3) in the bins that are missing, the nearest first, and the bin (n, 3) of each.

    Parameters
    ----------
    aside : [rad] from the middle of a heading bin to the headings that the search likes
    """
    reach, grid = task.reach, task.coverage
    bins = np.argwhere(missing)
    bins = bins[np.argsort(np.hypot(*(bins[:, :2] - _cell(here, task)).T), kind="stable")[: JOINS.max_goals]]
    shares = POSES if len(bins) * len(POSES) <= JOINS.max_goals else POSES[: CAR_REPAIR.few_goals]  # (p, 3)
    own = np.repeat(bins, len(shares), axis=0)
    x, y, turn = np.tile(shares, (len(bins), 1)).T
    deepest, turns = np.repeat(bins, len(TURNED), axis=0), np.tile(TURNED, len(bins))
    standing_places = np.concatenate(
        [
            reach.origin + (own[:, :2] + 0.5 + np.column_stack([x, y])) * reach.cell,
            reach.deepest(deepest[:, :2]),
        ]
    )
    bins, turn = np.concatenate([own, deepest]), np.append(turn, turns)
    heading = (bins[:, 2] + turn) * (2 * np.pi / grid.headings) + heading_offset
    node = np.floor((standing_places - reach.origin) / reach.step).astype(np.int64)
    free = reach.mask[node[:, 0], node[:, 1]]
    return bins[free], np.column_stack([standing_places, wrap(heading)])[free]


def _cell(pose: Floats, task: Task) -> Floats:
    return np.asarray((pose[:2] - task.reach.origin) / task.reach.cell - 0.5)
