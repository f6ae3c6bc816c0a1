"""A car's drive as a chain of arcs: the bins it covers, its duration, and the effect of replacing a part of it.

An arc of length s and bend b turns the car by b s / radius. A run is a part of the path in one gear, driven
from rest to rest. With length L, speed v and acceleration a, its duration is:

    T(L) = L / v + v / a   for L ≥ v² / a,   else 2 sqrt(L / a).

A bin counts as covered if a log of any phase records a pose in it: the car stays in it for at least one
period of the log.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.cars.reeds_shepp import Arcs, Pose, arc_end
from planners.kernel import inner_kernel, kernel, outer_kernel
from planners.reach import Reach
from planners.search.kernel_world import interpolate
from planners.search.motion_primitives import GEAR_CHANGE_COST
from planners.types import Bools, Floats, Ints
from planners.vehicle import Limits

BIN_STEP = 0.005
"""[m] between the poses whose bin is evaluated."""
CLEARANCE_STEP = 0.02
"""[m] between the poses whose clearance is tested."""
MAX_BINS = 4096
"""Maximum number of bins that a shortcut or a detour covers."""
MAX_PIECE_FORWARD, MAX_PIECE_REVERSING = 0.16, 0.12
"""[m] Longer arcs are cut, since shortcuts begin and end at arc ends: for cars without and with a reverse gear."""


class CarContext(NamedTuple):
    """Floor, bins to cover, and parameters of the car."""

    distance: Floats
    """(mx, my) [m] of each node to the nearest barrier."""
    need: Bools
    """(nx, ny, n_phi) bins to cover."""
    x0: float
    """[m] lower left corner, x."""
    y0: float
    """[m] lower left corner, y."""
    step: float
    """[m] between nodes."""
    cell: float
    """[m] side of a cell."""
    clearance: float
    """[m] required distance from barriers."""
    radius: float
    """[m] turning radius."""
    speed: float
    """[m/s]"""
    acceleration: float
    """[m/s²]"""
    min_stay: float
    """[m] minimum length of an interval whose bin a log of any phase records ..."""
    min_stay_at_stop: float
    """... and the minimum if the car stops in the interval [m]."""
    can_reverse: bool
    """Whether the car has a reverse gear."""
    gear_change_cost: float
    """[m] cost of a gear change, as a driving distance."""
    max_piece: float
    """[m] maximum length of a piece; longer arcs are cut into even pieces."""


class ArcPath(NamedTuple):
    """A chain of arcs."""

    poses: Floats
    """(n + 1, 3) [m, m, rad] poses at the ends of the arcs."""
    length: Floats
    """(n,) [m]"""
    bend: Ints
    """(n,) 1 counter-clockwise, 0 straight, -1 clockwise."""
    gear: Ints
    """(n,) 1 forward, -1 backward."""


class BinIntervals(NamedTuple):
    """The path, cut where it enters another bin, and the position of the arcs among these intervals."""

    bin: Ints
    """(m,) flat bin; -1: not a bin to cover."""
    length: Floats
    """(m,) [m]"""
    stops: Ints
    """(m,) number of stops of the car in the interval."""
    start: Floats
    """(m,) [m] driven before the interval."""
    before: Ints
    """(n + 1,) interval at the end of the preceding arc; -1: none."""
    after: Ints
    """(n + 1,) interval at the start of each arc."""
    length_before: Floats
    """(n + 1,) [m] part of the interval `before` that is before the arc."""
    stops_before: Ints
    """(n + 1,) number of stops in that part, without the one at the arc's start."""
    driven: Floats
    """(n + 1,) [m] driven before each arc."""


class GearRuns(NamedTuple):
    """The path, cut where it changes gear: runs from rest to rest."""

    run: Ints
    """(n,) run of each arc."""
    before: Floats
    """(n,) [m] part of the run before each arc."""
    length: Floats
    """(m,) [m] of each run."""
    start_times: Floats
    """(m + 1,) [s] start of each run, and the end."""


class PathAnalysis(NamedTuple):
    """A path and the quantities derived from it."""

    path: ArcPath
    intervals: BinIntervals
    runs: GearRuns
    context: CarContext


@inner_kernel
def pose_at(path: ArcPath, k: int) -> Pose:
    """Return the pose at the start of arc k."""
    return path.poses[k, 0], path.poses[k, 1], path.poses[k, 2]


@inner_kernel
def flat_bin(pose: Pose, context: CarContext) -> int:
    """Return the flat bin of a pose; -1 if it is not a bin to cover."""
    nx, ny, n_phi = context.need.shape
    i, k = int((pose[0] - context.x0) / context.cell), int((pose[1] - context.y0) / context.cell)
    b = int(np.floor(pose[2] * n_phi / (2 * np.pi) + 0.5)) % n_phi
    if i < 0 or k < 0 or i >= nx or k >= ny or not context.need[i, k, b]:
        return -1
    return int((i * ny + k) * n_phi + b)


@inner_kernel
def is_logged(length: float, stops: int, context: CarContext) -> bool:
    """Return whether a log of any phase records a pose in the bin of an interval."""
    return length >= context.min_stay or (stops > 0 and length >= context.min_stay_at_stop)


