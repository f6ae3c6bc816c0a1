"""Scans that are stamped as they arrive, several at once: the laser turns evenly, so that their times are even.

The last scan k of a burst arrives soon after it was taken, and the others waited for it. With the time T between two scans,

    t_i = t_k - (k - i) T.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import Stamps

WITHIN = 0.2
"""Step within a burst, relative to the mean step, at most; jitter of single arrivals is smaller than the rest."""
MIN_REGULAR = 0.7
"""Minimum share of the bursts with the usual number of scans; others are chance, as of a busy machine."""
MIN_SCANS = 20
"""Fewer scans have no usual number."""


def even_times(stamps: Stamps) -> tuple[Stamps, int] | None:
    """Return the times [ns] of scans that arrive in bursts, and the usual number of scans in one; None if they do not.

    Parameters
    ----------
    stamps : (n,) [ns] in order.
    """
    n = len(stamps)
    if n < MIN_SCANS or stamps[-1] == stamps[0]:
        return None
    is_last = np.append(np.diff(stamps) > WITHIN * (stamps[-1] - stamps[0]) / (n - 1), True)
    last = np.flatnonzero(is_last)
    sizes = np.diff(last, prepend=-1)
    whole = sizes[1:-1]  # the log may begin or end within a burst
    size = int(np.bincount(whole).argmax()) if len(whole) else 1
    if size < 2 or (whole == size).mean() < MIN_REGULAR:
        return None
    period = float(np.median(np.diff(stamps[last]))) / size
    own = last[np.searchsorted(last, np.arange(n))]  # last scan of the burst of each
    wait = np.rint((own - np.arange(n)) * period).astype(np.int64)
    if sizes[-1] < size:  # the log ends before the burst does: from the one before
        rest = np.arange(last[-2] + 1, n)
        own[rest], wait[rest] = last[-2], -np.rint((rest - last[-2]) * period).astype(np.int64)
    return np.maximum.accumulate(stamps[own] - wait), size
