"""Complete a car's drive: drive to the nearest missing bin by OMPL, count the bins on the path, and repeat.

All missing bins are goals of one query (`ob.GoalStates`); the shortest curve is tried first. If many bins are
missing where a path ends, the search continues from there. This leads a car across floors on which the search
gave up, to the first room of a resumed plan, and to bins that the lattice of the search cannot cover. If OMPL
finds no path, a wavefront over the whole floor is tried. A bin is given up when both fail.

`PartialDrive` is the drive during planning. It can be continued from before its end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count

import numpy as np

from planners.arena import wrap
from planners.cars.car_curve import car_section, curve_of_arcs
from planners.cars.detours import insert_detours
from planners.cars.reachability import ReachabilityPlanner
from planners.cars.shortcuts import arc_path_of
from planners.coverage import Coverage
from planners.curve import Curve, join_curves
from planners.joins.car_paths import CarPath, connect_car
from planners.search.log_phases import PHASES, met
from planners.search.motion_primitives import GEARS, car_primitives
from planners.search.room_drive import RoomDrive
from planners.task import JoinCounts, Task
from planners.types import Bools, Floats, Ints
from planners.vehicle import Limits


@dataclass(frozen=True, kw_only=True, eq=False)
class PartialDrive:
    """Consecutive curves of a car; immutable: every change returns a new drive."""

    grid: Coverage
    """Grid of bins; the counts are not used."""
    rate: float
    """[Hz] of the log."""
    limits: Limits
    here: Floats
    """(3,) [m, m, rad] pose of the car."""
    curves: tuple[Curve, ...] = ()
    clock: float = 0.0
    """[s] start of the last curve."""
    earlier: Bools | None = None
    """(PHASES, nx, ny, n_phi) bins in a log of each phase before the last curve; None: no bins."""

    @cached_property
    def seen(self) -> Bools:
        """(PHASES, nx, ny, n_phi) bins in a log of each phase."""
        if not self.curves:
            return np.zeros((PHASES, *self.grid.reachable.shape), dtype=np.bool_)
        last = met(self.curves[-1], self.grid, self.rate, self.clock)
        return last if self.earlier is None else last | self.earlier

    @property
    def met(self) -> Bools:
        """(nx, ny, n_phi) bins in a log of every phase."""
        return np.asarray(self.seen.all(axis=0))

    @property
    def duration(self) -> float:
        """[s]"""
        return self.clock + self.curves[-1].duration if self.curves else 0.0

    @property
    def curve(self) -> Curve:
        """All curves as one; there must be at least one."""
        return join_curves(list(self.curves))

    def extended(self, curve: Curve) -> PartialDrive:
        """Return the drive continued along a curve that starts at `here`."""
        return replace(
            self,
            here=curve.end,
            curves=(*self.curves, curve),
            clock=self.duration,
            earlier=self.seen if self.curves else None,
        )

    def replaced_by(self, curve: Curve) -> PartialDrive:
        """Return the drive along one curve instead of all curves."""
        return replace(self, curves=(), clock=0.0, earlier=None).extended(curve)

    def without_last(self, back: float) -> PartialDrive | None:
        """Return the drive without its last `back` [s]; None if the whole last curve would be removed."""
        if back == 0.0:
            return self
        if not self.curves:
            return None
        *first, curve = self.curves
        last = int(np.searchsorted(curve.starts, curve.duration - back, side="right")) - 1
        if last <= 0:
            return None
        shorter = car_section(curve, 0, last, self.limits)
        return replace(self, here=shorter.end, curves=(*first, shorter))


MAX_GOALS = 400
"""Maximum number of goals per query; the nearest ones are used."""
MAX_IDLE_QUERIES = 12
"""Maximum number of successive queries that leave no fewer bins missing. A path from before the end of
the drive may remove bins, so the number of missing bins can rise temporarily."""
STEP_BACK = (4.0, 16.0, 64.0, 256.0)
"""[s] before the end of the drive, from which a path is tried if none starts at the end."""
SEARCH_FROM = 12
"""Number of missing bins nearby, at and above which the search replaces OMPL."""
MAX_SEARCHES = 3
"""Maximum number of searches for one bin."""
SEARCH_RADIUS = 3.0
"""[m] radius in which missing bins count as nearby."""

OFFSETS = (0.0, -0.3, 0.3)
"""Offsets of goals from the middle of a bin, as shares of its width, height and heading."""
GOALS_IN_BIN = np.array([(x, y, turn) for turn in OFFSETS for x in OFFSETS for y in OFFSETS])
"""(27, 3) goals within a bin, as offsets from its middle in shares of its width, height and heading.

