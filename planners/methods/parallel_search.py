"""Parallel search of several rooms, with one progress and one Ctrl-C for all."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np

from planners.cars.car_curve import curve_of_arcs
from planners.cars.shortcuts import shorten_drive
from planners.report import reference_time
from planners.search.area import SearchArea, search_area
from planners.search.motion_primitives import GEARS, MotionPrimitives, car_primitives, spin_primitives
from planners.search.room_drive import RoomDrive
from planners.search.search import CoverageSearch
from planners.task import Task
from planners.types import Bools, Floats

COMPILE_NOTICE = 2.0
"""[s] of compiling, after which a notice is logged."""
POLL_INTERVAL = 0.1
"""[s] between two progress updates."""
MISSED_BIN_COST = 4.0
"""[s] Cost of a bin that a search leaves to the repair, when searches of a room are compared."""

logger = logging.getLogger(__name__)

SearchTick = Callable[[int, float], bool]
"""Takes the number of bins left and the seconds driven; returns whether to go on."""


def primitives_of(task: Task) -> MotionPrimitives:
    """Return the primitives of the task's vehicle."""
    limits, headings, drive = task.vehicle.limits, task.coverage.headings, task.vehicle.drive
    return (
        spin_primitives(limits, headings, task.rate)
        if drive == "diff"
        else car_primitives(limits, headings, task.rate, GEARS[drive])
    )


def search_in_parallel(
    job: Callable[[int, int, SearchTick], RoomDrive | None],
    sizes: list[int],
    task: Task,
    tries: int = 1,
) -> tuple[list[RoomDrive | None], bool]:
    """Run each job `tries` times on all processors, and return its best drive.

    Ctrl-C ends the searches and keeps their results so far; a second Ctrl-C ends everything.

    Parameters
    ----------
    job : (number, seed, tick) -> drive, with `tick` a SearchTick.
    sizes : Number of bins of each job.

    Returns
    -------
    The drives, None for a job without one; and whether the searches were interrupted.

    Raises
    ------
    KeyboardInterrupt : Ctrl-C came before any drive was found.
    """
    left = {(room, attempt): size for attempt in range(tries) for room, size in enumerate(sizes)}
    total, stop = sum(left.values()), threading.Event()
    seconds = dict.fromkeys(left, 0.0)
    each = reference_time(task.coverage, task.vehicle) / max(total // tries, 1)  # [s] per bin

    def search(room: int, attempt: int) -> RoomDrive | None:
        def tick(now: int, driven: float) -> bool:
            left[room, attempt], seconds[room, attempt] = now, driven
            return not stop.is_set()

        seed = int(np.random.SeedSequence([task.seed, room, attempt]).generate_state(1)[0])
        return job(room, seed, tick)

    _compile(task)
    if task.progress:
        task.progress(0, total // tries)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        futures: dict[tuple[int, int], Future[RoomDrive | None]] = {
            key: threads.submit(search, *key) for key in sorted(left)
        }
        try:
            open_ = set(futures.values())
            while open_:
                _, open_ = wait(open_, timeout=POLL_INTERVAL)
                if task.progress:
                    task.progress((total - sum(left.values())) // tries, total // tries)
                task.show_status(
                    _quality(
                        sum(seconds.values()), each * (total - sum(left.values())), len(sizes), len(open_)
                    )
                )
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
        tried = [drive for future in done if (drive := future.result()) is not None]
        best.append(
            min(
                tried,
                key=lambda drive: drive.curve.duration + MISSED_BIN_COST * drive.left,
                default=None,
            )
        )
    if stop.is_set() and not any(best):
        raise KeyboardInterrupt
    return best, stop.is_set()


def _quality(seconds: float, reference: float, rooms: int, open_: int) -> str:
    """Return the status text: rooms left, and driving time so far over the reference time of its bins."""
    what = "searching the only room" if rooms == 1 else f"searching {rooms} rooms ({open_} left)"
    return what if reference <= 0 else f"{what}, {seconds / reference:.2f} of the reference time so far"


def _compile(task: Task) -> None:
    """Compile the kernels, or load them from the cache, before the progress starts."""
    notice = threading.Timer(COMPILE_NOTICE, logger.warning, ["compiling the search for this machine, once"])
    notice.daemon = True
    cells = np.zeros(task.reach.shape, dtype=np.bool_)
    cells[tuple(np.argwhere(task.reach.cells())[0])] = True
    area = search_area(task.reach, cells)
    none = np.zeros((*area.inner.shape, task.coverage.headings), dtype=np.bool_)
    notice.start()
    try:
        CoverageSearch(area, primitives_of(task), none, task.rate).compile()
        if task.vehicle.drive != "diff":
            _compile_shortening(task)
    finally:
        notice.cancel()


def _compile_shortening(task: Task) -> None:
    """Compile the kernels that shorten a car's drive, by shortening a straight line of three arcs."""
    arcs = np.full(3, 0.1), np.zeros(3), np.ones(3)
    line = curve_of_arcs(np.array([*task.reach.origin, 0.0]), *arcs, task.vehicle.limits)
    shorten_drive(line, np.zeros_like(task.coverage.reachable), task, task.vehicle.limits.v)


def free_place(area: SearchArea, task: Task, need: Bools, rng: np.random.Generator) -> Floats | None:
    """Return the middle (2,) [m] of a random free cell of the room.

    Without a free cell, return the room's place farthest from walls; None if the robot does not fit there.
    """
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
