"""Correct the times that the driver of a laser states: of scans in bursts, of a scan, and between two rays.

Scans may be stamped as they arrive, several at once. The laser turns evenly, so that their times are even: the last scan k of a burst arrives soon after it was taken, and the others waited for it. With the time T between two scans,

    t_i = t_k - (k - i) T.
"""

from __future__ import annotations

import numpy as np

from logs.alternating_scans import MIN_SCANS
from logs.clocks import UNITS
from logs.repeated_scans import equal_to_previous
from logs.ros.laser_scan import LaserScans
from logs.sensor import median_step
from logs.sweep import LIMITS, differs
from logs.transforms import Stamps


def _spread_bursts(scans: LaserScans) -> None:
    """Give scans that are stamped as they arrive, several at once, even times, in place, with a note."""
    found = even_times(scans.stamps)
    if found is None:
        return
    scans.stamps, size = found
    period = median_step(scans.stamps, 0.0) / 1e9
    scans.notes.append(
        f"scans are stamped as they arrive, {size} at once: times {period:.3g} s apart were used, up to that of the last"
    )


def check_times(scans: LaserScans) -> None:
    """Correct stamps of scans that arrive in bursts, and the unit of `time_increment` and `scan_time`, in place, with notes.

    A sweep takes at most the scan period. If it does so in milliseconds, microseconds or nanoseconds, the field is in this
    unit; if `time_increment` itself is the period, it is the duration of the sweep. Any other longer sweep becomes 0.
    Scans that repeat the one before do not count for the period.
    """
    is_sent_again = equal_to_previous(scans.ranges)
    if not is_sent_again.any():  # which a relay does at once, so that no burst shows
        _spread_bursts(scans)
    period = median_step(scans.stamps[~is_sent_again], 0.0) / 1e9
    n = len(scans.bearings)
    unit = _unit(scans.scan_time, period) if period > 0 else None
    if unit is not None:
        both = 0 < abs(scans.time_increment) * n * unit <= LIMITS.max_periods * period
        fields = f"scan_time {scans.scan_time:.6g}" + (
            f" and time_increment {scans.time_increment:.6g} are" if both else " is"
        )
        scans.notes.append(f"{fields} in {UNITS[unit]}, as a scan is taken every {period:.3g} s: rescaled")
        scans.scan_time *= unit
        scans.time_increment *= unit if both else 1.0
    sweep = abs(scans.time_increment) * n
    if np.isfinite(sweep) and not (period > 0 and sweep > LIMITS.max_periods * period):
        return
    stated, text = (
        scans.time_increment,
        f"{n} rays would take {sweep:.3g} s of the {period:.3g} s between scans",
    )
    turns = (scans.scan_time, period) if np.isfinite(sweep) else ()
    whole = next((turn for turn in turns if turn > 0 and not differs(abs(stated), turn)), None)
    unit = _unit(sweep, period) if np.isfinite(sweep) else None
    if whole is not None:
        scans.time_increment = stated / n
        what = f"is the duration of a whole scan: {scans.time_increment:.3g} s was used"
    elif unit is not None:
        scans.time_increment = stated * unit
        what = f"is in {UNITS[unit]}: {scans.time_increment:.3g} s was used"
    else:
        scans.time_increment = 0.0
        what = "is invalid: 0 was used"
    scans.notes.append(f"time_increment {stated:.3g} s, with which {text}, {what}")


def _unit(duration: float, period: float) -> float | None:
    """Return the unit [s] in which a duration is written, from the scan period [s] that it fills; None: the second.

    A duration of a thousandth may be right, so that it counts as one in thousands of seconds only if it fills the period.
    """
    for unit in UNITS:
        share = abs(duration) * unit / period
        if LIMITS.min_share < share < LIMITS.max_periods and (unit < 1 or not differs(share, 1.0)):
            return unit
    return None


WITHIN = 0.2
"""Step within a burst, relative to the mean step, at most; jitter of single arrivals is smaller than the rest."""
MIN_REGULAR = 0.7
"""Minimum share of the bursts with the usual number of scans; others are chance, as of a busy machine."""


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
