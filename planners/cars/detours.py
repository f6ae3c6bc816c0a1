"""Detours: where a car's drive passes by a bin that it misses, leave it by the quickest way there and back.

A bin beside a wall or in a slit is met by few headings, so a search seldom comes by, and a drive to it at the end costs
the way across the floor. From each pose of the drive near the bin the quickest words to a pose within it and back are
tried; the one that costs least time, keeps its distance and wins the bin is inserted.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from planners.cars.arc_path import (
    MOST_WON,
    Drive,
    Gears,
    Ground,
    Stretches,
    gears,
    is_clear,
    least_way,
    pose_at,
    stretches,
    time_across,
    time_of,
    won,
)
from planners.cars.reeds_shepp import MOST_ARCS, Arcs, Pose, arcs_for, chain, part_of, quickest
from planners.kernel import inner_kernel
from planners.types import Floats, Ints
from planners.vehicle import SHORTEST_ARC

NEAR = 1.0
"""[m] from the drive to a goal."""
LONGEST = 20.0
"""[s] that a detour takes, at most."""


def with_detours(drive: Drive, goals: Floats, bins: Ints, ground: Ground) -> Arcs:
    """Return the arcs of a drive that also comes by some bins, where a detour to them is found.

    Parameters
    ----------
    goals : (m, 3) [m, m, rad] poses to come by
    bins : (m,) flat bin of each; one goal of each bin is enough
    """
    parts, runs = stretches(drive, ground), gears(drive, ground)
    wanted = np.unique(bins)

    def best(own: int) -> tuple[int, Arcs, set[int]]:
        arcs, word, gained = arcs_for(2 * MOST_ARCS), np.empty(MOST_ARCS), np.empty(MOST_WON, np.int64)
        k, n, n_won = find(
            np.ascontiguousarray(goals[bins == own]), own, drive, parts, runs, ground, word, arcs, gained
        )
        return k, part_of(arcs, slice(n)), set(gained[:n_won].tolist())

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        found = list(threads.map(best, wanted.tolist()))
    inserted, met = list[tuple[int, Arcs]](), set[int]()
    for own, (k, arcs, gained) in zip(wanted.tolist(), found, strict=True):
        if k > 0 and own not in met:
            inserted.append((k, arcs))
            met |= gained
    whole, kept, at = Arcs(drive.length, drive.bend, drive.gear), list[Arcs](), 0
    for k, arcs in sorted(inserted, key=lambda one: one[0]):
        kept += [part_of(whole, slice(at, k)), arcs]
        at = k
    return chain([*kept, part_of(whole, slice(at, None))])


@inner_kernel
def find(
    goals: Floats,
    own: int,
    drive: Drive,
    parts: Stretches,
    runs: Gears,
    ground: Ground,
    word: Floats,
    arcs: Arcs,
    gained: Ints,
) -> tuple[int, int, int]:
    """Write the quickest detour by one of some goals (m, 3) that wins bin `own` to `arcs`, and what it wins to `gained`.

    Returns
    -------
    the arc before which it is driven, 0: none; how many arcs it has, and how many bins it wins
    """
    best, best_k, best_goal = LONGEST, 0, 0
    for k in range(1, len(drive.length)):
        here = pose_at(drive, k)
        for g in range(len(goals)):
            goal = goals[g, 0], goals[g, 1], goals[g, 2]
            if np.hypot(goal[0] - here[0], goal[1] - here[1]) > NEAR:
                continue
            if 2 * least_way(here, goal, ground.radius) / ground.speed >= best:
                continue
            n = there_and_back(k, goal, drive, ground, word, arcs)
            if n < 0:
                continue
            cost = time_across(k, k, arcs, n, drive, runs, ground) - time_of(k, k, runs)
            if cost >= best or not is_clear(here, arcs, n, ground):
                continue
            n_won = won(k, k, arcs, n, drive, parts, ground, gained)
            for w in range(n_won):
                if gained[w] == own:
                    best, best_k, best_goal = cost, k, g
    if best_k == 0:
        return 0, 0, 0
    goal = goals[best_goal, 0], goals[best_goal, 1], goals[best_goal, 2]
    n = there_and_back(best_k, goal, drive, ground, word, arcs)
    return best_k, n, won(best_k, best_k, arcs, n, drive, parts, ground, gained)


@inner_kernel
def there_and_back(k: int, goal: Pose, drive: Drive, ground: Ground, word: Floats, arcs: Arcs) -> int:
    """Write the quickest arcs from before arc k to a pose and back; return their count, -1: there are none."""
    here, radius, pause = pose_at(drive, k), ground.radius, ground.pause
    n = quickest(
        here, goal, radius, drive.gear[k - 1], 0, pause, ground.is_backward, SHORTEST_ARC, 0, word, arcs
    )
    if n <= 0:
        return -1
    gear = arcs.gear[n - 1]
    more = quickest(
        goal, here, radius, gear, drive.gear[k], pause, ground.is_backward, SHORTEST_ARC, n, word, arcs
    )
    return n + more if more > 0 else -1