@inner_kernel
def n_samples(length: float, step: float) -> int:
    """Return the number of samples of an arc."""
    return int(np.ceil(length / step))


@kernel
def bin_intervals(path: ArcPath, context: CarContext) -> BinIntervals:
    """Cut a path into intervals within one bin each."""
    n, most = len(path.length), len(path.length)
    for k in range(n):
        most += n_samples(path.length[k], BIN_STEP)
    bins, stops = np.full(most, -2), np.zeros(most, np.int64)
    length, start = np.zeros(most), np.zeros(most)
    last, first = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    until, driven, stops_until = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1, np.int64)
    at = -1
    for k in range(n):
        last[k] = at
        if at >= 0:
            until[k], stops_until[k] = length[at], stops[at]
        is_stop = k == 0 or path.gear[k] != path.gear[k - 1]
        if is_stop:
            own = flat_bin(pose_at(path, k), context)
            if at < 0 or own != bins[at]:  # an interval of zero length, if the car only stops there
                at += 1
                bins[at], start[at], stops[at] = own, driven[k], 0
        count = n_samples(path.length[k], BIN_STEP)
        step = path.length[k] / count
        for s in range(count):
            own = flat_bin(
                arc_end(pose_at(path, k), (s + 0.5) * step, path.bend[k], path.gear[k], context.radius),
                context,
            )
            if at < 0 or own != bins[at]:
                at += 1
                bins[at], start[at] = own, driven[k] + s * step
            length[at] += step
            if s == 0:
                first[k] = at
                if is_stop:
                    for touched in range(max(last[k], 0), at + 1):
                        stops[touched] += 1
        driven[k + 1] = driven[k] + path.length[k]
    last[n], first[n], until[n], stops_until[n] = at, at, length[at], stops[at]
    stops[at] += 1
    m = at + 1
    return BinIntervals(
        bins[:m].copy(),
        length[:m].copy(),
        stops[:m].copy(),
        start[:m].copy(),
        last,
        first,
        until,
        stops_until,
        driven,
    )


@inner_kernel
def rest_to_rest_time(length: float, context: CarContext) -> float:
    """Return the duration [s] of a run, T(length) of the module docstring."""
    v, a = context.speed, context.acceleration
    return length / v + v / a if length >= v * v / a else 2 * np.sqrt(length / a)


@kernel
def gear_runs(path: ArcPath, context: CarContext) -> GearRuns:
    """Cut a path into runs in one gear each."""
    n, at = len(path.length), -1
    run, before = np.empty(n, np.int64), np.empty(n)
    length = np.zeros(n)
    for k in range(n):
        if k == 0 or path.gear[k] != path.gear[k - 1]:
            at += 1
        run[k], before[k] = at, length[at]
        length[at] += path.length[k]
    clock = np.zeros(at + 2)
    for k in range(at + 1):
        clock[k + 1] = clock[k] + rest_to_rest_time(length[k], context)
    return GearRuns(run, before, length[: at + 1].copy(), clock)


def analysed(path: ArcPath, context: CarContext) -> PathAnalysis:
    """Return a path with its intervals and runs."""
    return PathAnalysis(path, bin_intervals(path, context), gear_runs(path, context), context)


@inner_kernel
def replacement_time(i: int, j: int, arcs: Arcs, n: int, analysis: PathAnalysis) -> float:
    """Return the duration [s] of the runs around arcs i to j when `n` arcs replace that part."""
    path, _, runs, context = analysis
    gear, length = path.gear[i - 1], runs.before[i - 1] + path.length[i - 1]
    total = 0.0
    for k in range(n):
        if arcs.gear[k] != gear:
            total += rest_to_rest_time(length, context)
            gear, length = arcs.gear[k], 0.0
        length += arcs.length[k]
    if path.gear[j] != gear:
        total += rest_to_rest_time(length, context)
        length = 0.0
    return total + rest_to_rest_time(length + runs.length[runs.run[j]] - runs.before[j], context)


@inner_kernel
def bins_covered(i: int, j: int, arcs: Arcs, n: int, analysis: PathAnalysis, out: Ints) -> int:
    """Write the bins covered between the intervals around arcs i and j when `n` arcs replace that part.

    Returns
    -------
    The number of these bins.
    """
    path, intervals, _, context = analysis
    own, length, stops = -1, 0.0, 0
    if intervals.before[i] >= 0:
        own, length, stops = (
            intervals.bin[intervals.before[i]],
            intervals.length_before[i],
            intervals.stops_before[i],
        )
    gear, n_covered = path.gear[i - 1], 0
    start = pose_at(path, i)
    for k in range(n):
        is_stop = arcs.gear[k] != gear
        stops += is_stop
        count = n_samples(arcs.length[k], BIN_STEP)
        step = arcs.length[k] / count
        for s in range(count):
            this = flat_bin(
                arc_end(start, (s + 0.5) * step, arcs.bend[k], arcs.gear[k], context.radius), context
            )
            if this != own:
                if own >= 0 and n_covered < len(out) - 2 and is_logged(length, stops, context):
                    out[n_covered] = own
                    n_covered += 1
                own, length, stops = this, 0.0, int(s == 0 and is_stop)
            length += step
        start = arc_end(start, arcs.length[k], arcs.bend[k], arcs.gear[k], context.radius)
        gear = arcs.gear[k]
    is_stop = gear != path.gear[j]
    stops += is_stop
    after = intervals.after[j]
    rest, more = intervals.length[after], intervals.stops[after] - (path.gear[j] != path.gear[j - 1])
    if intervals.before[j] == after:
        rest, more = rest - intervals.length_before[j], more - intervals.stops_before[j]
    if intervals.bin[after] != own:
        if own >= 0 and is_logged(length, stops, context):
            out[n_covered] = own
            n_covered += 1
        own, length, stops = intervals.bin[after], 0.0, int(is_stop)
    if own >= 0 and is_logged(length + rest, stops + more, context):
        out[n_covered] = own
        n_covered += 1
    return n_covered


