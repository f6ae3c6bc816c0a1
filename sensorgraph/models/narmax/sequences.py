"""Sequences of scans: stretches without a gap, and the motion of the robot between scans."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensorgraph.types import Bools, Floats, Ints

MAX_STEP = 1.5
"""Time step above which there is a gap, in median steps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanSequence:
    """Poses of scans in the order of time."""

    poses: Floats
    """(n, 3) [m, m, rad]"""
    stamps: Floats
    """(n,) [s]"""
    sequence: Ints
    """(n,) number of each scan's stretch without a gap; equal numbers are adjacent."""

    @cached_property
    def position(self) -> Ints:
        """(n,) number of preceding scans in the stretch of each scan."""
        return positions(np.r_[True, np.diff(self.sequence) != 0])[: len(self.sequence)]

    @cached_property
    def twists(self) -> Floats:
        """(n, 2) [m/s, rad/s] mean speed and turn rate since the preceding scan; until the next scan at a start."""
        n = len(self.poses)
        out = np.zeros((n, 2))
        if n < 2:
            return out
        step = np.maximum(np.diff(self.stamps), 1e-9)
        turn = np.pi - (np.pi - np.diff(self.poses[:, 2])) % (2 * np.pi)
        middle = self.poses[:-1, 2] + 0.5 * turn
        moved = np.diff(self.poses[:, :2], axis=0)
        out[1:, 0] = (moved[:, 0] * np.cos(middle) + moved[:, 1] * np.sin(middle)) / step
        out[1:, 1] = turn / step
        first = np.flatnonzero(self.position == 0)
        out[first] = 0.0
        has_next = first[first + 1 < n]
        has_next = has_next[self.position[has_next + 1] == 1]
        out[has_next] = out[has_next + 1]
        return out

    def signals(self, rows: Ints, lags: int) -> dict[str, Floats]:
        """Return the signals of poses and twist by name, `x(k-1)`, at rows (n_rows,) with `lags` preceding scans."""
        x, y, phi = self.poses.T
        pose = {"x": x, "y": y, "cos_phi": np.cos(phi), "sin_phi": np.sin(phi)}
        out = {
            f"{name}(k-{lag})" if lag else f"{name}(k)": values[rows - lag]
            for lag in range(lags + 1)
            for name, values in pose.items()
        }
        return out | {"v(k)": self.twists[rows, 0], "omega(k)": self.twists[rows, 1]}


def positions(is_first: Bools) -> Ints:
    """Return the number of preceding scans in the stretch of each scan (n,), given the first ones."""
    index = np.arange(len(is_first))
    return index - np.maximum.accumulate(np.where(is_first, index, 0))


def stretches(stamps: Floats, used: Bools, period: float) -> Ints:
    """Number the stretches of used scans (n_used,); unused scans and time gaps separate them.

    Parameters
    ----------
    stamps : (n,) [s]
    used : (n,) Mask of the used scans.
    period : [s] Median step of the stamps.
    """
    index = np.flatnonzero(used)
    if len(index) == 0:
        return np.zeros(0, dtype=np.intp)
    breaks = (np.diff(index) > 1) | (np.diff(stamps[index]) > MAX_STEP * period)
    return np.asarray(np.r_[0, np.cumsum(breaks)], dtype=np.intp)


def held(ranges: Floats, position: Ints) -> Floats:
    """Return the last reading of each ray up to each scan of its stretch (n, n_rays) [m]; nan before the first."""
    n = len(ranges)
    known = np.isfinite(ranges)
    start = np.arange(n) - position
    last = np.maximum.accumulate(np.where(known, np.arange(n)[:, None], -1), axis=0)
    there = last >= start[:, None]
    return np.where(there, np.take_along_axis(ranges, np.maximum(last, 0), axis=0), np.nan)
