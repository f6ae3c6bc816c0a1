"""Search of a car over several rooms, one after the other, and the order of the rooms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planners.cars.car_curve import cusps
from planners.cars.entry import curve_of_search, entry_arc
from planners.curve import Curve
from planners.methods.settings import COVERAGE
from planners.priority import bin_values, room_bands
from planners.rooms import rooms
from planners.search.area import search_area
from planners.search.log_phases import missed
from planners.search.motion_primitives import GEARS
from planners.search.room_drive import RoomDrive
from planners.search.search import CoverageSearch
from planners.search.settings import SearchSettings
from planners.task import Task
from planners.types import Bools, Floats


def search_floor(
    todo: Bools,
    task: Task,
    start: Floats,
    seed: int,
    tick: Callable[[int, float], bool],
    settings: SearchSettings,
) -> RoomDrive | None:
    """Search for a car's drive through the bins `todo` (nx, ny, n_phi), one room after the other.

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
    for part, dwell in [
        *((room, 1.0) for room in order_rooms(todo, start, task)),
        (None, 1.0),
        *((None, dwell) for dwell in COVERAGE.retry_dwell),
    ]:
        wanted = (missing if part is None else missing & part[:, :, None]) & ~given_up
        if not wanted.any():
            continue
        others = int(missing.sum() - wanted.sum())
        search.want(wanted, dwell, inner=False)

        def tick_all(left: int, others: int = others) -> bool:
            return tick(others + left, search.seconds)

        search.run(tick_all)
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
