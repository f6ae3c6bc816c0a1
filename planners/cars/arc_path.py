"""A car's drive as a chain of arcs: what each part of it wins, how long it takes, and what a way across would.

What counts as won is the rule of a log of any phase: the car stays in the bin for a period of the log at least.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.cars.reeds_shepp import Arcs, Pose, along
from planners.kernel import inner_kernel, kernel
from planners.reach import Reach
from planners.search.kernel_world import interpolate
from planners.types import Bools, Floats, Ints
from planners.vehicle import Limits

SAMPLE = 0.005
"""[m] between the poses of which the bin is looked at."""
CLEAR = 0.02
"""[m] between the poses of which the clearance is looked at."""
PIECES = {False: 0.16, True: 0.12}
"""[m] longest arc that is kept in one, of a car without or with a reverse gear: a part begins and ends with an arc."""
MOST_WON = 4096
"""Bins that a way across wins, at most."""


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
    gear, n_covered = drive.gear[i - 1], 0
    start = pose_at(drive, i)
    for k in range(n):
        is_stop = arcs.gear[k] != gear
        stops += is_stop
        count = samples(arcs.length[k], SAMPLE)
        step = arcs.length[k] / count
        for s in range(count):
            this = flat_bin(along(start, (s + 0.5) * step, arcs.bend[k], arcs.gear[k], ground.radius), ground)
            if this != own:
                if own >= 0 and n_covered < len(out) - 2 and counts(length, stops, ground):
                    out[n_covered] = own
                    n_covered += 1
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
            out[n_covered] = own
            n_covered += 1
        own, length, stops = parts.bin[after], 0.0, int(is_stop)
    if own >= 0 and counts(length + rest, stops + more, ground):
        out[n_covered] = own
        n_covered += 1
    return n_covered


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
            if interpolate(distance, i, k, u - i, v - k) < ground.least:
                return False
        pose = along(pose, arcs.length[m], arcs.bend[m], arcs.gear[m], ground.radius)
    return True


@inner_kernel
def time_of(i: int, j: int, runs: Gears) -> float:
    """Return how long [s] the runs take that part (i, j) belongs to."""
    return float(runs.clock[runs.run[j] + 1] - runs.clock[runs.run[i - 1]])


@inner_kernel
def least_way(one: Pose, other: Pose, radius: float) -> float:
    """Return what lies between two poses at least [m]: the straight way, or the turn by an arc."""
    turn = abs((other[2] - one[2] + np.pi) % (2 * np.pi) - np.pi)
    return float(max(np.hypot(one[0] - other[0], one[1] - other[1]), radius * turn))


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
