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
    job: Callable[[int, int, SearchTick], RoomDrive | None], sizes: list[int], task: Task
) -> tuple[list[RoomDrive | None], bool]:
    """Run each job on one of the processors, and return its drive.

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
    left, seconds = dict(enumerate(sizes)), dict.fromkeys(range(len(sizes)), 0.0)
    total, stop = sum(sizes), threading.Event()
    each = reference_time(task.coverage, task.vehicle) / max(total, 1)  # [s] per bin

    def search(room: int) -> RoomDrive | None:
        def tick(now: int, driven: float) -> bool:
            left[room], seconds[room] = now, driven
            return not stop.is_set()

        seed = int(np.random.SeedSequence([task.seed, room, 0]).generate_state(1)[0])
        return job(room, seed, tick)

    _compile(task)
    if task.progress:
        task.progress(0, total)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        futures: list[Future[RoomDrive | None]] = [threads.submit(search, room) for room in left]
        try:
            open_ = set(futures)
            while open_:
                _, open_ = wait(open_, timeout=POLL_INTERVAL)
                if task.progress:
                    task.progress(total - sum(left.values()), total)
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
        task.progress(total, total)
    found = [None if future.cancelled() else future.result() for future in futures]
    if stop.is_set() and not any(found):
        raise KeyboardInterrupt
    return found, stop.is_set()


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
