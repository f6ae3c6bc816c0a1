"""The coverage planner for robots that turn in place: search rooms in parallel, join them, complete the drive.

Bins that the search leaves are covered by stops and spins (`stop_and_spin`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csgraph

from planners import order
from planners.arena import wrap
from planners.curve import Curve, CurveBuilder, join_curves
from planners.errors import PlanError
from planners.interrupt import defer_interrupt
from planners.joins.paths import continued, join
from planners.methods.parallel_search import SearchTick, free_place, primitives_of, search_in_parallel
from planners.methods.stop_and_spin import StopAndSpinPlanner, bins_to_visit
from planners.priority import cell_bands
from planners.rooms import cell_graph, rooms
from planners.search.area import search_area
from planners.search.log_phases import missed
from planners.search.motion_primitives import MotionPrimitives
from planners.search.room_drive import RoomDrive, spin_curve
from planners.search.search import RETRY_DWELL, CoverageSearch
from planners.search.settings import SPIN_ROOM
from planners.task import PlannedDrive, Task
from planners.types import Bools, Floats, Ints


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

    def search(job: int, seed: int, tick: SearchTick) -> RoomDrive | None:
        return _search_room(jobs[job][1], primitives, task, seed, tick)

    room_drives, interrupted = search_in_parallel(search, [int(need.sum()) for _, need in jobs], task)
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
) -> RoomDrive | None:
    """Search for a drive through the bins `need` (nx, ny, n_phi); None without a place to start or stop."""
    area = search_area(task.reach, np.asarray(need.any(axis=2)))
    own = area.part(need)
    search = CoverageSearch(area, primitives, own, task.rate, seed=seed, settings=SPIN_ROOM)

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
    return order.sequence(cost[: len(room_drives)], None if here is None else cost[-1])


def _join_rooms(room_drives: list[RoomDrive], task: Task) -> PlannedDrive:
    """Join the drives of the rooms; a room that cannot be reached is left out."""
    here = room_drives[0].ends[0] if task.start is None else task.start
    froms = np.array([here, *(room_drive.ends[1] for room_drive in room_drives[:-1])])
    tos = np.array([room_drive.ends[0] for room_drive in room_drives])
    paths, joins = join(task, froms[:, :2], tos[:, :2])
    curves: list[Curve] = []
    stops: list[Floats] = []
    for room_drive, begin, leg in zip(room_drives, froms, paths, strict=True):
        path, more = continued(leg, begin[:2], here[:2], room_drive.ends[0][:2], task)
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
    """Cover the missing bins of the drive by stops and spins."""
    missing = missed(driven.curve, todo, task.coverage, task.rate)
    if not missing.any():
        return driven
    task.show_status(f"completing {int(missing.sum()):,} bins that the search left")
    try:
        more = StopAndSpinPlanner(replace(task, start=driven.curve.end, progress=None), missing).run()
    except KeyboardInterrupt:
        return replace(driven, interrupted=True)
    return replace(
        more,
        curve=join_curves([driven.curve, more.curve]),
        stops=np.concatenate([driven.stops, more.stops]),
        joins=driven.joins + more.joins,
    )
