"""Curves with their timing: the representation that clearance, coverage, time and export share.

A curve is a chain of pieces with constant acceleration a of v and alpha of omega. Within a piece, from
heading phi:

    v(t) = v + a t,   omega(t) = omega + alpha t,   phi(t) = phi + omega t + alpha t² / 2.

The displacement within dt is an integral over t from 0 to dt:

    (x, y) = ∫ v(t) (cos phi(t), sin phi(t)) dt.

It is evaluated by Gauss-Legendre quadrature with 8 nodes, which is exact to rounding for straight moves and
spins. For the short blends of both, the error is 1e-12 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planners.arena import wrap
from planners.trajectory import SAMPLES_AT_A_TIME, Trajectory
from planners.types import ROUND_OFF, Floats
from planners.vehicle import Limits

RATE = 50.0
"""[Hz] of exported samples."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)  # constants of compiled code, see `planners.kernel`

Profile = tuple[Floats, Floats]
"""Durations (k,) [s] and accelerations (k,) of one rest-to-rest motion."""


def trapezoid(distance: float, top: float, rate: float) -> Profile:
    """Return the fastest rest-to-rest profile over a signed distance, with speed up to `top` and acceleration `rate`.

    It is a trapezoid of ramps top / rate and a cruise at `top`; over less than top² / rate it is a triangle
    of ramps sqrt(distance / rate).
    """
    length, sign = abs(distance), 1.0 if distance >= 0 else -1.0
    if length == 0:
        return np.zeros(0), np.zeros(0)
    ramp = min(top / rate, float(np.sqrt(length / rate)))
    peak = ramp * rate
    cruise = max(length / peak - ramp, 0.0)
    if cruise < 1e-9:
        return np.array([ramp, ramp]), np.array([rate, -rate]) * sign
    return np.array([ramp, cruise, ramp]), np.array([rate, 0.0, -rate]) * sign


def duration(distance: Floats | float, top: float, rate: float) -> Floats:
    """Return the duration [s] of `trapezoid` for arrays of distances.

    It is d / top + top / rate for d > top² / rate, else 2 sqrt(d / rate).
    """
    length = np.abs(np.asarray(distance, dtype=np.float64))
    return np.where(length > top * top / rate, length / top + top / rate, 2 * np.sqrt(length / rate))


def displace(
    phi: Floats, v: Floats, a: Floats, omega: Floats, alpha: Floats, dt: Floats
) -> tuple[Floats, Floats]:
    """Return the displacement x, y [m] within `dt` from heading phi: the integral of the module docstring."""
    t = dt[..., None] * (0.5 + 0.5 * NODES)  # (..., 8)
    speed = v[..., None] + a[..., None] * t
    heading = phi[..., None] + omega[..., None] * t + 0.5 * alpha[..., None] * t * t
    weight = 0.5 * dt[..., None] * WEIGHTS * speed
    return (weight * np.cos(heading)).sum(axis=-1), (weight * np.sin(heading)).sum(axis=-1)


