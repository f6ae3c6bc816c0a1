"""Notice two scanners on one topic: a scan differs from the next one, and is like a later one.

The scans of one laser that moves differ the more, the more time lies between them.
"""

from __future__ import annotations

import numpy as np

from logs.types import Bools, Floats, Ints

RATIO = 3.0
"""Median difference to the next scan, relative to that of the second or third next, above which two views alternate ..."""
LEAST = 0.1
"""[m] ... if it is also larger than this; the views of a laser whose sweeps are interlaced differ by less."""
SHARE = 0.3
"""Share of such scans above which the log is one of several scanners; of one scan in five of another, it is 0.4."""
LATER = (2, 3)
"""Numbers of scans after which the same scanner may be next."""
MIN_SCANS, MAX_SCANS = 20, 500
"""Numbers of scans that are compared; of fewer, nothing is usual."""
MIN_RAYS = 10
"""Fewer rays that return in both scans may differ, or be equal, by chance."""


def alternating_text(ranges: Floats) -> str:
    """Return what is wrong with ranges (n_scans, n_rays) [m] that alternate, as a sentence; empty if they do not."""
    with np.errstate(invalid="ignore"):  # the difference of two missing returns
        share = float(_alternates(ranges).mean()) if len(ranges) >= MIN_SCANS else 0.0
    if share <= SHARE:
        return ""
    return (
        f"{100 * share:.0f} % of the scans differ from the next one, and are like a later one: two scanners seem to share the topic and "
        "the frame, or one laser alternates between two planes. Give each its own topic or frame_id"
    )


def _alternates(ranges: Floats) -> Bools:
    """Return whether each of some scans differs from the next one, but not from a later one."""
    n = len(ranges) - max(LATER)
    some = np.unique(np.linspace(0, n - 1, min(n, MAX_SCANS)).astype(np.intp))
    later = np.min([_difference(ranges, some, step) for step in LATER], axis=0)
    following = _difference(ranges, some, 1)
    return np.asarray((following > LEAST) & (following > RATIO * later))  # false where one is nan


def _difference(ranges: Floats, index: Ints, step: int) -> Floats:
    """Return the median difference [m] of scans (n,) to those `step` later; nan with too few rays that return in both."""
    off = np.abs(ranges[index + step] - ranges[index])
    is_seen = np.isfinite(off)
    off[~is_seen] = np.nan
    few = is_seen.sum(axis=1) < MIN_RAYS
    off[few] = 0.0
    return np.asarray(np.where(few, np.nan, np.nanmedian(off, axis=1)))
