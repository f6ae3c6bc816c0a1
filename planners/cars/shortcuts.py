"""Shorten a car's drive: where all that a part of it wins is won elsewhere too, drive the quickest way across.

A drive that was searched for step by step comes by many bins twice: it could not know, when it first came, that it
would pass again. So each part of the drive, from the start of an arc to that of a later one, is compared with the
quickest word of Reeds and Shepp or of Dubins between its ends. If that is clear and quicker and no bin is lost, it
takes the part's place; if one bin is lost, the quickest way by a pose in that bin is tried. Parts that do not touch
are replaced at once, those that save most first, and all is looked at again, until little is saved.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from planners.cars.arc_path import (
    MOST_WON,
    Drive,
    Gears,
    Ground,
    Stretches,
    counts,
    drive_of,
    flat_bin,
    gears,
    is_clear,
    least_way,
    pose_at,
    samples,
    stretches,
    time_across,
    time_of,
    won,
)
from planners.cars.reeds_shepp import MOST_ARCS, Arcs, Pose, along, arcs_for, chain, part_of, quickest
from planners.kernel import inner_kernel, kernel
from planners.types import Bools, Floats, Ints
from planners.vehicle import SHORTEST_ARC

LONGEST = 60.0
"""[s] of a part."""
ALONE = (2, 4)
"""Bins that a part alone wins, at most, in the first pass and in later ones; a way across wins few of them."""
LEAST = 0.1
"""[s] that a way across saves, at least."""
WORTH = 0.006
"""Of the drive's time, which a pass saves at least if there is to be another."""
PASSES = 6
AROUND = 20
"""Arcs before a replaced part with which others begin that reach over it."""
CHUNK = 1000
"""Arcs whose parts one thread looks at in a row."""


class Cuts(NamedTuple):
    """The best part to replace that begins with each arc."""

    saved: Floats
    """(n,) [s]; 0: none."""
    end: Ints
    """(n,) arc with which the drive goes on."""
    by: Ints
    """(n,) stretch whose bin the way across comes by; -1: none."""


class Known(NamedTuple):
    """A drive, and what follows from it."""

    drive: Drive
    parts: Stretches
    runs: Gears
    ground: Ground


class Notes(NamedTuple):
    """What one thread writes down, again and again."""

    winners: Ints
    """(n_bins,) stretches of the drive that win each bin."""
    within: Ints
    """(n_bins,) those of them within the part."""
    touched: Ints
    """(most,) bins with some."""
    critical: Ints
    """(most,) bins with all."""
    won: Ints
    """(MOST_WON,) bins that the way across wins."""
    arcs: Arcs
    word: Floats
    """(MOST_ARCS,)"""


@kernel
def winning(parts: Stretches, ground: Ground) -> Bools:
    """Return (m,) which stretches win their bin."""
    found = np.zeros(len(parts.bin), np.bool_)
    for k in range(len(found)):
        found[k] = parts.bin[k] >= 0 and counts(parts.length[k], parts.stops[k], ground)
    return found


@inner_kernel
def middle_of(stretch: int, drive: Drive, parts: Stretches, ground: Ground) -> Pose:
    """Return the pose in the middle of a stretch."""
    way = parts.start[stretch] + 0.5 * parts.length[stretch]
    k = min(int(np.searchsorted(parts.way, way, side="right")) - 1, len(drive.length) - 1)
    return along(pose_at(drive, k), way - parts.way[k], drive.bend[k], drive.gear[k], ground.radius)


