"""Detours: where a car's drive passes near a missing bin, leave the drive by the quickest path to the bin and back.

Few headings can reach a bin next to a wall or in a slit. A search therefore seldom covers it, and a transit
at the end crosses the whole floor. From each pose of the drive near the bin, the quickest words to a pose in
the bin and back are tried. Of those that are clear and cover the bin, the one of least cost is inserted:

    cost = T(runs with the detour) - T(runs without it).
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from planners.cars.arc_path import (
    MAX_BINS,
    ArcPath,
    CarContext,
    PathAnalysis,
    analysed,
    bins_covered,
    is_clear,
    min_length,
    pose_at,
    replacement_time,
    section_time,
)
from planners.cars.reeds_shepp import (
    MAX_ARCS,
    Arcs,
    Pose,
    concatenate_arcs,
    empty_arcs,
    quickest_word,
    take_arcs,
)
from planners.kernel import inner_kernel, outer_kernel
from planners.types import Floats, Ints
from planners.vehicle import SHORTEST_ARC

MAX_DISTANCE = 1.0
"""[m] maximum distance between the drive and the bin."""
MAX_DURATION = 20.0
"""[s] maximum duration of a detour."""


def insert_detours(path: ArcPath, goals: Floats, bins: Ints, context: CarContext) -> Arcs:
    """Return the arcs of a drive with detours to some bins, where a detour is found.

    Parameters
    ----------
    goals : (m, 3) [m, m, rad] Poses in the bins.
    bins : (m,) Flat bin of each pose; one pose per bin is enough.
    """
    analysis = analysed(path, context)
    wanted = np.unique(bins)

    def best(bin_: int) -> tuple[int, Arcs, set[int]]:
        arcs, word, gained = empty_arcs(2 * MAX_ARCS), np.empty(MAX_ARCS), np.empty(MAX_BINS, np.int64)
        own = np.ascontiguousarray(goals[bins == bin_])
        k, n, n_covered = find_detour(own, bin_, analysis, word, arcs, gained)
        return k, take_arcs(arcs, slice(n)), set(gained[:n_covered].tolist())

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        found = list(threads.map(best, wanted.tolist()))
    inserted, met = list[tuple[int, Arcs]](), set[int]()
    for bin_, (k, arcs, gained) in zip(wanted.tolist(), found, strict=True):
        if k > 0 and bin_ not in met:
            inserted.append((k, arcs))
            met |= gained
    whole, kept, at = Arcs(path.length, path.bend, path.gear), list[Arcs](), 0
    for k, arcs in sorted(inserted, key=lambda one: one[0]):
        kept += [take_arcs(whole, slice(at, k)), arcs]
        at = k
    return concatenate_arcs([*kept, take_arcs(whole, slice(at, None))])


@outer_kernel
def find_detour(
    goals: Floats, bin_: int, analysis: PathAnalysis, word: Floats, arcs: Arcs, gained: Ints
) -> tuple[int, int, int]:
    """Find the quickest detour by one of the goals (m, 3) that covers `bin_`; write its arcs and its bins to `gained`.

    Returns
    -------
    The arc before which it is inserted (0: none), its number of arcs, and its number of bins.
    """
    path, _, runs, context = analysis
    best, best_k, best_goal = MAX_DURATION, 0, 0
    for k in range(1, len(path.length)):
        here = pose_at(path, k)
        for g in range(len(goals)):
            goal = goals[g, 0], goals[g, 1], goals[g, 2]
            if np.hypot(goal[0] - here[0], goal[1] - here[1]) > MAX_DISTANCE:
                continue
            if 2 * min_length(here, goal, context.radius) / context.speed >= best:
                continue
            n = there_and_back(k, goal, path, context, word, arcs)
            if n < 0:
                continue
            cost = replacement_time(k, k, arcs, n, analysis) - section_time(k, k, runs)
            if cost >= best or not is_clear(here, arcs, n, context):
                continue
            n_covered = bins_covered(k, k, arcs, n, analysis, gained)
            for w in range(n_covered):
                if gained[w] == bin_:
                    best, best_k, best_goal = cost, k, g
    if best_k == 0:
        return 0, 0, 0
    goal = goals[best_goal, 0], goals[best_goal, 1], goals[best_goal, 2]
    n = there_and_back(best_k, goal, path, context, word, arcs)
    return best_k, n, bins_covered(best_k, best_k, arcs, n, analysis, gained)


@inner_kernel
def there_and_back(k: int, goal: Pose, path: ArcPath, context: CarContext, word: Floats, arcs: Arcs) -> int:
    """Write the quickest arcs from the start of arc k to a pose and back; return their number or -1."""
    here, radius, pause = pose_at(path, k), context.radius, context.gear_change_cost
    n = quickest_word(
        here, goal, radius, path.gear[k - 1], 0, pause, context.can_reverse, SHORTEST_ARC, 0, word, arcs
    )
    if n <= 0:
        return -1
    gear = arcs.gear[n - 1]
    more = quickest_word(
        goal, here, radius, gear, path.gear[k], pause, context.can_reverse, SHORTEST_ARC, n, word, arcs
    )
    return n + more if more > 0 else -1
