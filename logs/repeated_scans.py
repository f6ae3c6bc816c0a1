"""Find scans that a driver repeats with new stamps while the robot moves on; they were never measured.

Measured scans differ by noise. Those of a standing robot in a simulator without noise are equal as well, so the motion decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.alternating_scans import MIN_RAYS
from logs.notes import with_note
from logs.run import Run
from logs.transforms import interpolate, wrap
from logs.types import Bools, Floats, Ints
from logs.usability import MIN_STEP

MIN_UNKNOWN = 5
"""Number of equal scans in a row that is reported if nothing shows the motion."""


def blank_repeated(run: Run) -> Run:
    """Return the run with all readings of repeated scans invalid (nan), with a note; such a scan states nothing."""
    equal = equal_to_previous(run.ranges)
    if not equal.any() or run.sensor.is_composite:
        return run
    starts = np.flatnonzero(np.diff(equal.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(equal.astype(np.int8), append=0) == -1)
    if _way(run, starts - 1, ends) > MIN_STEP:  # so the driver repeats scans, and all equal ones are repeated
        ranges = run.ranges.copy()
        ranges[equal] = np.nan
        longest = float((run.stamps[ends] - run.stamps[starts - 1]).max())
        text = (
            f"{int(equal.sum())} scans repeat the one before in every ray although the robot moves, for up to {longest:.1f} s: "
            "the driver was stuck, or sends scans again: their readings were left out"
        )
        return with_note(replace(run, ranges=ranges), text)
    has_motion = len(run.odom_stamps) > 1 or len(run.pose_stamps) > 1
    most = int((ends - starts + 1).max())
    if not has_motion and most >= MIN_UNKNOWN:
        text = f"{most} scans in a row are equal in every ray: the driver was stuck, or a simulated robot stands still"
        return with_note(run, text)
    return run


def equal_to_previous(ranges: Floats) -> Bools:
    """Return whether each scan (n_scans,) of ranges (n_scans, n_rays) equals the one before, and has returns."""
    out = np.zeros(len(ranges), dtype=np.bool_)
    if len(ranges) > 1:
        before, after = ranges[:-1], ranges[1:]
        same = (before == after) | (np.isnan(before) & np.isnan(after))
        out[1:] = same.all(axis=1) & (np.isfinite(after).sum(axis=1) >= MIN_RAYS)
    return out


def _way(run: Run, first: Ints, last: Ints) -> float:
    """Return the total motion [m, or rad] from scans (n,) to others (n,), by the odometry, or by the poses without odometry."""
    tracks = ((run.odom_stamps, run.odometry), (run.pose_stamps, run.poses))
    stamps, poses = next(((at, values) for at, values in tracks if len(at) > 1), (None, None))
    if stamps is None or poses is None:
        return 0.0
    moved = interpolate(run.stamps[last], stamps, poses) - interpolate(run.stamps[first], stamps, poses)
    ways = np.column_stack([np.hypot(moved[:, 0], moved[:, 1]), np.abs(wrap(moved[:, 2]))])
    return float(np.nansum(ways, axis=0).max())
