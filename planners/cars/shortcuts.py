"""Shorten a car's drive: replace parts by quicker words that keep every covered bin covered.

A drive that is searched step by step visits many bins twice, because the search cannot know on the first
visit that it will return. Each part of the drive, from one arc to a later one, is compared with the quickest
word of Reeds and Shepp or of Dubins between its ends. The word replaces the part if it is clear, quicker, and
covers every bin that only this part covers. If it misses one such bin, the quickest words through that bin
are tried.

In each pass, parts that save most are replaced first, and replaced parts do not touch. The passes end when
they save little. `shortcut_kernels` defines the saving. The constants of cars were set with `python -m
benchmarks.coverage_planners --drive reeds_shepp` and `--drive dubins`, in the square, the office and random
offices (`--arena --random 10 --first 1`), by driving time, coverage and processor time.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from planners.cars.arc_path import (
    ArcPath,
    CarContext,
    PathAnalysis,
    analysed,
    car_context,
    even_arc_path,
    gear_runs,
)
from planners.cars.car_curve import arcs_of_curve, curve_of_arcs
from planners.cars.reeds_shepp import (
    MAX_ARCS,
    Arcs,
    concatenate_arcs,
    empty_arcs,
    take_arcs,
)
from planners.cars.shortcut_kernels import (
    Replacements,
    choose_replacements,
    covering_intervals,
    find_shortcut,
    search_replacements,
)
from planners.curve import Curve
from planners.search.motion_primitives import GEARS
from planners.task import Task
from planners.types import ROUND_OFF, Bools, Ints

MAX_CRITICAL = (2, 4)
"""Maximum number of bins covered only by the replaced part, in the first pass and in later ones. A shortcut
rarely covers more of them."""
MIN_PASS_SAVING = 0.006
"""Minimum saving of a pass for another to follow, as a share of the driving time."""
MAX_PASSES = 6
"""Maximum number of passes over the whole drive."""
REACH_OVER = 20
"""Number of arcs before a replaced part whose shortcuts are evaluated again, since they may span it."""
ARCS_PER_JOB = 1000
"""Number of arcs per thread job."""


def shortening_passes(path: ArcPath, context: CarContext) -> Iterator[ArcPath]:
    """Shorten a drive pass by pass, and yield each shorter one.

    The result does not depend on the number of processors.
    """
    fresh = np.ones(len(path.length), dtype=np.bool_)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for number in range(MAX_PASSES):
            before = gear_runs(path, context).start_times[-1]
            path, fresh = _one_pass(path, fresh, MAX_CRITICAL[number > 0], context, threads)
            after = gear_runs(path, context).start_times[-1]
            if after < before:
                yield path
            if before - after < MIN_PASS_SAVING * before:
                return


def _one_pass(
    path: ArcPath, fresh: Bools, n_critical: int, context: CarContext, threads: ThreadPoolExecutor
) -> tuple[ArcPath, Bools]:
    """Replace parts of a drive that do not touch each other.

    Parameters
    ----------
    fresh : (n,) Arcs at which a part may begin; parts at the others were tried before without success.
    n_critical : Maximum number of bins that only the replaced part covers.

    Returns
    -------
    The path, and whether each of its arcs is fresh.
    """
    n, analysis = len(path.length), analysed(path, context)
    intervals = analysis.intervals
    covers = covering_intervals(intervals, context)
    count = np.bincount(intervals.bin[covers], minlength=context.need.size)
    must_stay = (intervals.bin >= 0) & (count[intervals.bin] == 0)
    replacements = Replacements(np.zeros(n), np.zeros(n, dtype=np.int64), np.full(n, -1))
    jobs = [
        threads.submit(
            search_replacements,
            k,
            k + ARCS_PER_JOB,
            n_critical,
            fresh,
            analysis,
            covers,
            must_stay,
            count,
            replacements,
        )
        for k in range(0, n, ARCS_PER_JOB)
    ]
    try:
        for job in jobs:
            job.result()
    except BaseException:
        threads.shutdown(cancel_futures=True)
        raise
    chosen = np.sort(choose_replacements(analysis, covers, count, replacements))
    return _splice(analysis, replacements, chosen)


def _splice(analysis: PathAnalysis, replacements: Replacements, chosen: Ints) -> tuple[ArcPath, Bools]:
    """Replace the parts that begin at the arcs `chosen` (k,).

    Returns
    -------
    The path, and whether each of its arcs (n,) is fresh: parts that begin there have not been evaluated.
    """
    path, context = analysis.path, analysis.context
    buffer, word, at = empty_arcs(2 * MAX_ARCS), np.empty(MAX_ARCS), 0
    before = Arcs(path.length, path.bend, path.gear)
    fresh = replacements.saved > 0
    for i in chosen.tolist():
        fresh[max(i - REACH_OVER, 0) : i] = True
    kept, is_fresh = list[Arcs](), list[Bools]()
    for i in chosen.tolist():
        end = int(replacements.end[i])
        n = find_shortcut(i, end, int(replacements.via[i]), analysis, word, buffer)
        kept += [take_arcs(before, slice(at, i)), take_arcs(buffer, slice(n))]
        is_fresh += [fresh[at:i], np.ones(n, dtype=np.bool_)]
        at = end
    kept.append(take_arcs(before, slice(at, None)))
    is_fresh.append(fresh[at:])
    after, owner = even_arc_path(path.poses[0], concatenate_arcs(kept), context)
    return after, np.concatenate(is_fresh)[owner]


def arc_path_of(curve: Curve, todo: Bools, task: Task, speed: float) -> tuple[ArcPath, CarContext]:
    """Return a car's curve as a chain of arcs at `speed` [m/s], and its context with the bins `todo`."""
    limits, can_reverse = task.vehicle.limits, len(GEARS[task.vehicle.drive]) > 1
    context = car_context(task.reach, todo, limits, speed, task.rate, can_reverse=can_reverse)
    arcs = arcs_of_curve(curve)
    path, _ = even_arc_path(curve.poses[0], take_arcs(arcs, arcs.length > ROUND_OFF), context)
    return path, context


def shorten_drive(curve: Curve, todo: Bools, task: Task, speed: float) -> tuple[Curve, bool]:
    """Shorten a car's drive; it still covers all of the bins `todo` (nx, ny, n_phi) that it covered before.

    Parameters
    ----------
    speed : [m/s] Speed of the car.

    Returns
    -------
    The curve; and whether Ctrl-C ended the work, in which case the curve is the best one so far.
    """
    limits, (original, context) = task.vehicle.limits, arc_path_of(curve, todo, task, speed)
    best, interrupted = original, False
    try:
        for shorter in shortening_passes(original, context):
            best = shorter
    except KeyboardInterrupt:
        interrupted = True
    if best is original:
        return curve, interrupted
    return curve_of_arcs(curve.poses[0], best.length, best.bend, best.gear, limits, speed), interrupted
