"""Shorten a car's drive: where all that a part of it wins is won elsewhere too, drive the quickest way across.

A drive that was searched for step by step comes by many bins twice: it could not know, when it first came, that it
would pass again. So each part of the drive, from the start of an arc to that of a later one, is compared with the
quickest word of Reeds and Shepp or of Dubins between its ends. If that is clear and quicker and no bin is lost, it
takes the part's place; if one bin is lost, the quickest way by a pose in that bin is tried. Parts that do not touch
are replaced at once, those that save most first, and all is looked at again, until little is saved.

What counts as won is the rule of a log of any phase: the car stays in the bin for a period of the log at least.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from planners.arena import Bools, Floats
from planners.kernel import inner_kernel, kernel
from planners.order import Ints
from planners.reach import Reach
from planners.robot import SHORTEST_ARC, Limits
from planners.search_kernels import between
from planners.search_words import MOST_ARCS, Arcs, Pose, along, arcs_for, chain, part_of, quickest

SAMPLE = 0.005
"""[m] between the poses of which the bin is looked at."""
CLEAR = 0.02
"""[m] between the poses of which the clearance is looked at."""
PIECES = {False: 0.16, True: 0.12}
"""[m] longest arc that is kept in one, of a car without or with a reverse gear: a part begins and ends with an arc."""
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
MOST_WON = 4096
"""Bins that a way across wins, at most."""
CHUNK = 1000
"""Arcs whose parts one thread looks at in a row."""


class Ground(NamedTuple):
    """Where the car drives, what it wants there, and how it moves."""

    distance: Floats
    """(mx, my) [m] of each node to the nearest barrier."""
    need: Bools
    """(nx, ny, n_phi) bins that count."""
    x0: float
    """[m]"""
    y0: float
    """[m]"""
    step: float
    """[m] between nodes."""
    cell: float
    """[m]"""
    least: float
    """[m] distance to keep."""
    radius: float
    """[m]"""
    speed: float
    """[m/s]"""
    acceleration: float
    """[m/s²]"""
    stay: float
    """[m] of a stretch in which a log of any phase meets the bin."""
    slow: float
    """[m] the same, if the car stops there."""
    is_backward: bool
    """The car has a reverse gear."""
    pause: float
    """[m] that a change of gear is worth, about."""
    piece: float
    """[m] longest arc that is kept in one."""


class Drive(NamedTuple):
    """Arcs, one after the other."""

    poses: Floats
    """(n + 1, 3) [m, m, rad] between them."""
    length: Floats
    """(n,) [m]"""
    bend: Ints
    """(n,) 1 turns counter-clockwise, 0 not, -1 clockwise."""
    gear: Ints
    """(n,) 1 forward, -1 backward."""


class Stretches(NamedTuple):
    """The stretches of a drive within one bin each, in order, and where among them the arcs begin."""

    bin: Ints
    """(m,) flat; -1: none that counts."""
    length: Floats
    """(m,) [m]"""
    stops: Ints
    """(m,) how often the car stops there."""
    start: Floats
    """(m,) [m] driven before it."""
    last: Ints
    """(n + 1,) the stretch before each arc; -1: none."""
    first: Ints
    """(n + 1,) the stretch after."""
    until: Floats
    """(n + 1,) [m] of `last` before the arc."""
    stops_until: Ints
    """(n + 1,) of them the stops; that at the arc's start does not count."""
    way: Floats
    """(n + 1,) [m] driven before each arc."""


class Gears(NamedTuple):
    """The runs of a drive in one gear each, from rest to rest."""

    run: Ints
    """(n,) that each arc belongs to."""
    before: Floats
    """(n,) [m] of its run that lie before each arc."""
    length: Floats
    """(m,) [m] of each run."""
    clock: Floats
    """(m + 1,) [s] when each begins."""


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


@inner_kernel
def pose_at(drive: Drive, k: int) -> Pose:
    """Return where arc k begins."""
    return drive.poses[k, 0], drive.poses[k, 1], drive.poses[k, 2]


@inner_kernel
def flat_bin(pose: Pose, ground: Ground) -> int:
    """Return the flat bin of a pose, -1 where it does not count."""
    nx, ny, n_phi = ground.need.shape
    i, k = int((pose[0] - ground.x0) / ground.cell), int((pose[1] - ground.y0) / ground.cell)
    b = int(np.floor(pose[2] * n_phi / (2 * np.pi) + 0.5)) % n_phi
    if i < 0 or k < 0 or i >= nx or k >= ny or not ground.need[i, k, b]:
        return -1
    return int((i * ny + k) * n_phi + b)


@inner_kernel
def counts(length: float, stops: int, ground: Ground) -> bool:
    """Tell whether a log of any phase meets the bin of a stretch."""
    return length >= ground.stay or (stops > 0 and length >= ground.slow)


@inner_kernel
def samples(length: float, step: float) -> int:
    """Return how many samples an arc has."""
    return int(np.ceil(length / step))