@lru_cache(maxsize=4096)
def blend_offset(a: float, alpha: float, overlap: float) -> tuple[float, float]:
    """Return the end offset (ahead, aside) [m] of a move, in its own frame, if a turn starts before its end.

    Parameters
    ----------
    a : [m/s²] Acceleration of the move's first ramp, negative for a backward move; the last ramp has -a.
    alpha : [rad/s²] Angular acceleration of the turn's first ramp.
    overlap : [s] Time from the start of the turn to the end of the move.
    """
    parts = (0.0, a * overlap, -a, 0.0, alpha, overlap)
    x, y = displace(*(np.asarray(part, dtype=np.float64) for part in parts))
    return float(x) - 0.5 * a * overlap * overlap, float(y)


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Pieces of constant acceleration, in order."""

    starts: Floats
    """(n,) [s] start of each piece, increasing from 0."""
    duration: float
    """[s] total duration."""
    poses: Floats
    """(n, 3) [m, m, rad] pose at the start of each piece; phi is continuous (not wrapped)."""
    twists: Floats
    """(n, 2) [m/s, rad/s] twist at the start of each piece."""
    rates: Floats
    """(n, 2) [m/s², rad/s²] accelerations within each piece."""
    labels: NDArray[np.str_]
    """(n,) primitive of each piece."""

    def sample(self, stamps: Floats) -> tuple[Floats, Floats, NDArray[np.str_]]:
        """Return poses (m, 3), twists (m, 2) and labels (m,) at stamps (m,) [s] within the curve."""
        k = np.clip(np.searchsorted(self.starts, stamps, side="right") - 1, 0, len(self.starts) - 1)
        poses, twists = np.empty((len(k), 3)), np.empty((len(k), 2))
        for first in range(0, len(k), SAMPLES_AT_A_TIME):
            part = slice(first, first + SAMPLES_AT_A_TIME)
            poses[part], twists[part] = self._within(k[part], stamps[part])
        return poses, twists, self.labels[k]

    def _within(self, k: NDArray[np.int64], stamps: Floats) -> tuple[Floats, Floats]:
        """Return poses (m, 3) and twists (m, 2) at stamps (m,) [s] within pieces `k` (m,)."""
        dt = np.clip(stamps, 0.0, self.duration) - self.starts[k]
        (v, omega), (a, alpha) = self.twists[k].T, self.rates[k].T
        x, y, phi = self.poses[k].T
        moving = (v != 0) | (a != 0)
        offset = np.zeros((len(k), 2))
        parts = (phi, v, a, omega, alpha, dt)
        offset[moving] = np.stack(displace(*(part[moving] for part in parts)), axis=1)
        poses = np.stack(
            [x + offset[:, 0], y + offset[:, 1], wrap(phi + omega * dt + 0.5 * alpha * dt * dt)], axis=1
        )
        return poses, np.stack([v + a * dt, omega + alpha * dt], axis=1)

    def log(self, rate: float, phase: float = 0.0) -> Floats:
        """Return the poses (m, 3) in a log at `rate` [Hz] whose first sample is at `phase` [s]."""
        n = int(np.floor((self.duration - phase) * rate + 1e-9)) + 1
        return self.sample(phase + np.arange(n) / rate)[0]

    @property
    def end(self) -> Floats:
        """(3,) pose at the end, with phi wrapped."""
        return np.asarray(self.sample(np.array([self.duration]))[0][0])

    def until(self, stamp: float, alpha: float) -> Curve:
        """Return the curve up to the last rest at or before `stamp` [s].

        If the robot still turns there, a braking turn at `alpha` [rad/s²] is appended. The part is itself a
        complete drive, and it is clear wherever the whole curve is.

        Raises
        ------
        ValueError : The robot does not rest between its start and the stamp.
        """
        rests = np.flatnonzero((self.starts <= stamp) & (abs(self.twists[:, 0]) < 1e-9))
        k = int(rests.max(initial=0))
        if k == 0:
            raise ValueError(
                f"the robot does not stand still between its start and {stamp:g} s; choose a later stamp"
            )
        omega = float(self.twists[k, 1])
        ramp = abs(omega) / alpha
        n = k + (ramp > 0)
        rates, labels = self.rates[:n].copy(), self.labels[:n].copy()
        if ramp > 0:
            rates[k], labels[k] = (0.0, -np.copysign(alpha, omega)), "turn"
        return Curve(
            starts=self.starts[:n],
            duration=float(self.starts[k] + ramp),
            poses=self.poses[:n],
            twists=self.twists[:n],
            rates=rates,
            labels=labels,
        )

    def trajectory(self, rate: float = RATE) -> Trajectory:
        """Sample at an even rate [Hz]; the robot is at rest in the last sample."""
        (whole,) = self.parts(rate, self._count(rate))
        return whole

    def parts(self, rate: float, size: int = SAMPLES_AT_A_TIME) -> Iterator[Trajectory]:
        """Sample at an even rate [Hz], in parts of `size` steps; consecutive parts share a sample."""
        n = self._count(rate)
        for first in range(0, n - 1, size):
            stamps = np.arange(first, min(first + size + 1, n)) / rate
            poses, twists, labels = self.sample(stamps)
            if first + size >= n - 1:
                twists[-1] = 0.0
            yield Trajectory(stamps=stamps, poses=poses, twists=twists, primitives=labels)

    def _count(self, rate: float) -> int:
        """Return the number of samples at a rate [Hz], at least two."""
        return max(int(np.ceil(self.duration * rate - 1e-9)) + 1, 2)


@dataclass(frozen=True)
class _Motion:
    """The last motion: axis (0 drives, 1 turns), duration [s] of its last ramp, signed rate of its first."""

    axis: int = -1
    ramp: float = 0.0
    rate: float = 0.0


class CurveBuilder:
    """Build a curve of straight moves and turns on the spot, each from rest to rest; consecutive motions may overlap.

    With an overlap, a motion starts while the one before still brakes. v and omega keep their own profiles,
    so the limits hold. The overlap bends the path by a few mm, which `pose` includes.
    """

    def __init__(self, pose: Floats, limits: Limits, *, spin: float | None = None) -> None:
        self.limits = limits
        self.spin = limits.omega if spin is None else min(spin, limits.omega)
        """[rad/s] maximum turn rate."""
        self.pose = np.array(pose, dtype=np.float64)
        """(3,) pose at rest at the end of the curve so far; phi is continuous (not wrapped)."""
        self.last_turn = 1
        """Direction of the last turn: 1 counter-clockwise, -1 clockwise."""
        self.stops: list[tuple[float, float, float, float]] = []
        """Turns so far: x, y [m], phi on arrival, angle [rad]."""
        self._first = self.pose.copy()
        self._clock = 0.0
        self._last = _Motion()
        self._pieces: tuple[list[tuple[float, float, float]], ...] = (
            [],
            [],
        )  # per axis: start, v or omega, rate
        self._marks: list[tuple[float, str]] = []

    @property
    def clock(self) -> float:
        """[s] end of the curve so far."""
        return self._clock

    def move(self, distance: float, label: str = "move", overlap: float = 0.0) -> None:
        """Drive straight [m], backward if negative; start up to `overlap` [s] before the end of the last turn."""
        if abs(distance) < ROUND_OFF:
            return
        times, rates = trapezoid(distance, self.limits.v, self.limits.a)
        before, back = self._last, self._append(0, times, rates, label, overlap)
        self.pose[:2] += _turned(self.pose[2], distance, 0.0)
        if back > 0:  # the turn's last ramp reversed in time is a turn in the other direction
            self.pose[:2] += _turned(self.pose[2], *blend_offset(float(rates[0]), -before.rate, back))

    def turn(self, angle: float, label: str = "turn", overlap: float = 0.0) -> None:
        """Turn on the spot [rad], clockwise if negative; start up to `overlap` [s] before the end of the last move."""
        if abs(angle) < ROUND_OFF:
            return
        times, rates = trapezoid(angle, self.spin, self.limits.alpha)
        self.pose[:2] = self.rest(angle, overlap)
        self._append(1, times, rates, label, overlap)
        self.stops.append((*self.pose.tolist(), angle))
        self.last_turn = 1 if angle > 0 else -1
        self.pose[2] += angle

    def face(self, heading: float) -> None:
        """Turn on the spot to a heading [rad], in the direction of the smaller angle."""
        self.turn(float(wrap(np.float64(heading - self.pose[2]))), "turn")

    def follow(self, path: Floats) -> None:
        """Turn and drive along the corners of a path (k, 2) [m] that begins at the robot's place."""
        for corner in path[1:]:
            leg = corner - self.pose[:2]
            length = float(np.hypot(*leg))
            if length > ROUND_OFF:
                self.face(float(np.arctan2(leg[1], leg[0])))
                self.move(length, "move" if len(path) == 2 else "join")

    def rest(self, angle: float, overlap: float) -> Floats:
        """Return the end (2,) [m] of the last move if a turn by `angle` starts `overlap` [s] early."""
        ramp = min(self.spin / self.limits.alpha, float(np.sqrt(abs(angle) / self.limits.alpha)))
        back = self._allowed(1, ramp, overlap)
        if back <= 0:
            return self.pose[:2].copy()
        alpha = float(np.copysign(self.limits.alpha, angle))
        return np.asarray(self.pose[:2] + _turned(self.pose[2], *blend_offset(self._last.rate, alpha, back)))

    def wait(self, seconds: float, label: str = "wait") -> None:
        """Stand still [s]."""
        self._append(0, np.array([seconds]), np.zeros(1), label, 0.0)
        self._last = _Motion()

    def _allowed(self, axis: int, ramp: float, overlap: float) -> float:
        """Limit an overlap to the durations of both ramps; only a move and a turn can overlap."""
        return 0.0 if self._last.axis in (axis, -1) else max(min(overlap, self._last.ramp, ramp), 0.0)

    def _append(self, axis: int, times: Floats, rates: Floats, label: str, overlap: float) -> float:
        back = self._allowed(axis, float(times[0]), overlap)
        at, value = self._clock - back, 0.0
        self._marks.append((at, label))
        for length, rate in zip(times.tolist(), rates.tolist(), strict=True):
            self._pieces[axis].append((at, value, rate))
            at, value = at + length, value + length * rate
        self._pieces[axis].append((at, 0.0, 0.0))
        self._clock = at
        self._last = _Motion(axis, float(times[-1]), float(rates[0]))
        return back

    def curve(self) -> Curve:
        """Return the curve.

        Raises
        ------
        ValueError : The builder has no move, turn or wait yet.
        """
        if not self._marks:
            raise ValueError("the curve is empty; expected at least one move, turn or wait")
        axes = [np.array([(0.0, 0.0, 0.0), *pieces]) for pieces in self._pieces]  # (k, 3)
        starts = np.unique(np.round(np.concatenate([axis[:, 0] for axis in axes]), 9))
        starts = starts[starts < self._clock - 1e-9]
        twists, rates = np.zeros((len(starts), 2)), np.zeros((len(starts), 2))
        for column, axis in enumerate(axes):
            k = np.searchsorted(axis[:, 0], starts + 1e-9, side="right") - 1
            at, value, rate = axis[k].T
            twists[:, column], rates[:, column] = value + rate * (starts - at), rate
        dt = np.diff(starts, append=self._clock)
        turned = twists[:, 1] * dt + 0.5 * rates[:, 1] * dt * dt
        phi = self._first[2] + np.concatenate([[0.0], np.cumsum(turned)[:-1]])
        steps = np.stack(displace(phi, twists[:, 0], rates[:, 0], twists[:, 1], rates[:, 1], dt), axis=1)
        places = self._first[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
        marked = np.array([at for at, _ in self._marks])
        labels = np.array([label for _, label in self._marks], dtype=np.str_)
        return Curve(
            starts=starts,
            duration=self._clock,
            poses=np.column_stack([places, phi]),
            twists=twists,
            rates=rates,
            labels=labels[np.clip(np.searchsorted(marked, starts + 1e-9, side="right") - 1, 0, None)],
        )


def _turned(heading: float, ahead: float, aside: float) -> Floats:
    """Return the offset (2,) in map axes of an offset in the frame of a heading."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([cos * ahead - sin * aside, sin * ahead + cos * aside])


def join_curves(curves: list[Curve]) -> Curve:
    """Join curves; each starts at the pose and twist at which the one before ends.

    Raises
    ------
    ValueError : The list is empty.
    """
    if not curves:
        raise ValueError("no curve to join; expected at least one")
    ends = np.concatenate([[0.0], np.cumsum([curve.duration for curve in curves])])
    return Curve(
        starts=np.concatenate([curve.starts + at for curve, at in zip(curves, ends, strict=False)]),
        duration=float(ends[-1]),
        poses=np.concatenate([curve.poses for curve in curves]),
        twists=np.concatenate([curve.twists for curve in curves]),
        rates=np.concatenate([curve.rates for curve in curves]),
        labels=np.concatenate([curve.labels for curve in curves]),
    )


def curve_of_pieces(
    pose: Floats, dt: Floats, twists: Floats, rates: Floats, labels: NDArray[np.str_]
) -> Curve:
    """Return the curve of consecutive pieces from `pose` (3,).

    Parameters
    ----------
    dt : (n,) [s] Duration of each piece.
    twists : (n, 2) [m/s, rad/s] Twist at the start of each piece.
    rates : (n, 2) [m/s², rad/s²] Accelerations within each piece.
    labels : (n,) Primitive of each piece.
    """
    turned = twists[:, 1] * dt + 0.5 * rates[:, 1] * dt * dt
    phi = pose[2] + np.concatenate([[0.0], np.cumsum(turned)[:-1]])
    steps = np.stack(displace(phi, twists[:, 0], rates[:, 0], twists[:, 1], rates[:, 1], dt), axis=1)
    places = pose[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
    starts = np.concatenate([[0.0], np.cumsum(dt)])
    return Curve(
        starts=starts[:-1],
        duration=float(starts[-1]),
        poses=np.column_stack([places, phi]),
        twists=twists,
        rates=rates,
        labels=labels,
    )
