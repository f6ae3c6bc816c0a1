"""The clock of a CARMEN log: assess its stamps, and estimate the time of each line if they are unreliable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.sensor import usual_step
from logs.types import Floats

# conventions, not fitted to data
FIRST_ABSOLUTE = 1e8
"""[s] larger times are absolute, from 1970."""
LATEST = 9e9
"""[s] maximum absolute value of a stamp, so that its nanoseconds fit into 64 bits."""
ASSUMED_PERIOD = 0.1
"""[s] assumed scan period of a log whose clock has stopped."""
MIN_DISTINCT = 0.01
"""Minimum number of distinct times as a share of the scans; below it, the clock has stopped."""
RESTART = 10.0
"""[s] a larger step back means that the clock was reset and continues from there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CarmenClock:
    """The times of the scans, and the basis for the times of other lines."""

    stamps: Floats
    """(n_scans,) [s] from the epoch, in the order of the file."""
    order: NDArray[np.intp]
    """(n_scans,) indices that sort the stamps."""
    epoch_ns: int
    is_assumed: bool
    """Whether the period is assumed, because no clock runs."""
    lines: Floats | None
    """(n_scans,) line numbers of the scans, if the times of other lines follow from these; None: from their stamps."""

    @property
    def replaced_by(self) -> str:
        """What the times are of, if the stamps do not run; otherwise empty."""
        if self.is_assumed:
            return "assumed"
        return "" if self.lines is None else "order of the lines"

    def others(self, lines: Floats, stamps: Floats) -> Floats:
        """Return the times (n,) [s] of other lines from their line numbers or their stamps [s]."""
        if self.lines is None or len(self.lines) < 2:
            return stamps - self.epoch_ns / 1e9
        per_line = float(np.ptp(self.stamps)) / float(np.ptp(self.lines))
        before = np.minimum(lines - self.lines[0], 0) * per_line
        after = np.maximum(lines - self.lines[-1], 0) * per_line
        return np.asarray(np.interp(lines, self.lines, self.stamps) + before + after)


def read_clock(clocks: Floats, lines: Floats, poses: Floats, notes: list[str]) -> CarmenClock:
    """Estimate the times of the scans from the stamps in their lines.

    Stamps that go back are sorted, unless sorting lengthens the path of the robot compared with the order of the
    lines. A scan and the pose in its line always stay together.

    Parameters
    ----------
    clocks : (n_scans, 2) [s] times of the sensor and of the logger; nan without a time
    lines : (n_scans,) line numbers
    poses : (n_scans, 3) poses in the lines; nan without a pose
    notes : list to which notes on corrections are appended
    """
    n_levels = [len(np.unique(clock[np.isfinite(clock)])) for clock in clocks.T]
    stamps, n = clocks[:, 0], len(clocks)
    if n_levels[1] > 2 * n_levels[0]:
        stamps = clocks[:, 1]
        notes.append(f"the sensor clock has only {n_levels[0]} distinct times, so the logger clock was used")
    in_file_order = np.arange(n, dtype=np.intp)
    if max(n_levels) == 0 or (n > 1 and max(n_levels) <= max(1, MIN_DISTINCT * n)):
        period = ASSUMED_PERIOD
        shown = {0: " (the lines have no times)", 1: ""}.get(
            max(n_levels), f" ({max(n_levels)} distinct times for {n} scans)"
        )
        notes.append(
            f"no clock runs{shown}: a scan period of {period:g} s was assumed, in the order of the lines"
        )
        return CarmenClock(
            stamps=period * np.arange(n, dtype=np.float64),
            order=in_file_order,
            epoch_ns=0,
            is_assumed=True,
            lines=lines,
        )
    absent = ~np.isfinite(stamps)
    if absent.any():
        stamps = np.where(absent, np.interp(lines, lines[~absent], stamps[~absent]), stamps)
        notes.append(f"{int(absent.sum())} scans have no time: it was interpolated in the order of the lines")
    epoch = int(np.floor(stamps.min())) if stamps.min() > FIRST_ABSOLUTE else 0
    stamps = stamps - epoch
    order = np.argsort(stamps, kind="stable")
    back, same = int((np.diff(stamps) < 0).sum()), int((np.diff(stamps[order]) == 0).sum())
    own_lines = None
    if back and _travel(poses[order]) > _travel(poses):
        stamps, order, own_lines = _monotone(stamps), in_file_order, lines
        notes.append(
            f"scan stamps go back {back} times, the order of the lines was kept (the robot would jump if sorted)"
        )
    elif back:
        notes.append(f"scan stamps go back {back} times, sorted")
    if same:
        notes.append(f"{same} scan stamps are duplicates, kept in the order of the lines")
    return CarmenClock(
        stamps=stamps, order=order, epoch_ns=epoch * 1_000_000_000, is_assumed=False, lines=own_lines
    )


def _travel(poses: Floats) -> float:
    """Return the length [m] of the path through the poses in this order."""
    there = poses[np.isfinite(poses).all(axis=1)]
    return float(np.hypot(*np.diff(there[:, :2], axis=0).T).sum())


def _monotone(stamps: Floats) -> Floats:
    """Return the non-decreasing stamps closest to the given ones (isotonic least squares); equal ones are spread."""
    from scipy.optimize import isotonic_regression

    steps = np.diff(stamps)
    steps[steps < -RESTART] = usual_step(stamps, ASSUMED_PERIOD)
    whole = np.concatenate([stamps[:1], stamps[0] + np.cumsum(steps)])
    levels, which, counts = np.unique(isotonic_regression(whole).x, return_inverse=True, return_counts=True)
    edges = np.concatenate([levels[:1], (levels[1:] + levels[:-1]) / 2, levels[-1:]])
    rank = np.arange(len(which)) - np.searchsorted(which, which)
    spread = edges[which] + (rank + 0.5) / counts[which] * (edges[which + 1] - edges[which])
    return np.where(counts[which] > 1, spread, levels[which])