@kernel
def stretches(drive: Drive, ground: Ground) -> Stretches:
    """Part a drive into stretches."""
    n, most = len(drive.length), len(drive.length)
    for k in range(n):
        most += samples(drive.length[k], SAMPLE)
    bins, stops = np.full(most, -2), np.zeros(most, np.int64)
    length, start = np.zeros(most), np.zeros(most)
    last, first = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    until, way, stops_until = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1, np.int64)
    at = -1
    for k in range(n):
        last[k] = at
        if at >= 0:
            until[k], stops_until[k] = length[at], stops[at]
        is_stop = k == 0 or drive.gear[k] != drive.gear[k - 1]
        if is_stop:
            own = flat_bin(pose_at(drive, k), ground)
            if at < 0 or own != bins[at]:  # of no length, if the car only stops there
                at += 1
                bins[at], start[at], stops[at] = own, way[k], 0
        count = samples(drive.length[k], SAMPLE)
        step = drive.length[k] / count
        for s in range(count):
            own = flat_bin(
                along(pose_at(drive, k), (s + 0.5) * step, drive.bend[k], drive.gear[k], ground.radius),
                ground,
            )
            if at < 0 or own != bins[at]:
                at += 1
                bins[at], start[at] = own, way[k] + s * step
            length[at] += step
            if s == 0:
                first[k] = at
                if is_stop:
                    for touched in range(max(last[k], 0), at + 1):
                        stops[touched] += 1
        way[k + 1] = way[k] + drive.length[k]
    last[n], first[n], until[n], stops_until[n] = at, at, length[at], stops[at]
    stops[at] += 1
    m = at + 1
    return Stretches(
        bins[:m].copy(),
        length[:m].copy(),
        stops[:m].copy(),
        start[:m].copy(),
        last,
        first,
        until,
        stops_until,
        way,
    )


@kernel
def winning(parts: Stretches, ground: Ground) -> Bools:
    """Return (m,) which stretches win their bin."""
    found = np.zeros(len(parts.bin), np.bool_)
    for k in range(len(found)):
        found[k] = parts.bin[k] >= 0 and counts(parts.length[k], parts.stops[k], ground)
    return found


@inner_kernel
def rest_to_rest(length: float, ground: Ground) -> float:
    """Return how long [s] a run in one gear takes."""
    v, a = ground.speed, ground.acceleration
    return length / v + v / a if length >= v * v / a else 2 * np.sqrt(length / a)


@kernel
def gears(drive: Drive, ground: Ground) -> Gears:
    """Part a drive into runs."""
    n, at = len(drive.length), -1
    run, before = np.empty(n, np.int64), np.empty(n)
    length = np.zeros(n)
    for k in range(n):
        if k == 0 or drive.gear[k] != drive.gear[k - 1]:
            at += 1
        run[k], before[k] = at, length[at]
        length[at] += drive.length[k]
    clock = np.zeros(at + 2)
    for k in range(at + 1):
        clock[k + 1] = clock[k] + rest_to_rest(length[k], ground)
    return Gears(run, before, length[: at + 1].copy(), clock)


@inner_kernel
def time_across(i: int, j: int, arcs: Arcs, n: int, drive: Drive, runs: Gears, ground: Ground) -> float:
    """Return how long [s] the runs take that part (i, j) belongs to, with the `n` arcs in its place."""
    gear, length = drive.gear[i - 1], runs.before[i - 1] + drive.length[i - 1]
    total = 0.0
    for k in range(n):
        if arcs.gear[k] != gear:
            total += rest_to_rest(length, ground)
            gear, length = arcs.gear[k], 0.0
        length += arcs.length[k]
    if drive.gear[j] != gear:
        total += rest_to_rest(length, ground)
        length = 0.0
    return total + rest_to_rest(length + runs.length[runs.run[j]] - runs.before[j], ground)


@inner_kernel
def won(i: int, j: int, arcs: Arcs, n: int, drive: Drive, parts: Stretches, ground: Ground, out: Ints) -> int:
    """Write the bins won from the stretch before arc i to that after arc j, with `n` arcs in between; return their count."""
    own, length, stops = -1, 0.0, 0
    if parts.last[i] >= 0:
        own, length, stops = parts.bin[parts.last[i]], parts.until[i], parts.stops_until[i]
    gear, n_won = drive.gear[i - 1], 0
    start = pose_at(drive, i)
    for k in range(n):
        is_stop = arcs.gear[k] != gear
        stops += is_stop
        count = samples(arcs.length[k], SAMPLE)
        step = arcs.length[k] / count
        for s in range(count):
            this = flat_bin(along(start, (s + 0.5) * step, arcs.bend[k], arcs.gear[k], ground.radius), ground)
            if this != own:
                if own >= 0 and n_won < len(out) - 2 and counts(length, stops, ground):
                    out[n_won] = own
                    n_won += 1
                own, length, stops = this, 0.0, int(s == 0 and is_stop)
            length += step
        start = along(start, arcs.length[k], arcs.bend[k], arcs.gear[k], ground.radius)
        gear = arcs.gear[k]
    is_stop = gear != drive.gear[j]
    stops += is_stop
    after = parts.first[j]
    rest, more = parts.length[after], parts.stops[after] - (drive.gear[j] != drive.gear[j - 1])
    if parts.last[j] == after:
        rest, more = rest - parts.until[j], more - parts.stops_until[j]
    if parts.bin[after] != own:
        if own >= 0 and counts(length, stops, ground):
            out[n_won] = own
            n_won += 1
        own, length, stops = parts.bin[after], 0.0, int(is_stop)
    if own >= 0 and counts(length + rest, stops + more, ground):
        out[n_won] = own
        n_won += 1
    return n_won