@inner_kernel
def across(
    i: int, j: int, by: int, drive: Drive, parts: Stretches, ground: Ground, word: Floats, out: Arcs
) -> int:
    """Write the quickest arcs from arc i to arc j, by way of the middle of a stretch or not (-1); return their count.

    word : (MOST_ARCS,) room to work in
    """
    gear, n = drive.gear[i - 1], 0
    start = pose_at(drive, i)
    n_legs = 1 if by < 0 else 2
    for leg in range(n_legs):
        goal, after = pose_at(drive, j), drive.gear[j]
        if leg < n_legs - 1:
            goal, after = middle_of(by, drive, parts, ground), 0
        more = quickest(
            start,
            goal,
            ground.radius,
            gear,
            after,
            ground.pause,
            ground.is_backward,
            SHORTEST_ARC,
            n,
            word,
            out,
        )
        if more < 0:
            return -1
        n += more
        gear = out.gear[n - 1] if n > 0 else gear
        start = goal
    return n


@inner_kernel
def lost(n_touched: int, n_won: int, notes: Notes) -> tuple[int, int]:
    """Return how many bins would be lost, up to two, and the last of them."""
    for k in range(n_won):
        notes.within[notes.won[k]] -= 1
    n_lost, one = 0, -1
    for k in range(n_touched):
        own = notes.touched[k]
        if n_lost < 2 and notes.winners[own] <= notes.within[own]:
            n_lost, one = n_lost + 1, own
    for k in range(n_won):
        notes.within[notes.won[k]] += 1
    return n_lost, one


@inner_kernel
def unseen(
    i: int,
    j: int,
    arcs: Arcs,
    n: int,
    critical: Ints,
    n_critical: int,
    drive: Drive,
    parts: Stretches,
    ground: Ground,
) -> tuple[int, int]:
    """Return how many of some bins `n` arcs from arc i to arc j do not come by, up to two, and the last of them.

    The poses looked at are so far apart that a stretch which wins a bin holds one, or the car stops at one.
    """
    all_seen = (1 << n_critical) - 1
    seen = 0
    for k in range(n_critical):
        if critical[k] == parts.bin[parts.last[i]] or critical[k] == parts.bin[parts.first[j]]:
            seen |= 1 << k
    start = pose_at(drive, i)
    for m in range(n):
        if seen == all_seen:
            return 0, -1
        count = samples(arcs.length[m], ground.stay / 2)
        for s in range(1, count + 1):
            pose = along(start, s * arcs.length[m] / count, arcs.bend[m], arcs.gear[m], ground.radius)
            own = flat_bin(pose, ground)
            for k in range(n_critical):
                if critical[k] == own:
                    seen |= 1 << k
        start = along(start, arcs.length[m], arcs.bend[m], arcs.gear[m], ground.radius)
    n_unseen, one = 0, -1
    for k in range(n_critical):
        if not seen & (1 << k):
            n_unseen, one = min(n_unseen + 1, 2), critical[k]
    return n_unseen, one


@inner_kernel
def weigh(i: int, j: int, alone: int, n_touched: int, known: Known, notes: Notes, cuts: Cuts) -> None:
    """Note the quickest way across from arc i to arc j, if it saves more than what is noted for arc i.

    alone : bins that this part alone wins; n_touched : all that it wins
    """
    drive, parts, runs, ground = known
    best, before = max(cuts.saved[i], LEAST), time_of(i, j, runs)
    arcs, by = notes.arcs, -1
    start, goal = pose_at(drive, i), pose_at(drive, j)
    most = most_saved(i, j, drive, runs, ground)
    if most - least_way(start, goal, ground.radius) / ground.speed <= best:
        return
    for _ in range(2):
        n_arcs = across(i, j, by, drive, parts, ground, notes.word, arcs)
        if n_arcs < 0:
            return
        saved = before - time_across(i, j, arcs, n_arcs, drive, runs, ground)
        if saved <= best:
            return
        n_lost, one = 0, -1
        if alone > 0:
            n_lost, one = unseen(i, j, arcs, n_arcs, notes.critical, alone, drive, parts, ground)
            if n_lost == 0:
                n_won = won(i, j, arcs, n_arcs, drive, parts, ground, notes.won)
                n_lost, one = lost(n_touched, n_won, notes)
        if n_lost == 0:
            if is_clear(start, arcs, n_arcs, ground):
                cuts.saved[i], cuts.end[i], cuts.by[i] = saved, j, by
            return
        if n_lost > 1 or by >= 0:
            return
        by = widest(one, parts.last[i], parts.first[j], parts)
        middle = middle_of(by, drive, parts, ground)
        way = least_way(start, middle, ground.radius) + least_way(middle, goal, ground.radius)
        if most - way / ground.speed <= best:
            return


