"""Find scans that a driver repeats with new stamps while the robot moves on; they were never measured.

Measured scans differ by noise. Equal ones are also those of a robot that stands in a simulator without noise, so that the
motion decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.notes import with_note
from logs.run import Run
from logs.transforms import interpolate, wrap
from logs.types import Bools, Ints

MOVED = 0.05
"""[m, rad] motion during equal scans above which they are repeated; smaller ones move no reading by more than noise."""
MIN_RETURNS = 10
"""Scans with fewer returns may be equal by chance."""
MIN_UNKNOWN = 5
"""Number of equal scans in a row that is reported if nothing shows the motion."""


def blank_repeated(run: Run) -> Run:
    """Return the run with all readings of repeated scans invalid (nan), with a note; such a scan states nothing."""
    equal = _equal_to_previous(run)
    if not equal.any() or run.sensor.is_composite:
        return run
    starts = np.flatnonzero(np.diff(equal.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(equal.astype(np.int8), append=0) == -1)
    lost = [np.arange(a, b + 1) for a, b in zip(starts, ends, strict=True) if _moves(run, int(a) - 1, int(b))]
    index: Ints = np.concatenate([*lost, np.zeros(0, dtype=np.intp)])
    if lost:
        ranges = run.ranges.copy()
        ranges[index] = np.nan
        longest = max(float(run.stamps[part[-1]] - run.stamps[part[0] - 1]) for part in lost)
        text = (
            f"{len(index)} scans repeat the one before in every ray although the robot moves, for up to {longest:.1f} s: "
            "the driver was stuck, their readings were left out"
        )
        return with_note(replace(run, ranges=ranges), text)
    has_motion = len(run.odom_stamps) > 1 or len(run.pose_stamps) > 1
    most = int((ends - starts + 1).max())
    if not has_motion and most >= MIN_UNKNOWN:
        text = f"{most} scans in a row are equal in every ray: the driver was stuck, or the robot stands in a simulator"
        return with_note(run, text)
    return run


def _equal_to_previous(run: Run) -> Bools:
    """Return whether each scan (n_scans,) equals the one before in every ray, and has returns."""
    out = np.zeros(run.n_scans, dtype=np.bool_)
    if run.n_scans > 1:
        before, after = run.ranges[:-1], run.ranges[1:]
        same = (before == after) | (np.isnan(before) & np.isnan(after))
        out[1:] = same.all(axis=1) & (np.isfinite(after).sum(axis=1) >= MIN_RETURNS)
    return out


def _moves(run: Run, first: int, last: int) -> bool:
    """Return whether the robot moves from one scan to another, by the odometry or else by the poses."""
    tracks = ((run.odom_stamps, run.odometry), (run.pose_stamps, run.poses))
    stamps, poses = next(((at, values) for at, values in tracks if len(at) > 1), (None, None))
    if stamps is None or poses is None:
        return False
    a, b = interpolate(run.stamps[[first, last]], stamps, poses)
    return bool(np.hypot(*(b - a)[:2]) > MOVED or abs(wrap(b[2] - a[2])) > MOVED)
