"""The coverage planner for robots that turn in place: search rooms in parallel, join them, repair the drive.

`SpinRepair` completes the drive: OMPL drives to the nearest cell with missing headings. The straight move is
tried first. On arrival the robot turns through all missing headings of the cell. Bins on
the path count too.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.sparse import csgraph

from planners.arena import wrap
from planners.coverage import DWELL_PERIODS
from planners.curve import Curve, CurveBuilder, join_curves
from planners.errors import PlanError
from planners.interrupt import defer_interrupt
from planners.joins.paths import connect_nearest, continued, join
from planners.methods.parallel_search import SearchTick, free_place, primitives_of, search_in_parallel
from planners.methods.spins import choose_departure
from planners.methods.stop_and_spin import bins_to_visit, standing_places
from planners.priority import cell_bands
from planners.rooms import cell_graph, rooms, shortest_sequence
from planners.search.area import search_area
from planners.search.log_phases import missed
from planners.search.motion_primitives import MotionPrimitives
from planners.search.room_drive import RoomDrive, spin_curve
from planners.search.search import RETRY_DWELL, CoverageSearch
from planners.search.settings import SPIN_ONLY_ROOM, SPIN_ROOM, SearchSettings
from planners.task import JoinCounts, PlannedDrive, Task
from planners.types import Bools, Floats, Ints

MAX_VISITS = 2
"""Maximum number of stops in one cell for its missing headings."""


@dataclass(eq=False)
class SpinRepair:
    """Repair of the drive of a robot that turns in place."""

    task: Task
    missing: Bools
    """(nx, ny, n_phi) bins to cover."""
    here: Floats
    """(3,) pose of the robot."""
    curves: list[Curve] = field(default_factory=list)
    stops: list[tuple[float, float, float, float]] = field(default_factory=list)
    joins: JoinCounts = field(default_factory=JoinCounts)

    def __post_init__(self) -> None:
        self.missing = self.missing.copy()
        self.lost: Bools = np.zeros_like(self.missing)
        """(nx, ny, n_phi) bins to which no path was found."""

    def run(self) -> None:
        """Drive to missing bins until all bins are covered or lost, or their cells have been visited often enough."""
        cells = standing_places(self.task.reach, self.task.barriers, self.missing)
        visits = np.zeros(len(cells.index), dtype=np.int64)
        for round_ in range(MAX_VISITS * len(visits)):
            wanted = np.flatnonzero(self.missing[tuple(cells.index.T)].any(axis=1) & (visits < MAX_VISITS))
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
        builder = CurveBuilder(self.here, task.vehicle.limits, spin=width * task.rate / DWELL_PERIODS)
        builder.follow(path)
        builder.turn(choose_departure(builder, None, need, (0.0, 0.0)).angle, "spin")
        builder.wait(1.0 / task.rate)
        self.curves.append(builder.curve())
        self.stops += builder.stops
        self.here = builder.pose
        self.missing &= missed(self.curves[-1], self.missing, task.coverage, task.rate)


def plan_spins(task: Task) -> PlannedDrive:
    """Plan the drive of a robot that turns in place: it turns all the time, and the search chooses its speed."""
    todo = bins_to_visit(task)
    primitives = primitives_of(task)
    level = cell_bands(task.priority, todo, task.reach.cell)
    bands = [todo & (level == band)[:, :, None] for band in np.unique(level[todo.any(axis=2)])]
    jobs = [
        (band, np.asarray(part & room[:, :, None]))
        for band, part in enumerate(bands)
        for room in rooms(task.reach, part.any(axis=2))
    ]

    tries, settings = (2, SPIN_ONLY_ROOM) if len(jobs) == 1 else (1, SPIN_ROOM)

    def search(job: int, seed: int, tick: SearchTick) -> RoomDrive | None:
        return _search_room(jobs[job][1], primitives, task, seed, tick, settings)

    room_drives, interrupted = search_in_parallel(search, [int(need.sum()) for _, need in jobs], task, tries)
    ordered: list[RoomDrive] = []
    for band in range(len(bands)):
        own = [
            room_drive
            for (of, _), room_drive in zip(jobs, room_drives, strict=True)
            if of == band and room_drive is not None
        ]
        here = ordered[-1].ends[1] if ordered else task.start
        ordered += [own[k] for k in _room_order(own, here, task)]
    task.show_status(f"joining {len(ordered)} rooms")
    joined_drive, came_meanwhile = defer_interrupt(partial(_join_rooms, ordered, task))
    if interrupted or came_meanwhile:
        return replace(joined_drive, interrupted=True)
    return _repair(joined_drive, todo, task)


def _search_room(
    need: Bools,
    primitives: MotionPrimitives,
    task: Task,
    seed: int,
    tick: SearchTick,
    settings: SearchSettings,
) -> RoomDrive | None:
    """Search for a drive through the bins `need` (nx, ny, n_phi); None without a place to start or stop."""
    area = search_area(task.reach, np.asarray(need.any(axis=2)))
    own = area.part(need)
    search = CoverageSearch(area, primitives, own, task.rate, seed=seed, settings=settings)

    def tick_room(left: int) -> bool:
        return tick(left, search.seconds)

    start = free_place(area, task, own, search.rng)
    if start is None:
        return None
    search.start_at(np.array([*start, 0.0, 0.0]))
    search.complete(tick_room)
    given_up = search.given_up | search.world.need
    for dwell in RETRY_DWELL:
        again = area.part(_missed_by(search, primitives, task, need)) & ~given_up
        if not again.any():
            break
        search.want(again, dwell, inner=False)
        search.run(tick_room)
    if not search.come_to_rest():
        return None
    result = search.result()
    curve = spin_curve(result, primitives, task.vehicle.limits.alpha)
    return RoomDrive(curve=curve, stops=_revolutions(curve, primitives), left=int(given_up.sum()))


def _missed_by(search: CoverageSearch, primitives: MotionPrimitives, task: Task, need: Bools) -> Bools:
    curve = spin_curve(search.result(), primitives, task.vehicle.limits.alpha)
    return missed(curve, need, task.coverage, task.rate)


def _revolutions(curve: Curve, primitives: MotionPrimitives) -> Floats:
    """Return the stops (n, 4): pose at the start of each revolution, and its angle."""
    end = float(curve.end[2])
    every = curve.poses[:: primitives.n_headings]
    phi = np.append(every[:, 2], curve.poses[-1, 2] + wrap(np.float64(end - curve.poses[-1, 2])))
    return np.column_stack([every, np.diff(phi)])


def _room_order(room_drives: list[RoomDrive], here: Floats | None, task: Task) -> Ints:
    """Order the rooms by the travel time from the end of one to the start of another."""
    if len(room_drives) < 2:
        return np.arange(len(room_drives))
    reach = task.reach

    def cells(points: Floats) -> Ints:
        at = np.floor((points[:, :2] - reach.origin) / reach.cell).astype(np.int64)
        within = at.clip(0, np.array(reach.shape) - 1)
        return np.asarray(np.ravel_multi_index(tuple(within.T), reach.shape), dtype=np.int64)

    starts = np.array([room_drive.ends[0] for room_drive in room_drives])
    ends = np.array([room_drive.ends[1] for room_drive in room_drives] + ([] if here is None else [here]))
    far = csgraph.dijkstra(cell_graph(reach), directed=False, indices=cells(ends))[:, cells(starts)]
    cost = np.where(np.isfinite(far), far, 1e3) * reach.cell / task.vehicle.limits.v
    return shortest_sequence(cost[: len(room_drives)], None if here is None else cost[-1])


def _join_rooms(room_drives: list[RoomDrive], task: Task) -> PlannedDrive:
    """Join the drives of the rooms; a room that cannot be reached is left out."""
    here = room_drives[0].ends[0] if task.start is None else task.start
    froms = np.array([here, *(room_drive.ends[1] for room_drive in room_drives[:-1])])
    tos = np.array([room_drive.ends[0] for room_drive in room_drives])
    paths, joins = join(task, froms[:, :2], tos[:, :2])
    curves: list[Curve] = []
    stops: list[Floats] = []
    for room_drive, leg in zip(room_drives, paths, strict=True):
        path, more = continued(leg, here[:2], room_drive.ends[0][:2], task)
        joins += more
        if path is None:
            continue
        builder = CurveBuilder(here, task.vehicle.limits)
        builder.follow(path)
        builder.face(room_drive.ends[0][2])
        if builder.clock > 0:
            curves.append(builder.curve())
            stops.append(np.array(builder.stops).reshape(-1, 4))
        curves.append(room_drive.curve)
        stops.append(room_drive.stops)
        here = room_drive.ends[1]
    if not curves:
        raise PlanError("no path leads to any room; choose another start")
    return PlannedDrive(curve=join_curves(curves), stops=np.concatenate(stops), joins=joins)


def _repair(driven: PlannedDrive, todo: Bools, task: Task) -> PlannedDrive:
    """Cover the missing bins of the drive with `SpinRepair`."""
    missing = missed(driven.curve, todo, task.coverage, task.rate)
    if not missing.any():
        return driven
    task.show_status(f"completing {int(missing.sum()):,} bins that the search left")
    repair = SpinRepair(task, missing, driven.curve.end)
    interrupted = False
    try:
        repair.run()
    except KeyboardInterrupt:
        interrupted = True
    return PlannedDrive(
        interrupted=interrupted,
        curve=join_curves([driven.curve, *repair.curves]),
        stops=np.concatenate([driven.stops, np.array(repair.stops).reshape(-1, 4)]),
        joins=driven.joins + repair.joins,
        lost=repair.lost & task.coverage.reachable,
    )
