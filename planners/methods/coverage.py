"""The coverage planner: search each room for itself, and join the rooms by OMPL.

Rooms do not wait for each other, so they are searched side by side, with the same result on any count of
processors.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csgraph

from planners.arena import wrap
from planners.cars.car_curve import curve_of_arcs, cusps
from planners.cars.search import order_rooms, search_floor
from planners.cars.shortcuts import shorten_drive
from planners.curve import Curve, CurveBuilder, joined
from planners.errors import PlanError
from planners.interrupt import undisturbed
from planners.joins.paths import connect
from planners.methods.repair_cars import CarRepair
from planners.methods.repair_spins import SpinRepair, lead
from planners.methods.settings import COVERAGE
from planners.methods.stop_and_spin import wanted
from planners.priority import cell_bands
from planners.rooms import cell_graph, rooms, shortest_sequence
from planners.search.area import SearchArea, search_area
from planners.search.log_phases import missed
from planners.search.motion_primitives import GEARS, MotionPrimitives, car_primitives, spin_primitives
from planners.search.room_drive import RoomDrive, spin_curve
from planners.search.search import CoverageSearch
from planners.search.settings import CAR_ROOM, SPIN_ONLY_ROOM, SPIN_ROOM, SearchSettings
from planners.task import PlannedDrive, Task
from planners.types import Bools, Floats, Ints

logger = logging.getLogger(__name__)

SLOW = 2.0
"""[s] of compiling before that is said."""
LOOK = 0.1
"""[s] between two looks at the searches' progress."""
TIGHT = 1e-9
"""[m, rad] moves and turns shorter than this are none."""


def plan_search(task: Task) -> PlannedDrive:
    """Visit every bin that is still missing: spin without a stop, and choose the speed."""
    if task.vehicle.drive != "diff":
        return _by_car(task)
    todo = wanted(task)
    primitives = _table(task)
    level = cell_bands(task.priority, todo, task.reach.cell)
    bands = [todo & (level == band)[:, :, None] for band in np.unique(level[todo.any(axis=2)])]
    jobs = [
        (band, np.asarray(part & room[:, :, None]))
        for band, part in enumerate(bands)
        for room in rooms(task.reach, part.any(axis=2))
    ]

    tries, settings = (2, SPIN_ONLY_ROOM) if len(jobs) == 1 else (1, SPIN_ROOM)

    def search(job: int, seed: int, tick: Callable[[int], bool]) -> RoomDrive | None:
        return search_room(jobs[job][1], primitives, task, seed, tick, settings)

    visits, interrupted = _side_by_side(search, [int(need.sum()) for _, need in jobs], task, tries)
    ordered: list[RoomDrive] = []
    for band in range(len(bands)):
        own = [visit for (of, _), visit in zip(jobs, visits, strict=True) if of == band and visit is not None]
        here = ordered[-1].ends[1] if ordered else task.start
        ordered += [own[k] for k in _order(own, here, task)]
    drawn, was_asked = undisturbed(partial(_drawn, ordered, task))
    if interrupted or was_asked:
        return replace(drawn, interrupted=True)
    return _repaired(drawn, todo, task)


def _by_car(task: Task) -> PlannedDrive:
    """Search the rooms side by side, and join them by OMPL; then complete what is missing."""
    todo = task.coverage.reachable & (task.coverage.counts == 0)
    if not todo.any():
        raise PlanError("every reachable bin is covered already; nothing is left to plan")
    start = task.start if task.start is not None else _first_pose(task)

    settings = CAR_ROOM[task.vehicle.drive]
    parts = [np.asarray(todo & room[:, :, None]) for room in order_rooms(todo, start, task)]
    begins = [_begin(part, start, task) for part in parts]

    def search(job: int, seed: int, tick: Callable[[int], bool]) -> RoomDrive | None:
        return search_floor(parts[job], task, begins[job], seed, tick, settings)

    def search_on(missing: Bools, here: Floats, seed: int) -> RoomDrive | None:
        return search_floor(missing, task, here, seed, lambda _: True, settings)

    visits, interrupted = _side_by_side(search, [int(part.sum()) for part in parts], task)
    repair = CarRepair(task, todo, start, search_on)
    for part, begin, visit in zip(parts, begins, visits, strict=True):
        if visit is None:
            continue
        _, was_asked = undisturbed(partial(repair.enters, part, begin, visit.curve, task.seed))
        if was_asked:
            interrupted = True
            break
    if not interrupted:
        interrupted = _completed(repair, task)
    if not repair.trip.curves:
        raise PlanError(
            f"the car cannot reach a bin from ({start[0]:.2f}, {start[1]:.2f}, {start[2]:.2f}); choose another start"
        )
    curve = repair.trip.curve
    return PlannedDrive(
        curve=curve, stops=cusps(curve), joins=repair.joins, interrupted=interrupted, lost=repair.lost
    )


