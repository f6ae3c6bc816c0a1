"""Stretches without odometry, before, within or after it: a track of the scans alone fills them."""

from __future__ import annotations

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.front_end import track_part
from sensorgraph.types import Bools, Floats

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
    A stretch whose scans cannot be followed stays as it is.
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
    if not filled:
        return motion, ()
    order = np.argsort(np.concatenate(stamps), kind="stable")
    joined = np.concatenate(poses)[order]
    joined[:, 2] = np.unwrap(joined[:, 2])
    return Motion(stamps=np.concatenate(stamps)[order], poses=joined), _notes(run, motion, filled)


def is_measured(motion: Motion, times: Floats) -> Bools:
    """Tell which times (n,) [s] lie between poses of the odometry (`motion`) without a missing stretch."""
    gaps = np.diff(motion.stamps, prepend=-np.inf, append=np.inf)
    return np.asarray(gaps[np.searchsorted(motion.stamps, times)] < MIN_MISSING)


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
        off[:, 2] = wrap(off[:, 2])
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