@inner_kernel
def is_clear(pose: Pose, arcs: Arcs, n: int, context: CarContext) -> bool:
    """Return whether the car keeps the clearance on `n` arcs from a pose."""
    distance = context.distance
    for m in range(n):
        count = n_samples(arcs.length[m], CLEARANCE_STEP)
        for s in range(1, count + 1):
            place = arc_end(pose, s * arcs.length[m] / count, arcs.bend[m], arcs.gear[m], context.radius)
            u, v = (place[0] - context.x0) / context.step - 0.5, (place[1] - context.y0) / context.step - 0.5
            i, k = int(u), int(v)
            if u < 0 or v < 0 or i >= distance.shape[0] - 1 or k >= distance.shape[1] - 1:
                return False
            if interpolate(distance, i, k, u - i, v - k) < context.clearance:
                return False
        pose = arc_end(pose, arcs.length[m], arcs.bend[m], arcs.gear[m], context.radius)
    return True


@inner_kernel
def section_time(i: int, j: int, runs: GearRuns) -> float:
    """Return the duration [s] of the runs around arcs i to j."""
    return float(runs.start_times[runs.run[j] + 1] - runs.start_times[runs.run[i - 1]])


@inner_kernel
def min_length(one: Pose, other: Pose, radius: float) -> float:
    """Return a lower bound [m] on the path length between two poses, from their distance and headings."""
    turn = abs((other[2] - one[2] + np.pi) % (2 * np.pi) - np.pi)
    return float(max(np.hypot(one[0] - other[0], one[1] - other[1]), radius * turn))


def car_context(
    reach: Reach, todo: Bools, limits: Limits, speed: float, rate: float, *, can_reverse: bool
) -> CarContext:
    """Return the context in which a car's drive is shortened.

    Parameters
    ----------
    todo : (nx, ny, n_phi) Bins that the drive must keep.
    speed : [m/s] Speed of the car.
    rate : [Hz] Rate of the log.
    """
    a = limits.a_on_arc
    return CarContext(
        distance=reach.distance,
        need=np.ascontiguousarray(todo),
        x0=float(reach.origin[0]),
        y0=float(reach.origin[1]),
        step=reach.step,
        cell=reach.cell,
        clearance=reach.clearance,
        radius=limits.turning_radius,
        speed=speed,
        acceleration=a,
        min_stay=speed / rate + BIN_STEP,
        min_stay_at_stop=0.5 * a / rate**2 + BIN_STEP,
        can_reverse=can_reverse,
        gear_change_cost=GEAR_CHANGE_COST * speed * speed / a,
        max_piece=MAX_PIECE_REVERSING if can_reverse else MAX_PIECE_FORWARD,
    )


def even_arc_path(pose: Floats, arcs: Arcs, context: CarContext) -> tuple[ArcPath, Ints]:
    """Return the path along arcs (n,) from a pose (3,), cut into even pieces, and the arc of each piece (m,).

    Consecutive arcs with the same bend and gear are merged first.
    """
    begins = np.flatnonzero(np.diff(arcs.bend, prepend=2) | np.diff(arcs.gear, prepend=2))
    whole = np.add.reduceat(arcs.length, begins)
    count = np.ceil(whole / context.max_piece - 1e-9).astype(np.int64)
    length = np.repeat(whole / count, count)
    bend, gear = (np.repeat(part[begins], count) for part in (arcs.bend, arcs.gear))
    poses = np.empty((len(length) + 1, 3))
    poses[0] = pose
    fill_poses(poses, length, bend, gear, context.radius)
    ends = np.cumsum(arcs.length)
    inside = np.searchsorted(ends, np.cumsum(length) - 0.5 * length, side="right")
    return ArcPath(poses, length, bend, gear), inside.clip(0, len(ends) - 1)


@outer_kernel
def fill_poses(poses: Floats, length: Floats, bend: Ints, gear: Ints, radius: float) -> None:
    """Fill `poses` (n + 1, 3) after the first with the end poses of n arcs."""
    for k in range(len(length)):
        pose = poses[k, 0], poses[k, 1], poses[k, 2]
        poses[k + 1, 0], poses[k + 1, 1], poses[k + 1, 2] = arc_end(pose, length[k], bend[k], gear[k], radius)