If many bins are missing, only those at the middle heading, which are first, are used. Each bin has three more goals at its
place farthest from walls, because slits contain no others."""
SearchOn = Callable[[Bools, Floats, int], RoomDrive | None]
"""(wanted bins, start pose (3,), seed) -> drive; None if it covers no bin."""


@dataclass(eq=False)
class CarRepair:
    """Repair of a car's drive: extends it until the bins `todo` are covered or lost."""

    task: Task
    todo: Bools
    """(nx, ny, n_phi) bins to cover."""
    start: Floats
    """(3,) start pose of the car."""
    search: SearchOn
    joins: JoinCounts = field(default_factory=JoinCounts)

    def __post_init__(self) -> None:
        task, vehicle = self.task, self.task.vehicle
        self.drive = PartialDrive(grid=task.coverage, rate=task.rate, limits=vehicle.limits, here=self.start)
        self.lost: Bools = np.zeros_like(self.todo)
        """(nx, ny, n_phi) bins to which no path was found."""
        self.n_searches: Ints = np.zeros(self.todo.shape, dtype=np.int64)
        """(nx, ny, n_phi) number of searches for each bin."""
        self._no_ompl_path: Bools = np.zeros_like(self.todo)
        """(nx, ny, n_phi) bins of queries for which OMPL found no path."""
        self._planner = ReachabilityPlanner(task)
        self.heading_offset = car_primitives(
            vehicle.limits, task.coverage.headings, task.rate, GEARS[vehicle.drive]
        ).first_heading
        """[rad] from the middle of a heading bin to the headings that the search uses."""

    def append_curve(self, curve: Curve) -> None:
        """Continue the drive along a curve that starts at its end."""
        self.drive = self.drive.extended(curve)

    def replace_all(self, curve: Curve) -> None:
        """Replace the whole drive by one curve."""
        self.drive = self.drive.replaced_by(curve)

    def missing(self) -> Bools:
        """Return the bins (nx, ny, n_phi) that the log of some phase misses, without the lost ones."""
        return np.asarray(self.todo & ~self.drive.met & ~self.lost)

    def drive_to(self, pose: Floats, before: tuple[float, ...] = (0.0, *STEP_BACK)) -> bool:
        """Drive to a pose (3,) from the drive's end, or from a time [s] `before` it; return whether a path is found.

        A drive may end where OMPL finds no way out within its iterations. The bins of the removed part are
        missing again.
        """
        here = self.drive.here
        if np.allclose(here[:2], pose[:2]) and abs(wrap(here[2] - pose[2])) < 1e-9:
            return True
        for back in before:
            drive = self.drive.without_last(back)
            if drive is None:
                break
            path = self._connect(drive.here, pose[None], 0)
            if path is not None and path.curve is not None:
                self.drive = drive.extended(path.curve)
                return True
        return False

    def search_path_to(self, wanted: Bools) -> bool:
        """Drive to one of the bins `wanted` by a wavefront over the whole floor; return whether a path is found.

        If no path starts at the end of the drive, earlier poses of the drive are tried.
        """
        missing = self.missing()
        for back, explore in (
            (0.0, False),
            *((back, False) for back in STEP_BACK[:-1]),
            (0.0, True),
        ):
            drive = self.drive.without_last(back)
            curve = None if drive is None else self._planner.path_to_any(wanted, drive.here, explore=explore)
            if drive is None or curve is None:
                continue
            longer = drive.extended(curve)
            if (missing & longer.met).any():  # otherwise the stay is too short for a log of some phase
                self.drive = longer
                self.joins += JoinCounts(by_wavefront=1)
                return True
        return False

    def enter_room(self, room: Bools, start: Floats, curve: Curve, seed: int) -> None:
        """Drive to `start` (3,) and along `curve` through a room; without a path, search it from another entry.

        Parameters
        ----------
        room : (nx, ny, n_phi) Bins of the room.
        """
        if self.drive_to(start, (0.0,)):
            self.append_curve(curve)
        elif self.search_path_to(room & self.missing()):
            visit = self.search(room & self.missing(), self.drive.here, seed)
            if visit is not None:
                self.append_curve(visit.curve)
        elif self.drive_to(start, STEP_BACK):
            self.append_curve(curve)

    def add_detours(self, speed: float) -> None:
        """Insert detours, at `speed` [m/s], to missing or lost bins near the drive."""
        lost, self.lost = self.lost, np.zeros_like(self.lost)
        missing = self.missing()
        bins, goals = goals_in(missing, self.drive.here, self.heading_offset, self.task)
        if self.drive.curves and len(bins):
            curve, limits = self.drive.curve, self.task.vehicle.limits
            path, context = arc_path_of(curve, self.todo, self.task, speed)
            own = np.ravel_multi_index(tuple(bins.T), missing.shape)
            longer = insert_detours(path, goals, own, context)
            if len(longer.length) > len(path.length):
                self.replace_all(
                    curve_of_arcs(curve.poses[0], longer.length, longer.bend, longer.gear, limits, speed)
                )
        self.lost = lost & self.missing()

    def run(self) -> None:
        """Drive to missing bins until all bins are covered or lost."""
        fewest, idle = self.todo.size, 0
        for round_ in count():
            missing = self.missing()
            n = int(missing.sum())
            fewest, idle = min(n, fewest), 0 if n < fewest else idle + 1
            if n == 0:
                return
            if idle > MAX_IDLE_QUERIES:
                self.lost |= missing
                return
            near = missing & (self.n_searches < MAX_SEARCHES) & self._nearby_cells()[:, :, None]
            if self.drive.curves and near.sum() >= SEARCH_FROM and self._search_nearby(near, round_):
                continue
            self._drive_to_one_of(missing, round_)

    def _drive_to_one_of(self, missing: Bools, round_: int) -> None:
        """Drive to a missing bin by OMPL, else by a wavefront; mark as lost the bins for which both fail."""
        bins, goals = goals_in(missing & ~self._no_ompl_path, self.drive.here, self.heading_offset, self.task)
        if len(GEARS[self.task.vehicle.drive]) == 1 and len(
            bins
        ):  # otherwise the car may be trapped in a corner
            can_return = self._planner.can_return(goals, self.drive.here)
            bins, goals = bins[can_return], goals[can_return]
        path = self._connect(self.drive.here, goals, round_) if len(bins) else None
        if path is None:
            self._no_ompl_path[tuple(bins.T)] = True
            if not self.search_path_to(missing):
                self.lost[tuple(bins.T)] = True
                if not len(bins):  # no bin contains a raster node: slits between nodes
                    self.lost |= missing
            return
        goal = tuple(bins[path.goal])
        if path.curve is not None:
            self.append_curve(path.curve)
        self.lost[goal] = self.missing()[goal]  # reached, but the stay is too short

    def _nearby_cells(self) -> Bools:
        """Return whether each cell (nx, ny) is near the end of the drive; a search from there reaches only these."""
        rows, columns = np.indices(self.todo.shape[:2])
        i, k = _cell(self.drive.here, self.task)
        return np.asarray(np.hypot(rows - i, columns - k) * self.task.reach.cell <= SEARCH_RADIUS)

    def _search_nearby(self, wanted: Bools, round_: int) -> bool:
        """Continue the search from the end of the drive; return whether it covers a bin."""
        visit = self.search(wanted, self.drive.here, self.task.seed + round_)
        self.n_searches += wanted
        if visit is None or visit.left >= wanted.sum():
            return False
        self.append_curve(visit.curve)
        return True

    def _connect(self, start: Floats, goals: Floats, round_: int) -> CarPath | None:
        task = self.task
        path, joins = connect_car(
            start,
            goals,
            reach=task.reach,
            barriers=task.barriers,
            vehicle=task.vehicle,
            seed=task.seed + round_,
        )
        self.joins += joins
        return path


