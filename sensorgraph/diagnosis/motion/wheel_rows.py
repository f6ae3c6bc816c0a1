"""Rows of the odometry channel: motion of the body between two average poses, against that of the wheels.

Reference poses are averaged over a tenth of a second. Each row compares the distance along the heading and
the turn between two averages with the corresponding increments of the wheels, at an assumed clock offset.

`MotionSignals` are the reference poses of base_link and the increments of the wheels. A row is the motion of the
reference minus that of the wheels: along its heading, in yaw, and across its heading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import solveh_banded

from logs.run import Run
from planners.arena import wrap
from sensorgraph.diagnosis.motion.increments import (
    MAX_GAP,
    MIN_ROWS,
    SAME_STAMP,
    ChannelSkippedError,
    WheelIncrements,
    require_reference,
    wheel_increments,
)
from sensorgraph.diagnosis.motion.regression import CLUSTER, Rows
from sensorgraph.diagnosis.motion.whitening import by_kind, clipped
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints

FEW_INCREMENTS = 0.995
"""Quantile of the number of increments per row that rows have space for; rows with more are not valid."""
WINDOW = SCAN.block
"""[s] averaging time of speeds in the gap, of the offset between the headings of reference and wheels, and of motions that
are compared; long against the offset of a usual clock."""
AVERAGING_TIME = 0.1
"""[s] over which reference poses are averaged."""
MIN_TRAVEL = 0.02
"""[m or rad] minimum extent of the reference along one axis, or minimum turn; otherwise it does not move."""
MIN_OVERLAP = 0.9
"""Share of the run during which poses and odometry overlap, below which a note reports it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryRows(Rows):
    """Both sides of the comparison, for one assumed clock offset."""

    clock: float
    """[s] assumed age of the odometry at its stamp."""
    stamps: Floats
    """(n,) [s]"""
    poses: Floats
    """(n, 3) reference pose between both averages."""
    averages: Floats
    """(n + 1, 3) averaged reference poses, positions smoothed with the wheels, yaw unwrapped."""
    along: Floats
    """(n,) [m] of the reference along its heading."""
    across: Floats
    """(n,) [m] of the reference to the left of its heading."""
    yaw: Floats
    """(n,) [rad] of the reference."""
    D_along: sparse.csr_array
    """(n, n_increments) maps distances of increments to rows along the heading."""
    D_across: sparse.csr_array
    """(n, n_increments) maps distances of increments to rows across the heading, since the robot turns within a row."""
    D_yaw: sparse.csr_array
    """(n, n_increments) maps turns of increments to rows of yaw."""
    slopes: Floats
    """(n, 2) [m/s, rad/s] derivative of the wheels' motion with respect to the clock offset."""
    increment_poses: Floats
    """(n_increments, 3) reference pose in the middle of each increment."""

    def of_kinds(self, along: Floats, yaw: Floats, across: Floats | None = None) -> Floats:
        """Return rows (3 n, ...) of distances, turns and distances across the heading (n, ...); 0 where not valid."""
        return self.masked(np.concatenate([along, yaw, np.zeros_like(along) if across is None else across]))

    def of_wheels(self, distance: Floats, turn: Floats) -> Floats:
        """Return rows (3 n, ...) of distances and turns of the increments (n_increments, ...)."""
        return self.of_kinds(self.D_along @ distance, self.D_yaw @ turn)

    def of_sides(self, left: Floats, right: Floats, base: float) -> Floats:
        """Return rows of the distances of the left and the right wheel (n_increments, ...), `base` [m] apart."""
        return self.of_wheels((left + right) / 2, (right - left) / base)


