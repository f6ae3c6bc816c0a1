"""The coverage planner for cars: search rooms in parallel, join them by OMPL, repair, shorten, repair again."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from planners.arena import wrap
from planners.cars.car_curve import cusps
from planners.cars.entry import curve_of_search, entry_arc
from planners.cars.shortcuts import shorten_drive
from planners.curve import Curve
from planners.errors import PlanError
from planners.interrupt import defer_interrupt
from planners.methods.parallel_search import SearchTick, free_place, primitives_of, search_in_parallel
from planners.methods.repair_cars import CarRepair
from planners.priority import bin_values, room_bands
from planners.rooms import rooms
from planners.search.area import search_area
from planners.search.log_phases import missed
from planners.search.motion_primitives import GEARS
from planners.search.room_drive import RoomDrive
from planners.search.search import RETRY_DWELL, CoverageSearch
from planners.search.settings import CAR_ROOM, SearchSettings
from planners.task import PlannedDrive, Task
from planners.types import Bools, Floats


def search_floor(
    todo: Bools,
    task: Task,
    start: Floats,
    seed: int,
    tick: Callable[[int, float], bool],
    settings: SearchSettings,
) -> RoomDrive | None:
    """Search for a car's drive through the bins `todo` (nx, ny, n_phi).

    Bins that the log of some phase misses are searched again, with longer stays. None if no bin is covered.
    """
    vehicle, grid = task.vehicle, task.coverage
    area = search_area(task.reach)
    entered = entry_arc(start, area, vehicle.limits, grid.headings, task.rate, GEARS[vehicle.drive])
    value = bin_values(task.priority, todo)
    search = CoverageSearch(
        area, entered.primitives, todo, task.rate, seed=seed, value=value, settings=settings
    )
    search.start_at(entered.state)
    missing, given_up = todo, np.zeros_like(todo)
    curve: Curve | None = None
    for dwell in (1.0, *RETRY_DWELL):
        wanted = missing & ~given_up
        if not wanted.any():
            break
        search.want(wanted, dwell, inner=False)
        search.run(lambda left: tick(left, search.seconds))
        found = search.result()
        given_up |= found.left
        if len(found.sequence):
            curve = curve_of_search(found, entered, vehicle.limits)
            missing = missed(curve, todo, grid, task.rate)
    return None if curve is None else RoomDrive(curve=curve, stops=cusps(curve), left=int(missing.sum()))


def order_rooms(todo: Bools, start: Floats, task: Task) -> list[Bools]:
    """Order the rooms (nx, ny) by priority; at equal priority, the room nearest to the one before is next."""
    reach, here, out = task.reach, start[:2], list[Bools]()
    found = rooms(reach, np.asarray(todo.any(axis=2)))
    bands = room_bands(task.priority, todo, found)
    for band in np.unique(bands).tolist():
        left = [room for room, own in zip(found, bands.tolist(), strict=True) if own == band]
        while left:
            middles = [reach.origin + (np.argwhere(room).mean(axis=0) + 0.5) * reach.cell for room in left]
            nearest = int(np.argmin([np.hypot(*(middle - here)) for middle in middles]))
            here = middles[nearest]
            out.append(left.pop(nearest))
    return out


FEW_MISSING = 0.03
"""If a smaller share of the bins is missing, detours are tried before the repair."""


def plan_cars(task: Task) -> PlannedDrive:
    """Plan a car's drive: search the rooms in parallel, join them by OMPL, and cover the missing bins.

    Raises
    ------
    PlanError : Every bin is covered already, or the car cannot start or reach a bin.
    """
    todo = task.coverage.reachable & (task.coverage.counts == 0)
    if not todo.any():
        raise PlanError("every reachable bin is covered already; nothing is left to plan")
    start = task.start if task.start is not None else _start_pose(task)

    settings = CAR_ROOM[task.vehicle.drive]
    parts = [np.asarray(todo & room[:, :, None]) for room in order_rooms(todo, start, task)]
    begins = [_room_start(part, start, task) for part in parts]

    def search(job: int, seed: int, tick: SearchTick) -> RoomDrive | None:
        return search_floor(parts[job], task, begins[job], seed, tick, settings)

    def search_on(missing: Bools, here: Floats, seed: int) -> RoomDrive | None:
        return search_floor(missing, task, here, seed, lambda left, seconds: True, settings)

    room_drives, interrupted = search_in_parallel(search, [int(part.sum()) for part in parts], task)
    task.show_status(f"joining {len(room_drives)} rooms")
    repair = CarRepair(task, todo, start, search_on)
    for part, begin, room_drive in zip(parts, begins, room_drives, strict=True):
        if room_drive is None:
            continue
        _, came_meanwhile = defer_interrupt(
            partial(repair.enter_room, part, begin, room_drive.curve, task.seed)
        )
        if came_meanwhile:
            interrupted = True
            break
    if not interrupted:
        task.show_status("completing the drive and shortening it")
        interrupted = _complete(repair, task)
    if not repair.drive.curves:
        raise PlanError(
            f"the car cannot reach a bin from ({start[0]:.2f}, {start[1]:.2f}, {start[2]:.2f}); choose another start"
        )
    curve = repair.drive.curve
    return PlannedDrive(
        curve=curve, stops=cusps(curve), joins=repair.joins, interrupted=interrupted, lost=repair.lost
    )


def _complete(repair: CarRepair, task: Task) -> bool:
    """Repair, shorten, and repair the bins that logs recorded only by chance before; return whether Ctrl-C came."""
    try:
        speed = float(abs(primitives_of(task).speeds[0]))
        if repair.missing().sum() < FEW_MISSING * repair.todo.sum():
            repair.add_detours(speed)
        repair.run()
        if repair.drive.curves:
            repair.add_detours(speed)
            covered = repair.todo & ~repair.missing()
            short, interrupted = shorten_drive(repair.drive.curve, covered, task, speed)
            repair.replace_all(short)
            if interrupted:
                return True
            repair.add_detours(speed)
            repair.run()
    except KeyboardInterrupt:
        return True
    return False


def _room_start(part: Bools, start: Floats, task: Task) -> Floats:
    """Return the pose (3,) at which a car begins a room: the drive's start if it is inside, else one in a free cell.

    Parameters
    ----------
    part : (nx, ny, n_phi) Bins of the room.
    """
    (bin_,), inside = task.coverage.bins(start[None])
    if inside[0] and part[bin_[0], bin_[1]].any():
        return start
    primitives = primitives_of(task)
    heading = task.coverage.bins(
        np.array([[*task.reach.origin, wrap(np.float64(primitives.first_heading))]])
    )[0][0, 2]
    own = np.zeros_like(part)
    own[:, :, heading] = part[:, :, heading]
    own = own if own.any() else part
    pose = _free_pose(own, task)
    if pose is None:
        middle = task.reach.origin + (np.argwhere(own.any(axis=2))[0] + 0.5) * task.reach.cell
        return np.array([*middle, primitives.first_heading])
    return pose


def _start_pose(task: Task) -> Floats:
    """Return the middle of a free cell (3,), with a heading between the borders of bins."""
    pose = _free_pose(task.coverage.reachable, task)
    if pose is None:
        raise PlanError("no place has enough free space to start automatically; give a start pose")
    return pose


def _free_pose(need: Bools, task: Task) -> Floats | None:
    """Return a free pose (3,) in the cells of `need` (nx, ny, n_phi), at a heading of the search, or None."""
    middle = free_place(search_area(task.reach), task, need, np.random.default_rng(task.seed))
    return None if middle is None else np.array([*middle, primitives_of(task).first_heading])