def _completed(repair: CarRepair, task: Task) -> bool:
    """Drive to what is missing, shorten the whole drive, and win again what a log met by luck; tell whether Ctrl-C came."""
    try:
        speed = float(abs(_table(task).speeds[0]))
        if repair.missing().sum() < COVERAGE.few_missing * repair.todo.sum():
            repair.passes_by(speed)
        repair.run()
        if repair.trip.curves:
            repair.passes_by(speed)
            won = repair.todo & ~repair.missing()
            short, interrupted = shorten_drive(repair.trip.curve, won, task, speed)
            repair.redrive(short)
            if interrupted:
                return True
            repair.passes_by(speed)
            repair.run()
    except KeyboardInterrupt:
        return True
    return False


def _begin(part: Bools, start: Floats, task: Task) -> Floats:
    """Return where a car begins a room's bins `part` (nx, ny, n_phi): at its start (3,), if that lies within.

    Elsewhere it is the middle of a free cell, with a heading that the search has.
    """
    (bin_,), inside = task.coverage.bins(start[None])
    if inside[0] and part[bin_[0], bin_[1]].any():
        return start
    primitives = _table(task)
    heading = task.coverage.bins(
        np.array([[*task.reach.origin, wrap(np.float64(primitives.first_heading))]])
    )[0][0, 2]
    own = np.zeros_like(part)
    own[:, :, heading] = part[:, :, heading]
    own = own if own.any() else part
    pose = _pose_in(own, task)
    if pose is None:
        middle = task.reach.origin + (np.argwhere(own.any(axis=2))[0] + 0.5) * task.reach.cell
        return np.array([*middle, primitives.first_heading])
    return pose


def _first_pose(task: Task) -> Floats:
    """Return (3,) the middle of a free cell, and a heading between the borders of bins."""
    pose = _pose_in(task.coverage.reachable, task)
    if pose is None:
        raise PlanError("no place is free enough to begin; choose a start")
    return pose


def _pose_in(need: Bools, task: Task) -> Floats | None:
    """Return a free place in the cells of `need` (nx, ny, n_phi), with a heading that the search has, (3,)."""
    middle = _first_place(search_area(task.reach), task, need, np.random.default_rng(task.seed))
    return None if middle is None else np.array([*middle, _table(task).first_heading])


def _table(task: Task) -> MotionPrimitives:
    """Return the primitives of the task's robot."""
    limits, headings, drive = task.vehicle.limits, task.coverage.headings, task.vehicle.drive
    return (
        spin_primitives(limits, headings, task.rate)
        if drive == "diff"
        else car_primitives(limits, headings, task.rate, GEARS[drive])
    )