def rows_at(signals: MotionSignals, clock: float) -> OdometryRows | None:
    """Average the poses and assign the increments to them; None if there are hardly any poses during the odometry.

    Parameters
    ----------
    clock : [s] Assumed age of the odometry at its stamp.
    """
    wheels = signals.wheels
    start, end = wheels.start - clock, wheels.end - clock
    inside = (signals.stamps >= start[0]) & (signals.stamps <= end[-1])
    stamps, poses = signals.stamps[inside], signals.poses[inside]
    if len(stamps) < MIN_ROWS:
        return None
    period = float(np.median(np.diff(stamps)))
    m = max(1, round(AVERAGING_TIME / period))
    n = len(stamps) // m
    t = stamps[: n * m].reshape(n, m)
    averages = poses[: n * m].reshape(n, m, 3).mean(axis=1)
    centre, middle, ends = t.mean(axis=1), (start + end) / 2, np.append(start, end[-1])
    border = (centre[1:] + centre[:-1]) / 2
    # headings follow the wheels, corrected by the reference averaged over a second
    total = np.concatenate([[0.0], np.cumsum(wheels.turn)])
    offset = averages[:, 2] - np.interp(t, ends, total).mean(axis=1)
    offset = _moving_average(offset, WINDOW / (m * period))
    heading = np.interp(middle, ends, total) + np.interp(middle, centre, offset)
    phi = np.interp(border, ends, total) + np.interp(border, centre, offset)
    step = np.diff(averages, axis=0)
    is_dense = np.ptp(t, axis=1) < MAX_GAP + m * period
    valid = (np.diff(centre) < max(MAX_GAP, 2.5 * m * period)) & is_dense[1:] & is_dense[:-1]
    weights, index, has_room = _overlaps(t, start, end)
    smooth = _smooth_positions(averages, wheels, heading, centre, ends, m * period)
    increment_poses = [np.interp(middle, centre, column) for column in smooth.T]
    return OdometryRows(
        clock=clock,
        stamps=border,
        poses=np.column_stack([((averages[1:] + averages[:-1]) / 2)[:, :2], phi]),
        averages=np.column_stack([smooth, averages[:, 2]]),
        valid=valid & has_room,
        along=step[:, 0] * np.cos(phi) + step[:, 1] * np.sin(phi),
        across=step[:, 1] * np.cos(phi) - step[:, 0] * np.sin(phi),
        yaw=step[:, 2],
        D_along=_sparse(weights * np.cos(heading[index] - phi[:, None]), index, len(start)),
        D_across=_sparse(weights * np.sin(heading[index] - phi[:, None]), index, len(start)),
        D_yaw=_sparse(weights, index, len(start)),
        slopes=_slopes(t, wheels, clock),
        increment_poses=np.stack([*increment_poses, heading], axis=1),
    )


