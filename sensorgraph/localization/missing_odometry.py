"""Stretches without odometry, before, within or after it: a track of the scans alone fills them.

Where no scans can fill a stretch of length T, the robot goes on at both ends as it did before, for one sweep t. Under an
acceleration a, a velocity measured over the time tau then errs by a t (t + tau) / 2, and interpolation by a t (T - t) / 2.
"""

from __future__ import annotations

import numpy as np

from logs.jumps import JUMP_LIMITS, find_jumps
from logs.motion import Motion
from logs.odometry_faults import jumps
from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.front_end import track_part
from sensorgraph.types import Bools, Floats, Ints

MIN_MISSING = 0.3
"""[s] Shortest stretch between odometry poses that is filled; in shorter ones 1 m/s² moves the robot by a t²/8 = 1.1 cm
from the line. Before and after all odometry it does so in half the time, a t²/2."""
MIN_SCANS = 3
"""Minimum number of scans between odometry poses."""
MAX_NAMED = 2
"""Maximum number of stretches whose place is stated."""


def with_missing_stretches(run: Run, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """Return the odometry with the motion of the scans alone where it has no poses, and notes.

    Where odometry stands at both ends, the track is fitted to both: its error there is spread evenly over the time.
    In a stretch whose scans cannot be followed, the motion goes on at both ends for one sweep.
    """
    bounds = np.concatenate([[-np.inf], motion.stamps, [np.inf]])
    begins = np.searchsorted(run.stamps, bounds[:-1], side="right")
    ends = np.searchsorted(run.stamps, bounds[1:], side="left")
    stamps, poses, filled = [motion.stamps], [motion.poses], []
    is_outer = ~np.isfinite(bounds[:-1]) | ~np.isfinite(bounds[1:])
    for i in np.flatnonzero(ends - begins >= np.where(is_outer, 1, MIN_SCANS)):
        inside = run.stamps[begins[i] : ends[i]]
        first = bounds[i] if np.isfinite(bounds[i]) else inside[0]
        last = bounds[i + 1] if np.isfinite(bounds[i + 1]) else inside[-1]
        if last - first < MIN_MISSING / (2 if is_outer[i] else 1):
            continue
        found = _of_scans(run, motion, int(begins[i]), int(ends[i]), (bounds[i], bounds[i + 1]))
        if found is not None:
            stamps.append(found.stamps)
            poses.append(found.poses)
            filled.append((float(first), float(last)))
    joined = _in_order(stamps, poses) if filled else motion
    return _with_sweeps_into_gaps(run, joined), _notes(run, motion, filled)


def without_jumps(motion: Motion) -> Motion:
    """Return the motion with its parts joined where it jumps, as of odometry that starts again: at constant velocity.

    A scan whose sweep contains the jump is then deskewed by the motion of the robot.
    """
    found = find_jumps(motion.stamps, motion.poses)
    return motion if found is None else _joined(motion, found.after)


def without_corrections(motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """Return the motion with its parts joined at jumps too short to be another place, as of a filter that is corrected.

    Also return a note. A longer jump may be another place, which only the scans can show.
    """
    before = jumps(motion.stamps, motion.poses)
    steps = motion.poses[before + 1] - motion.poses[before]
    ways, turns = np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap(steps[:, 2]))
    is_short = (ways < JUMP_LIMITS.distance) & (np.diff(motion.stamps)[before] < MIN_MISSING)
    if not is_short.any():
        return motion, ()
    note = (
        f"the odometry jumps {int(is_short.sum())} times, by up to {ways[is_short].max():.2f} m and "
        f"{np.degrees(turns[is_short].max()):.0f}°, as of a filter that is corrected: joined at constant velocity"
    )
    return _joined(motion, before[is_short] + 1), (note,)


def _joined(motion: Motion, after: Ints) -> Motion:
    """Return the motion without jumps to some poses (m,): at constant velocity."""
    poses = motion.poses.copy()
    for first, end in zip(after, [*after[1:], len(poses)], strict=True):
        step = np.zeros(3)
        if first > 1 and motion.stamps[first - 1] > motion.stamps[first - 2]:
            share = np.diff(motion.stamps[first - 1 : first + 1]) / np.diff(motion.stamps[first - 2 : first])
            step = compose(invert(poses[first - 2]), poses[first - 1]) * share
        moved = compose(compose(poses[first - 1], step), invert(motion.poses[first]))
        poses[first:end] = compose(moved[None], motion.poses[first:end])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Motion(stamps=motion.stamps, poses=poses)


def is_measured(motion: Motion, times: Floats) -> Bools:
    """Tell which times (n,) [s] lie between poses of the odometry (`motion`) without a missing stretch."""
    gaps = np.diff(motion.stamps, prepend=-np.inf, append=np.inf)
    return np.asarray(gaps[np.searchsorted(motion.stamps, times)] < MIN_MISSING)


def _with_sweeps_into_gaps(run: Run, motion: Motion) -> Motion:
    """Return the motion with poses inside either end of each long gap, at constant velocity.

    The sweep of a scan reaches at most one scan period into the gap, and the interpolation one pose further.
    """
    if run.n_scans < 2 or len(motion.stamps) < 3:
        return motion
    period, gaps = float(np.median(np.diff(run.stamps))), np.diff(motion.stamps)
    times, poses = [motion.stamps], [motion.poses]
    for way, known in ((1, slice(0, -1)), (-1, slice(1, None))):
        over = np.maximum(period, gaps[known])  # time over which the velocity is measured
        gap = gaps[1:] if way == 1 else gaps[:-1]
        at = np.flatnonzero((gap >= MIN_MISSING) & (gap > 4 * period + over))
        ends, over = motion.stamps[at + 1], over[at]
        step = compose(invert(motion.at(ends - way * over)), motion.at(ends))
        for time in (period, 2 * period):
            times.append(ends + way * time)
            poses.append(compose(motion.at(ends), step * (time / over)[:, None]))
    return _in_order(times, poses) if sum(map(len, times)) > len(motion.stamps) else motion


def _in_order(stamps: list[Floats], poses: list[Floats]) -> Motion:
    """Return the motion of parts in the order of their stamps."""
    order = np.argsort(np.concatenate(stamps), kind="stable")
    joined = np.concatenate(poses)[order]
    joined[:, 2] = np.unwrap(joined[:, 2])
    return Motion(stamps=np.concatenate(stamps)[order], poses=joined)


def _with_sweeps(stamps: Floats, run: Run, bounds: tuple[float, float]) -> Floats:
    """Return stamps (n,) [s] of scans, and the times one scan period before and after all odometry poses.

    A sweep may end or begin at the stamp, and lasts as long as the scans are apart.
    """
    if np.isfinite(bounds).all() or run.n_scans < 2:
        return stamps
    period = float(np.median(np.diff(run.stamps)))
    before = [stamps[0] - period] if period and np.isinf(bounds[0]) else []
    after = [stamps[-1] + period] if period and np.isinf(bounds[1]) else []
    return np.concatenate([before, stamps, after])


def _of_scans(run: Run, motion: Motion, begin: int, end: int, bounds: tuple[float, float]) -> Motion | None:
    """Return the motion of scans between two odometry poses, or on one side of all; None: not tracked.

    Two more scans are tracked on either side, so that the middles of their sweeps enclose the poses.
    """
    part = slice(max(begin - 2, 0), min(end + 2, run.n_scans))
    has_left, has_right = (
        part.start < begin and np.isfinite(bounds[0]),
        part.stop > end and np.isfinite(bounds[1]),
    )
    _, found = track_part(run, part)
    if not (has_left or has_right) or not found.matched.all() or found.piece[0] != found.piece[-1]:
        return None
    heading = np.unwrap(found.poses[:, 2])
    middle = run.stamps[part] + run.sensor.ray_delays.mean()  # of the sweep, which was not deskewed
    tracked = Motion(stamps=middle, poses=np.column_stack([found.poses[:, :2], heading]))
    times, (left, right) = _with_sweeps(run.stamps[begin:end], run, bounds), bounds
    start = left if has_left else right
    placed = compose(motion.at(np.array([start])), invert(tracked.at(np.array([start]))))
    poses = compose(placed, tracked.at(times))
    if has_left and has_right:
        there = compose(placed, tracked.at(np.array([right])))
        off = compose(invert(there), motion.at(np.array([right])))
        poses = compose(poses, off * ((times - left) / (right - left))[:, None])
    return Motion(stamps=times, poses=poses)


def _notes(run: Run, motion: Motion, filled: list[tuple[float, float]]) -> tuple[str, ...]:
    """Return one line for each stretch, or one for many."""
    since, known = run.stamps[0], (motion.stamps[0], motion.stamps[-1])
    filled = [(first, last) for first, last in filled if last - first >= MIN_MISSING]
    if len(filled) > MAX_NAMED:
        longest = max(last - first for first, last in filled)
        places = [f"in {len(filled)} stretches of up to {longest:.1f} s"]
    else:
        places = [
            f"before {known[0] - since:.1f} s" if last <= known[0]
            else f"after {known[1] - since:.1f} s" if first >= known[1]
            else f"from {first - since:.1f} to {last - since:.1f} s"
            for first, last in filled
        ]  # fmt: skip
    return tuple(
        f"the log has no odometry {place}: the scans alone determine the motion there" for place in places
    )