def _side_by_side(
    job: Callable[[int, int, Callable[[int], bool]], RoomDrive | None],
    sizes: list[int],
    task: Task,
    tries: int = 1,
) -> tuple[list[RoomDrive | None], bool]:
    """Do each job (number, seed, tick) some times on all processors; return the best visit of each.

    Ctrl-C ends the searches where they are, and keeps what they found; a second one ends all.

    Parameters
    ----------
    sizes : bins of each job

    Returns
    -------
    visits, and whether the searches were interrupted
    """
    left = {(room, attempt): size for attempt in range(tries) for room, size in enumerate(sizes)}
    total, stop = sum(left.values()), threading.Event()

    def search(room: int, attempt: int) -> RoomDrive | None:
        def tick(now: int) -> bool:
            left[room, attempt] = now
            return not stop.is_set()

        seed = int(np.random.SeedSequence([task.seed, room, attempt]).generate_state(1)[0])
        return job(room, seed, tick)

    _compiled(task)
    if task.progress:
        task.progress(0, total // tries)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        futures: dict[tuple[int, int], Future[RoomDrive | None]] = {
            key: threads.submit(search, *key) for key in sorted(left)
        }
        try:
            open_ = set(futures.values())
            while open_:
                _, open_ = wait(open_, timeout=LOOK)
                if task.progress:
                    task.progress((total - sum(left.values())) // tries, total // tries)
        except BaseException as exc:
            stop.set()
            threads.shutdown(cancel_futures=True)
            if not isinstance(exc, KeyboardInterrupt):
                raise
    if task.progress and not stop.is_set():
        task.progress(total // tries, total // tries)
    best: list[RoomDrive | None] = []
    for room in range(len(sizes)):
        done = [futures[room, attempt] for attempt in range(tries) if not futures[room, attempt].cancelled()]
        tried = [visit for future in done if (visit := future.result()) is not None]
        best.append(
            min(
                tried,
                key=lambda visit: visit.curve.duration + COVERAGE.missed_bin_cost * visit.left,
                default=None,
            )
        )
    if stop.is_set() and not any(best):
        raise KeyboardInterrupt
    return best, stop.is_set()


def _compiled(task: Task) -> None:
    """Compile the kernels, or read them from disk, before the progress starts: search for no bin at all."""
    said = threading.Timer(SLOW, logger.warning, ["compiling the search for this machine: a minute, once"])
    said.daemon = True
    cells = np.zeros(task.reach.shape, dtype=np.bool_)
    cells[tuple(np.argwhere(task.reach.cells())[0])] = True
    area = search_area(task.reach, cells)
    none = np.zeros((*area.inner.shape, task.coverage.headings), dtype=np.bool_)
    said.start()
    try:
        CoverageSearch(area, _table(task), none, task.rate).run(lambda _: False)
        if task.vehicle.drive != "diff":
            _shorten_nothing(task)
    finally:
        said.cancel()


def _shorten_nothing(task: Task) -> None:
    """Compile what shortens a car's drive: let it look for ways across a straight line of three arcs."""
    arcs = np.full(3, 0.1), np.zeros(3), np.ones(3)
    line = curve_of_arcs(np.array([*task.reach.origin, 0.0]), *arcs, task.vehicle.limits)
    shorten_drive(line, np.zeros_like(task.coverage.reachable), task, task.vehicle.limits.v)


def search_room(
    need: Bools,
    primitives: MotionPrimitives,
    task: Task,
    seed: int,
    tick: Callable[[int], bool],
    settings: SearchSettings,
) -> RoomDrive | None:
    """Search for a drive through the bins `need` (nx, ny, n_phi); None where there is no place to begin."""
    area = search_area(task.reach, np.asarray(need.any(axis=2)))
    own = area.part(need)
    search = CoverageSearch(area, primitives, own, task.rate, seed=seed, settings=settings)
    start = _first_place(area, task, own, search.rng)
    if start is None:
        return None
    search.start_at(np.array([*start, 0.0, 0.0]))
    search.complete(tick)
    given_up = search.given_up | search.world.need
    for patience in COVERAGE.retry_dwell:
        again = area.part(_missed_by(search, primitives, task, need)) & ~given_up
        if not again.any():
            break
        search.want(again, patience, inner=False)
        search.run(tick)
    if not search.come_to_rest():
        return None
    found = search.result()
    curve = spin_curve(found, primitives, task.vehicle.limits.alpha)
    return RoomDrive(curve=curve, stops=_revolutions(curve, primitives), left=int(given_up.sum()))


def _missed_by(search: CoverageSearch, primitives: MotionPrimitives, task: Task, need: Bools) -> Bools:
    curve = spin_curve(search.result(), primitives, task.vehicle.limits.alpha)
    return missed(curve, need, task.coverage, task.rate)


def _first_place(area: SearchArea, task: Task, need: Bools, rng: np.random.Generator) -> Floats | None:
    """Return (2,) [m] the middle of a free cell of the room, or its freest place."""
    reach, cells = task.reach, np.asarray(need.any(axis=2))
    free = cells & area.part(np.asarray(reach.blocks(reach.mask).all(axis=-1)))
    if free.any():
        choice = np.argwhere(free)
        return np.asarray(area.origin + (choice[int(rng.integers(len(choice)))] + 0.5) * area.cell)
    depth = np.where(area.part(reach.blocks(reach.mask)), area.part(reach.blocks(reach.distance)), 0.0)
    depth = np.where(cells[:, :, None], depth, 0.0)
    i, k, node = np.unravel_index(int(depth.argmax()), depth.shape)
    if depth[i, k, node] < reach.clearance:
        return None
    within = np.array([node // reach.per_cell, node % reach.per_cell])
    return np.asarray(area.origin + np.array([i, k]) * area.cell + (within + 0.5) * area.step)


def _revolutions(curve: Curve, primitives: MotionPrimitives) -> Floats:
    """Return (n, 4) where each revolution begins, and how far it turns."""
    end = float(curve.sample(np.array([curve.duration]))[0][0, 2])
    every = curve.poses[:: primitives.n_headings]
    phi = np.append(every[:, 2], curve.poses[-1, 2] + wrap(np.float64(end - curve.poses[-1, 2])))
    return np.column_stack([every, np.diff(phi)])


def _order(visits: list[RoomDrive], here: Floats | None, task: Task) -> Ints:
    """Order the rooms by the ways from the end of one to the start of another."""
    if len(visits) < 2:
        return np.arange(len(visits))
    reach = task.reach

    def cells(points: Floats) -> Ints:
        at = np.floor((points[:, :2] - reach.origin) / reach.cell).astype(np.int64)
        within = at.clip(0, np.array(reach.shape) - 1)
        return np.asarray(np.ravel_multi_index(tuple(within.T), reach.shape), dtype=np.int64)

    starts = np.array([visit.ends[0] for visit in visits])
    ends = np.array([visit.ends[1] for visit in visits] + ([] if here is None else [here]))
    far = csgraph.dijkstra(cell_graph(reach), directed=False, indices=cells(ends))[:, cells(starts)]
    cost = np.where(np.isfinite(far), far, 1e3) * reach.cell / task.vehicle.limits.v
    return shortest_sequence(cost[: len(visits)], None if here is None else cost[-1])


def _drawn(visits: list[RoomDrive], task: Task) -> PlannedDrive:
    """Join the visits; one that cannot be reached is left out."""
    here = visits[0].ends[0] if task.start is None else task.start
    froms = np.array([here, *(visit.ends[1] for visit in visits[:-1])])
    tos = np.array([visit.ends[0] for visit in visits])
    paths, joins = connect(froms[:, :2], tos[:, :2], reach=task.reach, barriers=task.barriers, seed=task.seed)
    curves: list[Curve] = []
    stops: list[Floats] = []
    for visit, path in zip(visits, paths, strict=True):
        if path is not None and not np.allclose(path[0], here[:2], atol=TIGHT):
            again, more = connect(
                here[None, :2],
                visit.ends[0][None, :2],
                reach=task.reach,
                barriers=task.barriers,
                seed=task.seed,
            )
            path, joins = again[0], joins + more
        if path is None:
            continue
        pen = CurveBuilder(here, task.vehicle.limits)
        lead(pen, path)
        face(pen, visit.ends[0][2])
        if pen.clock > 0:
            curves.append(pen.curve())
            stops.append(np.array(pen.stops).reshape(-1, 4))
        curves.append(visit.curve)
        stops.append(visit.stops)
        here = visit.ends[1]
    if not curves:
        raise PlanError("no way leads to any room; choose another start")
    return PlannedDrive(curve=joined(curves), stops=np.concatenate(stops), joins=joins)


def face(pen: CurveBuilder, heading: float) -> None:
    """Turn to a heading [rad]."""
    pen.turn(float(wrap(np.float64(heading - pen.pose[2]))), "turn")


def _repaired(driven: PlannedDrive, todo: Bools, task: Task) -> PlannedDrive:
    """Turn in the cells where a bin is still missing."""
    missing = missed(driven.curve, todo, task.coverage, task.rate)
    if not missing.any():
        return driven
    repair = SpinRepair(task, missing, driven.curve.sample(np.array([driven.curve.duration]))[0][0])
    interrupted = False
    try:
        repair.run()
    except KeyboardInterrupt:
        interrupted = True
    return PlannedDrive(
        interrupted=interrupted,
        curve=joined([driven.curve, *repair.curves]),
        stops=np.concatenate([driven.stops, np.array(repair.stops).reshape(-1, 4)]),
        joins=driven.joins + repair.joins,
        lost=repair.lost & task.coverage.reachable,
    )