def _smooth_positions(
    averages: Floats, wheels: WheelIncrements, heading: Floats, centre: Floats, ends: Floats, period: float
) -> Floats:
    """Return positions (n + 1, 2) that follow the wheels over short times and the reference over long times."""
    steps = wheels.distance[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    trail = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    by_wheels = np.stack([np.interp(centre, ends, column) for column in trail.T], axis=1)
    width = CLUSTER / period
    offsets = [_moving_average(column, width) for column in (averages[:, :2] - by_wheels).T]
    return np.asarray(by_wheels + np.stack(offsets, axis=1))


def _moving_average(values: Floats, width: float) -> Floats:
    """Return a centred moving average (n,) over about `width` values."""
    odd = max(3, min(round(width), len(values))) // 2 * 2 + 1
    padded = np.pad(values, odd // 2, mode="edge")
    return np.convolve(padded, np.ones(odd) / odd, mode="valid")


def _overlaps(t: Floats, start: Floats, end: Floats) -> tuple[Floats, Ints, Bools]:
    """Return the share of each increment between two averages: weights (n, o), indices (n, o), validity (n,)."""
    first = np.clip(np.searchsorted(end, t[:-1, 0], side="right"), 0, len(end) - 1)
    last = np.clip(np.searchsorted(start, t[1:, -1], side="left"), 0, len(end) - 1)
    room = int(np.quantile(last - first, FEW_INCREMENTS)) + 4
    places = first[:, None] - 1 + np.arange(room)
    index = np.clip(places, 0, len(end) - 1)
    a, span = start[index][..., None], (end - start)[index][..., None]
    weights = _shares((t[1:, None, :] - a) / span) - _shares((t[:-1, None, :] - a) / span)
    weights[places != index] = 0.0
    ok = (last - first < room - 2) & ((end - start)[index].max(axis=1) < MAX_GAP)
    return weights, index, ok


def _shares(u: Floats) -> Floats:
    """Return the share of neighbouring increments (n, o) that has passed, as a mean over moments.

    The rate changes linearly within an increment, by half the difference of its neighbours. With a constant
    rate, a robot that starts to turn would seem to turn early (2 mrad at 3 rad/s² and increments of 50 ms).

    Parameters
    ----------
    u : (n, o, m) Moments, 0 at the start of each increment and 1 at its end.
    """
    u = np.clip(u, 0.0, 1.0)
    out, bend = u.mean(axis=2), (u * (u - 1.0)).mean(axis=2) / 4
    out[:, 1:] += bend[:, :-1]
    out[:, :-1] -= bend[:, 1:]
    return np.asarray(out)


def _sparse(weights: Floats, index: Ints, n: int) -> sparse.csr_array:
    rows = np.repeat(np.arange(len(weights)), weights.shape[1])
    return sparse.csr_array(
        sparse.coo_array((weights.ravel(), (rows, index.ravel())), shape=(len(weights), n))
    )


def _slopes(t: Floats, wheels: WheelIncrements, clock: float) -> Floats:
    """Return the derivative of the wheels' motion (n, 2) with respect to the clock: the change of smoothed rates."""
    window = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9
    rates = [np.convolve(np.pad(rate, 2, mode="edge"), window, mode="valid") for rate in wheels.rates.T]
    means = [np.interp(t, wheels.middle - clock, rate).mean(axis=1) for rate in rates]
    return np.stack([np.diff(mean) for mean in means], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionSignals:
    """Both sides of the comparison, and notes."""

    stamps: Floats
    """(n,) [s] of the reference."""
    poses: Floats
    """(n, 3) reference poses of base_link, yaw unwrapped."""
    wheels: WheelIncrements
    notes: Mapping[str, object]
    """Plain data for the report."""


def motion_signals(run: Run) -> MotionSignals:
    """Return reference poses and odometry of a run.

    Raises
    ------
    ChannelSkippedError
        The run lacks one of them, one of them does not move, or the poses are the odometry.
    """
    require_reference(run)
    wheels = wheel_increments(run)
    good: Bools = np.asarray(np.isfinite(run.poses).all(axis=1))
    good[1:] &= np.diff(run.pose_stamps) > SAME_STAMP
    stamps, poses = run.pose_stamps[good], run.poses[good].copy()
    if len(stamps) < MIN_ROWS:
        raise ChannelSkippedError(f"this run has {len(stamps)} reference poses, expected at least {MIN_ROWS}")
    travel, rotation = np.ptp(poses[:, :2], axis=0).max(), np.ptp(wrap(poses[:, 2] - poses[0, 2]))
    if travel < MIN_TRAVEL and rotation < MIN_TRAVEL:
        raise ChannelSkippedError("the reference poses of this run do not move")
    poses[:, 2] = np.unwrap(poses[:, 2])
    if run.pose_frame == "laser":
        mount = run.sensor.mount
        poses[:, 2] -= mount[2]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        poses[:, :2] -= np.stack([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1)
    notes: dict[str, object] = {"odometry_from": wheels.source}
    first, last = max(stamps[0], wheels.start[0]), min(stamps[-1], wheels.end[-1])
    whole = max(stamps[-1], wheels.end[-1]) - min(stamps[0], wheels.start[0])
    if last - first < MIN_OVERLAP * whole:
        notes["overlap"] = (
            f"poses and odometry overlap from {first:.1f} to {last:.1f} s, {last - first:.1f} of {whole:.1f} s; the rest is not used"
        )
    return MotionSignals(stamps=stamps, poses=poses, wheels=wheels, notes=notes)


def fused_motion(rows: OdometryRows, wheels: WheelIncrements, residual: Floats) -> WheelIncrements:
    """Return the increments of the wheels less their noise, as far as the reference shows it.

        minimise over x  |total - x|² + |diff x|² level / walk

    Rows are reference minus wheels. A column made of the wheels' readings would share its noise with the rows (errors
    in variables; Fuller 1987, chapter 1), and find false scales where it selects increments by their noisy speed, or by
    standstill. The noise of the wheels is a random walk x, seen with the noise of the averaged reference in the
    accumulated residual (local-level model; Durbin and Koopman 2012, section 2.4). Mean squares of single rows and of sums
    over k rows, which grow with the walk only, determine both variances:

        walk = (block - single) / (k - 2/3),   level = (single - 2/3 walk) / 2

    Parameters
    ----------
    residual : (3 n,) [m, rad, m] residual of the model.
    """
    period, ends = (
        float(np.median(np.diff(rows.stamps))),
        np.append(wheels.start, wheels.end[-1]) - rows.clock,
    )
    k, noise = max(round(CLUSTER / period), 2), list[Floats]()
    for kind in by_kind(residual, rows.n)[:2]:
        part = np.where(rows.valid, clipped(kind, rows.valid, SCAN.goodness_of_fit.clip, 1e-12), 0.0)
        n = max(len(part) // k, 1)
        single = float(np.mean(part**2)) + 1e-18
        block = float(np.mean(part[: n * k].reshape(n, -1).sum(axis=1) ** 2))
        walk = float(np.clip((block - single) / (k - 2 / 3), 0.0, 1.5 * single))
        ratio = max(walk / max((single - 2 / 3 * walk) / 2, 1e-18), 1e-9)
        bands = np.full((2, len(part)), -1.0 / ratio)
        bands[1] = 1.0 + 2.0 / ratio
        bands[1, [0, -1]] = 1.0 + 1.0 / ratio
        bands[0, 0] = 0.0
        noise.append(np.diff(np.interp(ends, rows.stamps, solveh_banded(bands, np.cumsum(part)))))
    return replace(wheels, distance=wheels.distance + noise[0], turn=wheels.turn + noise[1])