@inner_kernel
def look_from(i: int, most: int, known: Known, good: Bools, fixed: Bools, notes: Notes, cuts: Cuts) -> None:
    """Find the best part to replace that begins with arc i; see `look`."""
    drive, parts, runs, ground = known
    n_touched, alone, at = 0, 0, parts.last[i] - 1
    for j in range(i + 1, len(drive.length)):
        while at < parts.first[j]:
            at += 1
            if fixed[at]:
                alone = most + 1
            if good[at]:
                own = parts.bin[at]
                if notes.within[own] == 0:
                    notes.touched[n_touched] = own
                    n_touched += 1
                notes.within[own] += 1
                if notes.within[own] == notes.winners[own]:
                    notes.critical[min(alone, most)] = own
                    alone += 1
        if alone > most or most_saved(i, j, drive, runs, ground) > LONGEST:
            break
        weigh(i, j, alone, n_touched, known, notes, cuts)
    for k in range(n_touched):
        notes.within[notes.touched[k]] = 0


@kernel
def look(
    begin: int,
    stop: int,
    most: int,
    fresh: Bools,
    known: Known,
    good: Bools,
    fixed: Bools,
    count: Ints,
    cuts: Cuts,
) -> None:
    """Find the best part to replace that begins with each `fresh` (n,) arc from `begin` to `stop`, not included.

    most : bins that a part alone wins
    good : (m,) stretches that win their bin; fixed : (m,) those that must stay; count : (n_bins,) how many win each
    """
    n = len(known.drive.length)
    notes = Notes(
        count,
        np.zeros(len(count), np.int64),
        np.empty(len(known.parts.bin), np.int64),
        np.empty(most + 1, np.int64),
        np.empty(MOST_WON, np.int64),
        arcs_for(2 * MOST_ARCS),
        np.empty(MOST_ARCS),
    )
    for i in range(max(begin, 1), min(stop, n - 1)):
        if fresh[i]:
            look_from(i, most, known, good, fixed, notes, cuts)


@inner_kernel
def most_saved(i: int, j: int, drive: Drive, runs: Gears, ground: Ground) -> float:
    """Return how much [s] were saved if there were no way from arc i to arc j."""
    outside = runs.before[i - 1] + drive.length[i - 1] + runs.length[runs.run[j]] - runs.before[j]
    return float(time_of(i, j, runs) - outside / ground.speed)


@inner_kernel
def widest(own: int, first: int, last: int, parts: Stretches) -> int:
    """Return the longest of the stretches `first` to `last` in a bin."""
    best = -1
    for k in range(max(first, 0), last + 1):
        if parts.bin[k] == own and (best < 0 or parts.length[k] > parts.length[best]):
            best = k
    return best


