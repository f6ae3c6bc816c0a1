"""The clock of a CARMEN log: what its stamps are worth, and when each line was written where they are worth little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.types import Floats


@dataclass(frozen=True, kw_only=True)
class ClockSettings:
    """What is believed of a clock; conventions, none is fitted to data."""

    first_absolute: float = 1e8
    """[s] larger times count from 1970."""
    latest: float = 9e9
    """[s] no clock shows a larger number, of either sign: its nanoseconds would not fit into 64 bits."""
    assumed_period: float = 0.1
    """[s] between scans of a log whose clock stands still."""
    distinct: float = 0.01
    """A clock that shows fewer distinct times than this share of the scans stands still."""
    restart: float = 10.0
    """[s] a clock that goes back farther was set anew, and goes on from there."""


CLOCK = ClockSettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class CarmenClock:
    """When the scans were taken, and by what the other lines are timed."""

    stamps: Floats
    """(n_scans,) [s] from the epoch, in the order of the file."""
    order: NDArray[np.intp]
    """(n_scans,) that sorts them."""
    epoch_ns: int
    is_assumed: bool
    """No clock runs: the period is an assumption."""
    lines: Floats | None
    """(n_scans,) numbers of the scans' lines, where these and not the stamps of other lines tell their times."""

    def others(self, lines: Floats, stamps: Floats) -> Floats:
        """Return the times (n,) [s] of other lines, of their numbers and their own stamps [s]."""
        if self.lines is None or len(self.lines) < 2:
            return stamps - self.epoch_ns / 1e9
        per_line = float(np.ptp(self.stamps)) / float(np.ptp(self.lines))
        before = np.minimum(lines - self.lines[0], 0) * per_line
        after = np.maximum(lines - self.lines[-1], 0) * per_line
        return np.asarray(np.interp(lines, self.lines, self.stamps) + before + after)


def read_clock(clocks: Floats, lines: Floats, poses: Floats, notes: list[str]) -> CarmenClock:
    """Tell the times of scans from what their lines say.

    Stamps that go back are sorted, unless the robot then drives farther than in the order of the lines: a scan and
    the pose in its own line stay together either way.

    Parameters
    ----------
    clocks : (n_scans, 2) [s] of the sensor and of the logger
    lines : (n_scans,) numbers of the lines
    poses : (n_scans, 3) that stand in the lines; nan where none does
    notes : what was done is added here
    """
    n_levels = [len(np.unique(clock)) for clock in clocks.T]
    stamps, n = clocks[:, 0], len(clocks)
    if n_levels[1] > 2 * n_levels[0]:
        stamps = clocks[:, 1]
        notes.append(f"the sensor's clock shows {n_levels[0]} times only, the logger's was taken")
    in_file_order = np.arange(n, dtype=np.intp)
    if n > 1 and max(n_levels) <= max(1, CLOCK.distinct * n):
        period = CLOCK.assumed_period
        shown = "" if max(n_levels) == 1 else f" ({max(n_levels)} times for {n} scans)"
        notes.append(
            f"no clock runs{shown}: scans were taken to be {period:g} s apart, in the order of the lines"
        )
        return CarmenClock(
            stamps=period * np.arange(n, dtype=np.float64),
            order=in_file_order,
            epoch_ns=0,
            is_assumed=True,
            lines=lines,
        )
    epoch = int(np.floor(stamps.min())) if stamps.min() > CLOCK.first_absolute else 0
    stamps = stamps - epoch
    order = np.argsort(stamps, kind="stable")
    back, same = int((np.diff(stamps) < 0).sum()), int((np.diff(stamps[order]) == 0).sum())
    own_lines = None
    if back and _travel(poses[order]) > _travel(poses):
        stamps, order, own_lines = _mended(stamps), in_file_order, lines
        notes.append(
            f"scan stamps go back {back} times, the order of the lines was kept (sorted, the robot would jump)"
        )
    elif back:
        notes.append(f"scan stamps go back {back} times, sorted")
    if same:
        notes.append(f"{same} scan stamps are duplicates, kept in the order of the lines")
    return CarmenClock(
        stamps=stamps, order=order, epoch_ns=epoch * 1_000_000_000, is_assumed=False, lines=own_lines
    )


def _travel(poses: Floats) -> float:
    """Return the length [m] of the way from pose to pose, in this order."""
    there = poses[np.isfinite(poses).all(axis=1)]
    return float(np.hypot(*np.diff(there[:, :2], axis=0).T).sum())


def _mended(stamps: Floats) -> Floats:
    """Return the nearest stamps (least squares) that do not go back; those that fall together are spread out."""
    from scipy.optimize import isotonic_regression

    steps = np.diff(stamps)
    steps[steps < -CLOCK.restart] = np.median(steps[steps > 0]) if (steps > 0).any() else CLOCK.assumed_period
    whole = np.concatenate([stamps[:1], stamps[0] + np.cumsum(steps)])
    levels, which, counts = np.unique(isotonic_regression(whole).x, return_inverse=True, return_counts=True)
    edges = np.concatenate([levels[:1], (levels[1:] + levels[:-1]) / 2, levels[-1:]])
    rank = np.arange(len(which)) - np.searchsorted(which, which)
    spread = edges[which] + (rank + 0.5) / counts[which] * (edges[which + 1] - edges[which])
    return np.where(counts[which] > 1, spread, levels[which])