@inner_kernel
def is_clear(pose: Pose, arcs: Arcs, n: int, ground: Ground) -> bool:
    """Tell whether the car keeps its distance on `n` arcs from a pose."""
    distance = ground.distance
    for m in range(n):
        count = samples(arcs.length[m], CLEAR)
        for s in range(1, count + 1):
            place = along(pose, s * arcs.length[m] / count, arcs.bend[m], arcs.gear[m], ground.radius)
            u, v = (place[0] - ground.x0) / ground.step - 0.5, (place[1] - ground.y0) / ground.step - 0.5
            i, k = int(u), int(v)
            if u < 0 or v < 0 or i >= distance.shape[0] - 1 or k >= distance.shape[1] - 1:
                return False
            if between(distance, i, k, u - i, v - k) < ground.least:
                return False
        pose = along(pose, arcs.length[m], arcs.bend[m], arcs.gear[m], ground.radius)
    return True


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
def time_of(i: int, j: int, runs: Gears) -> float:
    """Return how long [s] the runs take that part (i, j) belongs to."""
    return float(runs.clock[runs.run[j] + 1] - runs.clock[runs.run[i - 1]])


@inner_kernel
def most_saved(i: int, j: int, drive: Drive, runs: Gears, ground: Ground) -> float:
    """Return how much [s] were saved if there were no way from arc i to arc j."""
    outside = runs.before[i - 1] + drive.length[i - 1] + runs.length[runs.run[j]] - runs.before[j]
    return float(time_of(i, j, runs) - outside / ground.speed)


@inner_kernel
def least_way(one: Pose, other: Pose, radius: float) -> float:
    """Return what lies between two poses at least [m]: the straight way, or the turn by an arc."""
    turn = abs((other[2] - one[2] + np.pi) % (2 * np.pi) - np.pi)
    return float(max(np.hypot(one[0] - other[0], one[1] - other[1]), radius * turn))


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


def ground_of(
    reach: Reach, todo: Bools, limits: Limits, speed: float, rate: float, *, is_backward: bool
) -> Ground:
    """Return what a car's drive is shortened on.

    Parameters
    ----------
    todo : (nx, ny, n_phi) bins that must not be lost
    speed : [m/s] of the car
    rate : [Hz] of the log
    """
    a = limits.a_on_arc
    return Ground(
        distance=reach.distance,
        need=np.ascontiguousarray(todo),
        x0=float(reach.origin[0]),
        y0=float(reach.origin[1]),
        step=reach.step,
        cell=reach.cell,
        least=reach.clearance,
        radius=limits.turning_radius,
        speed=speed,
        acceleration=a,
        stay=speed / rate + SAMPLE,
        slow=0.5 * a / rate**2 + SAMPLE,
        is_backward=is_backward,
        pause=0.75 * speed * speed / a,
        piece=PIECES[is_backward],
    )


def drive_of(pose: Floats, arcs: Arcs, ground: Ground) -> tuple[Drive, Ints]:
    """Return the drive along arcs (n,) from a pose (3,), of even parts, and which of them each part (m,) begins in.

    Arcs that go on where the one before ends are one with it.
    """
    begins = np.flatnonzero(np.diff(arcs.bend, prepend=2) | np.diff(arcs.gear, prepend=2))
    whole = np.add.reduceat(arcs.length, begins)
    count = np.ceil(whole / ground.piece - 1e-9).astype(np.int64)
    length = np.repeat(whole / count, count)
    bend, gear = (np.repeat(part[begins], count) for part in (arcs.bend, arcs.gear))
    poses = np.empty((len(length) + 1, 3))
    poses[0] = pose
    follow(poses, length, bend, gear, ground.radius)
    ends = np.cumsum(arcs.length)
    inside = np.searchsorted(ends, np.cumsum(length) - 0.5 * length, side="right")
    return Drive(poses, length, bend, gear), inside.clip(0, len(ends) - 1)


@inner_kernel
def follow(poses: Floats, length: Floats, bend: Ints, gear: Ints, radius: float) -> None:
    """Fill `poses` (n + 1, 3) after the first with the ends of n arcs."""
    for k in range(len(length)):
        pose = poses[k, 0], poses[k, 1], poses[k, 2]
        poses[k + 1, 0], poses[k + 1, 1], poses[k + 1, 2] = along(pose, length[k], bend[k], gear[k], radius)


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
