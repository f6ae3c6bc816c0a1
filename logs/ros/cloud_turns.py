"""Sort the points of a rotating laser into turns, and measure each turn at bearings of a fixed step.

A rotating laser measures a point at bearing b at the time

    t = t_0 + T q / (2 pi).

Here q is the angle from the cut to b in the direction of rotation, and T is the period of a turn. The clouds of many
drivers do not start at the same bearing, so points are sorted into turns from cut to cut by the times t_0 + n T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import tau
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from logs.resampling import STEEPEST
from logs.ros.cloud_points import Cloud, Plane, Points
from logs.transforms import wrap
from logs.types import Floats

USUAL_STEP = float(np.radians(0.5))
"""[rad] step of the bearings, if the rings are unknown."""
FINEST_STEP = float(np.radians(0.05))
"""[rad] smallest step of the bearings."""
MIN_LINEAR = 0.95
"""Minimum length of the mean phase vector of times and bearings, 1 for a uniform rotation."""
MIN_WHOLE = 0.95
"""A turn of which less than this share of the median turn was measured is left out."""
FIRST_ABSOLUTE = 1e6
"""[s] larger times of points are absolute, from 1970."""
MAX_APART = 10.0
"""[s] absolute times further from the stamp of the cloud belong to another clock."""

TIME_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
"""[s] units of the times of points."""


@dataclass(frozen=True)
class Grid:
    """The bearings of the scans and the rotation."""

    n: int
    """Number of steps in a full turn."""
    cut: float
    """[rad] bearing at which a turn starts."""
    sign: int
    """1: counter-clockwise, -1: clockwise."""
    period: float
    """[s] of a turn; 0: all points of a cloud have one time."""
    unit: float
    """[s] unit of the times of points; 0: without times."""

    @property
    def step(self) -> float:
        """[rad] between two bearings."""
        return tau / self.n

    def angles(self, bearings: Floats) -> Floats:
        """Return the angles (n,) [rad] from the cut, in the direction of rotation."""
        return np.asarray((self.sign * (bearings - self.cut)) % tau)


@dataclass
class _Turn:
    """The points of one turn, perhaps from two clouds."""

    start: int
    """[ns] time of the cut."""
    logged: int
    """[ns] log time of the first cloud."""
    angles: list[Floats] = field(default_factory=list)
    ranges: list[Floats] = field(default_factory=list)
    intensities: list[Floats] = field(default_factory=list)
    seen: list[tuple[float, float]] = field(default_factory=list)
    """[rad] intervals of angles that were measured."""


def find_grid(clouds: Sequence[Cloud], plane: Plane) -> Grid:
    """Determine the step of the bearings and the rotation from the first clouds."""
    chosen = [plane.select(cloud.points) for cloud in clouds]
    full = [one for one in (_fullest_ring(points) for points in chosen) if len(one.xyz) > 2]
    steps = np.concatenate([np.diff(np.sort(one.bearings)) for one in full] or [np.zeros(0)])
    is_ring = any(one.ring is not None for one in full) or not plane.is_slice
    steps = steps[steps > 1e-6]
    step = USUAL_STEP
    if is_ring and len(steps):
        usual = float(np.median(steps))
        even = steps[np.abs(steps - usual) < 0.5 * usual]  # without the gaps of missing returns
        step = float(even.mean()) if len(even) else usual
    n = round(tau / max(step, FINEST_STEP))
    unit = _unit(clouds, chosen)
    found = [rotation for one in full if unit and (rotation := _rotation(one, unit)) is not None]
    phase = np.exp(1j * n * np.concatenate([one.bearings for one in full] or [np.zeros(1)])).mean()
    centre = float(np.angle(phase)) / n  # so that points lie in the middle of a step
    if len(found) <= len(full) / 2 or not found:
        return Grid(n, _aligned(_start(chosen, n), centre, n), 1, 0.0, unit)
    slope = float(np.median(found))
    sign, period = (1 if slope > 0 else -1), tau / abs(slope)
    begins = [
        one.bearings[np.argmin(one.times)]
        for one in (cloud.points for cloud in clouds)
        if one.times is not None and len(one.times)
    ]
    mean = np.exp(1j * np.array(begins)).mean()
    cut = float(np.angle(mean)) - sign * 0.5 * tau / n if abs(mean) > MIN_LINEAR else np.pi
    return Grid(n, _aligned(cut, centre, n), sign, period, unit)


def _aligned(cut: float, centre: float, n: int) -> float:
    """Return the bearing [rad] nearest to `cut` that is a border between two of n steps in a turn."""
    border = centre + 0.5 * tau / n
    return border + tau / n * round((cut - border) * n / tau)


def _fullest_ring(points: Points) -> Points:
    """Return the points of the ring with the most points; all if the rings are unknown."""
    if points.ring is None or not len(points.ring):
        return points
    number, counts = np.unique(points.ring, return_counts=True)
    return points.take(points.ring == number[np.argmax(counts)])


def _unit(clouds: Sequence[Cloud], chosen: Sequence[Points]) -> float:
    """Return the unit [s] in which the times of a cloud span about the time between clouds; 0 without times."""
    spans = [
        float(np.ptp(points.times)) for points in chosen if points.times is not None and len(points.times)
    ]
    steps = np.diff([cloud.stamp for cloud in clouds]) / 1e9
    if not spans or not np.median(spans) > 0:
        return 0.0
    period = float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.1
    return min(TIME_UNITS, key=lambda unit: abs(np.log(np.median(spans) * unit / period)))


def _rotation(points: Points, unit: float) -> float | None:
    """Return the turn rate [rad/s] of a ring, positive counter-clockwise; None if times do not follow the bearings."""
    if points.times is None or len(points.xyz) < 40:
        return None
    order = np.argsort(points.times, kind="stable")
    t, b = (points.times[order] - points.times[order[0]]) * unit, points.bearings[order]
    lag = len(t) // 20
    dt, db = t[lag:] - t[:-lag], wrap(b[lag:] - b[:-lag])
    if not (dt > 0).any():
        return None
    rate = float(np.median(db[dt > 0] / dt[dt > 0]))
    whole = b + tau * np.rint((b[0] + rate * t - b) / tau)
    rate = float(np.polyfit(t, whole, 1)[0])
    phase = np.exp(1j * (b - rate * t))
    return rate if abs(phase.mean()) > MIN_LINEAR and rate != 0 else None


def _start(chosen: Sequence[Points], n: int) -> float:
    """Return the bearing [rad] at the end of the largest gap without points; -pi if points are all around."""
    bearings = np.sort(np.concatenate([points.bearings for points in chosen]))
    if len(bearings) < 2:
        return -np.pi
    gaps = np.append(np.diff(bearings), bearings[0] + tau - bearings[-1])
    k = int(np.argmax(gaps))
    half = 0.5 * tau / n
    return float(bearings[(k + 1) % len(bearings)] - half) if gaps[k] > 5 * tau / n else -np.pi


class TurnScan(NamedTuple):
    """One turn, measured at the bearings of a grid."""

    share: float
    """Share of the turn that was measured."""
    start: int
    """[ns] time of the cut."""
    logged: int
    """[ns] log time of the first cloud."""
    ranges: NDArray[np.float32]
    """(n,) [m]"""
    intensities: NDArray[np.float32]
    """(n,)"""


class TurnScans:
    """Sort the points of clouds into turns, and turns into scans."""

    def __init__(self, grid: Grid, fill: float, reach: float = 1.0) -> None:
        """Begin without a turn.

        Parameters
        ----------
        fill : [m] range of a measured bearing without a point near it
        reach : [steps] distance from the first or last point at which a bearing beyond it takes this point
        """
        self.grid, self.fill, self.reach = grid, fill, reach
        self.centres: Floats = np.asarray((np.arange(grid.n) + 0.5) * grid.step, dtype=np.float64)
        self.scans: list[TurnScan] = []
        self._open: _Turn | None = None

    def add(self, points: Points, cloud: Cloud, logged: int) -> None:
        """Add the points of a cloud that are in the plane."""
        grid, angles, ranges = self.grid, self.grid.angles(points.bearings), points.ranges
        strengths = points.intensities if points.intensities is not None else np.full(len(angles), np.nan)
        times, every = (_times(some, grid.unit, cloud.stamp) for some in (points, cloud.points))
        if not grid.period:
            self.close()
            late = 0.0 if times is None or not len(times) else float(np.median(times))
            self._open = _Turn(
                cloud.stamp + round(late * 1e9), logged, [angles], [ranges], [strengths], [(0.0, tau)]
            )
        elif times is not None and every is not None and len(times):
            self.add_rays(angles, ranges, strengths, times, (every.min(), every.max()), cloud.stamp, logged)

    def add_rays(
        self,
        angles: Floats,
        ranges: Floats,
        strengths: Floats,
        times: Floats,
        span: tuple[float, float],
        stamp: int,
        logged: int,
    ) -> None:
        """Add rays of one message to the turns in which they were measured.

        Parameters
        ----------
        angles, ranges, strengths, times : (n,) [rad] from the cut, [m], intensities, and [s] after the stamp
        span : [s] first and last time of the message, also of rays without a return
        stamp, logged : [ns] stamp and log time of the message
        """
        grid = self.grid
        phase = np.exp(1j * (tau * times / grid.period - angles)).mean()
        start = float(np.angle(phase)) * grid.period / tau
        number = np.rint((times - start) / grid.period - angles / tau)
        for k in np.unique(number).tolist():
            mine, begin = number == k, start + k * grid.period
            at = stamp + round(begin * 1e9)
            if self._open is None or at - self._open.start > grid.period / 2 * 1e9:
                self.close()
                self._open = _Turn(at, logged)
            self._open.angles.append(angles[mine])
            self._open.ranges.append(ranges[mine])
            self._open.intensities.append(strengths[mine])
            first, last = (tau * (t - begin) / grid.period for t in span)
            self._open.seen.append((max(first - grid.step, 0.0), min(last + grid.step, tau)))

    def drop_incomplete(self) -> int:
        """Drop turns of which less was measured than of most, as the first and the last; return their number."""
        usual = float(np.median([scan.share for scan in self.scans])) if self.scans else 0.0
        kept = [scan for scan in self.scans if scan.share >= MIN_WHOLE * usual]
        n_dropped, self.scans = len(self.scans) - len(kept), kept
        return n_dropped

    def close(self) -> None:
        """Make a scan of the open turn."""
        turn, self._open = self._open, None
        if turn is None:
            return
        ranges, intensities = _row(turn, self.centres, self.grid.step, fill=self.fill, reach=self.reach)
        share = sum(stop - start for start, stop in turn.seen) / tau
        self.scans.append(
            TurnScan(
                share, turn.start, turn.logged, ranges.astype(np.float32), intensities.astype(np.float32)
            )
        )


def _times(points: Points, unit: float, stamp: int) -> Floats | None:
    """Return the times (n,) [s] of points after the stamp [ns] of their cloud; None if they are unknown."""
    if points.times is None or unit == 0 or not len(points.times):
        return None
    times = points.times * unit
    if abs(times[0]) < FIRST_ABSOLUTE:
        return times
    after = times - stamp / 1e9
    return after if abs(after[0]) < MAX_APART else times - times.min()


def _row(turn: _Turn, centres: Floats, step: float, *, fill: float, reach: float) -> tuple[Floats, Floats]:
    """Return ranges and intensities (n,) at the bearings of the scan.

    Each bearing takes the nearest point within half a step, or `reach` steps beyond the ends. Between two points of one surface, the inverse range is
    interpolated. A measured bearing without a point near it has the range `fill`, one that was not measured nan.
    """
    q, r, strength = (np.concatenate(part) for part in (turn.angles, turn.ranges, turn.intensities))
    out = np.full(len(centres), np.nan)
    for start, stop in turn.seen:
        out[(centres >= start) & (centres <= stop)] = fill
    if not len(q):
        return out, np.full(len(centres), np.nan)
    cell = np.floor(q / step)
    order = np.lexsort((r, cell))
    order = order[np.concatenate([[True], np.diff(cell[order]) > 0])]  # the nearest point of each step
    order = order[np.argsort(q[order], kind="stable")]
    q, r, strength = q[order], r[order], strength[order]
    right = np.clip(np.searchsorted(q, centres), 1, max(len(q) - 1, 1))
    right = np.minimum(right, len(q) - 1)
    left = np.maximum(right - 1, 0)
    gap = q[right] - q[left]
    near = np.where(np.abs(q[left] - centres) <= np.abs(q[right] - centres), left, right)
    away = np.abs(q[near] - centres)
    inside = (centres >= q[left]) & (centres <= q[right])
    is_joined = inside & (gap > 0) & (gap <= 1.5 * step)
    a, b, share = r[left], r[right], (centres - q[left]) / np.where(gap > 0, gap, 1.0)
    smooth = is_joined & (np.abs(a - b) <= STEEPEST * gap * np.minimum(a, b))
    along = 1.0 / ((1 - share) / a + share / b)
    there = is_joined | (away <= np.where(inside, 0.5, reach) * step)
    out = np.where(there, np.where(smooth, along, r[near]), out)
    return out, np.where(there, strength[near], np.nan)