def goals_in(missing: Bools, here: Floats, heading_offset: float, task: Task) -> tuple[Ints, Floats]:
    """Return the bins (n, 3) of goals, nearest first, and their poses (n, 3); several goals per missing bin.

    Parameters
    ----------
    heading_offset : [rad] From the middle of a heading bin to the headings that the search uses.
    """
    reach, grid = task.reach, task.coverage
    bins = np.argwhere(missing)
    bins = bins[np.argsort(np.hypot(*(bins[:, :2] - _cell(here, task)).T), kind="stable")[:MAX_GOALS]]
    shares = (
        GOALS_IN_BIN if len(bins) * len(GOALS_IN_BIN) <= MAX_GOALS else GOALS_IN_BIN[: len(OFFSETS) ** 2]
    )  # (p, 3)
    own = np.repeat(bins, len(shares), axis=0)
    x, y, turn = np.tile(shares, (len(bins), 1)).T
    deepest, turns = np.repeat(bins, len(OFFSETS), axis=0), np.tile(OFFSETS, len(bins))
    places = np.concatenate(
        [
            reach.origin + (own[:, :2] + 0.5 + np.column_stack([x, y])) * reach.cell,
            reach.deepest(deepest[:, :2]),
        ]
    )
    bins, turn = np.concatenate([own, deepest]), np.append(turn, turns)
    heading = (bins[:, 2] + turn) * (2 * np.pi / grid.headings) + heading_offset
    node = np.floor((places - reach.origin) / reach.step).astype(np.int64)
    free = reach.mask[node[:, 0], node[:, 1]]
    return bins[free], np.column_stack([places, wrap(heading)])[free]


def _cell(pose: Floats, task: Task) -> Floats:
    return np.asarray((pose[:2] - task.reach.origin) / task.reach.cell - 0.5)