@kernel
def choose(
    drive: Drive, parts: Stretches, runs: Gears, good: Bools, count: Ints, ground: Ground, cuts: Cuts
) -> Ints:
    """Return the arcs (k,) with which the parts to replace begin: those that save most first, none touching another."""
    arcs, word, gained = arcs_for(2 * MOST_ARCS), np.empty(MOST_ARCS), np.empty(MOST_WON, np.int64)
    is_run_taken, is_taken = np.zeros(len(runs.length), np.bool_), np.zeros(len(parts.bin), np.bool_)
    chosen, n_chosen = np.empty(len(drive.length), np.int64), 0
    for i in np.argsort(-cuts.saved, kind="mergesort"):
        if cuts.saved[i] <= 0:
            break
        j = cuts.end[i]
        first, last = max(parts.last[i], 0), parts.first[j]
        if is_taken[first : last + 1].any():
            continue
        if ground.is_backward and is_run_taken[runs.run[i - 1] : runs.run[j] + 1].any():
            continue
        n_arcs = across(i, j, cuts.by[i], drive, parts, ground, word, arcs)
        n_gained = won(i, j, arcs, n_arcs, drive, parts, ground, gained)
        for k in range(n_gained):
            count[gained[k]] += 1
        is_lost = False
        for k in range(first, last + 1):
            if good[k]:
                count[parts.bin[k]] -= 1
                is_lost |= count[parts.bin[k]] == 0
        if is_lost:
            for k in range(first, last + 1):
                if good[k]:
                    count[parts.bin[k]] += 1
            for k in range(n_gained):
                count[gained[k]] -= 1
            continue
        is_taken[first : last + 1] = True
        is_run_taken[runs.run[i - 1] : runs.run[j] + 1] = True
        chosen[n_chosen] = i
        n_chosen += 1
    return np.sort(chosen[:n_chosen])


def shorter(drive: Drive, ground: Ground) -> Iterator[Drive]:
    """Shorten a drive pass by pass, and yield each that is shorter; the same on any count of processors."""
    fresh = np.ones(len(drive.length), dtype=np.bool_)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for number in range(PASSES):
            before = gears(drive, ground).clock[-1]
            drive, fresh = _pass(drive, fresh, ALONE[number > 0], ground, threads)
            after = gears(drive, ground).clock[-1]
            if after < before:
                yield drive
            if before - after < WORTH * before:
                return


def _pass(
    drive: Drive, fresh: Bools, alone: int, ground: Ground, threads: ThreadPoolExecutor
) -> tuple[Drive, Bools]:
    """Replace some parts that do not touch, which begin with arcs that are `fresh` (n,); return what is fresh then.

    alone : bins that a part alone wins, at most
    """
    n, parts, runs = len(drive.length), stretches(drive, ground), gears(drive, ground)
    known = Known(drive, parts, runs, ground)
    good = winning(parts, ground)
    count = np.bincount(parts.bin[good], minlength=ground.need.size)
    fixed = (parts.bin >= 0) & (count[parts.bin] == 0)
    cuts = Cuts(np.zeros(n), np.zeros(n, dtype=np.int64), np.full(n, -1))
    jobs = [
        threads.submit(look, k, k + CHUNK, alone, fresh, known, good, fixed, count, cuts)
        for k in range(0, n, CHUNK)
    ]
    try:
        for job in jobs:
            job.result()
    except BaseException:
        threads.shutdown(cancel_futures=True)
        raise
    chosen = choose(drive, parts, runs, good, count, ground, cuts)
    return _spliced(drive, parts, ground, cuts, chosen)


def _spliced(drive: Drive, parts: Stretches, ground: Ground, cuts: Cuts, chosen: Ints) -> tuple[Drive, Bools]:
    """Replace the parts that begin with the arcs `chosen` (k,).

    Returns
    -------
    drive, and (n,) its arcs with which a part may begin that could not be replaced before
    """
    room, word, at = arcs_for(2 * MOST_ARCS), np.empty(MOST_ARCS), 0
    before = Arcs(drive.length, drive.bend, drive.gear)
    fresh = cuts.saved > 0
    for i in chosen.tolist():
        fresh[max(i - AROUND, 0) : i] = True
    kept, is_fresh = list[Arcs](), list[Bools]()
    for i in chosen.tolist():
        end = int(cuts.end[i])
        n = across(i, end, int(cuts.by[i]), drive, parts, ground, word, room)
        kept += [part_of(before, slice(at, i)), part_of(room, slice(n))]
        is_fresh += [fresh[at:i], np.ones(n, dtype=np.bool_)]
        at = end
    kept.append(part_of(before, slice(at, None)))
    is_fresh.append(fresh[at:])
    after, owner = drive_of(drive.poses[0], chain(kept), ground)
    return after, np.concatenate(is_fresh)[owner]
