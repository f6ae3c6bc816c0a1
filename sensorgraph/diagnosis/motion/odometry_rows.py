"""Rows of the odometry channel: what the body did from one average pose to the next, against what the wheels say.

Reference poses are averaged over a tenth of a second; each row compares the way along the heading and the turn
between two averages with the wheels' increments under them, at an assumed offset of the clocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from logs.run import Run
from planners.arena import wrap
from sensorgraph.diagnosis.motion.whitened_regression import Increments, increments, own_reference
from sensorgraph.types import Bools, Floats

GROUP = 0.1
"""[s] over which reference poses are averaged."""
LARGEST_GAP = 0.35
"""[s] without poses or odometry across which nothing is compared."""
LEAST_ROWS = 60


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Both sides of the comparison, for one assumed clock offset."""

    clock: float
    """[s] the odometry is taken to be older than its stamp."""
    stamps: Floats
    """(n,) [s]"""
    poses: Floats
    """(n, 3) reference pose between both averages."""
    levels: Floats
    """(n + 1, 3) averaged reference poses, positions smoothed by the wheels, yaw not wrapped."""
    is_valid: Bools
    """(n,)"""
    along: Floats
    """(n,) [m] of the reference along its heading."""
    yaw: Floats
    """(n,) [rad] of the reference."""
    D_along: sparse.csr_array
    """(n, n_increments) turns way into rows."""
    D_yaw: sparse.csr_array
    """(n, n_increments) turns turn into rows."""
    slopes: Floats
    """(n, 2) derivative of what the wheels say by the clock [m/s, rad/s]."""
    spots: Floats
    """(n_increments, 3) reference pose in the middle of each increment."""

    @property
    def n(self) -> int:
        """Count of rows of one kind."""
        return len(self.stamps)


def signals_of(run: Run) -> tuple[Floats, Floats, Increments, dict[str, object]] | str:
    """Return reference stamps and poses of base_link, the wheels' increments and notes; or why not."""
    if skipped := own_reference(run):
        return skipped
    wheels = increments(run)
    if wheels is None:
        return "this run has no odometry that moves"
    good: Bools = np.asarray(np.isfinite(run.poses).all(axis=1))
    good[1:] &= np.diff(run.pose_stamps) > 1e-6
    stamps, poses = run.pose_stamps[good], run.poses[good].copy()
    if len(stamps) < LEAST_ROWS:
        return f"this run has {len(stamps)} reference poses, expected at least {LEAST_ROWS}"
    if np.ptp(poses[:, :2], axis=0).max() < 0.02 and np.ptp(wrap(poses[:, 2] - poses[0, 2])) < 0.05:
        return "the reference poses of this run do not move"
    poses[:, 2] = np.unwrap(poses[:, 2])
    if run.pose_frame == "laser":
        mount = run.sensor.mount
        poses[:, 2] -= mount[2]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        poses[:, :2] -= np.stack([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1)
    notes: dict[str, object] = {"odometry_from": wheels.source}
    first, last = max(stamps[0], wheels.start[0]), min(stamps[-1], wheels.end[-1])
    whole = max(stamps[-1], wheels.end[-1]) - min(stamps[0], wheels.start[0])
    if last - first < 0.9 * whole:
        notes["overlap"] = (
            f"poses and odometry overlap from {first:.1f} to {last:.1f} s, {last - first:.1f} of {whole:.1f} s; the rest is not used"
        )
    return stamps, poses, wheels, notes


def aligned(stamps: Floats, poses: Floats, wheels: Increments) -> Rows | str:
    """Return rows at the clock offset that fits best."""
    clock = _coarse_clock(stamps, poses, wheels)
    rows: Rows | None = None
    for turn in range(4):
        rows = lay_out(stamps, poses, wheels, clock)
        if rows is None or int(rows.is_valid.sum()) < LEAST_ROWS:
            n = 0 if rows is None else int(rows.is_valid.sum())
            return f"poses and odometry overlap in {n} tenths of a second, expected at least {LEAST_ROWS}"
        if turn == 3:
            break
        ok = rows.is_valid
        A, y = stack(rows, wheels, 0.4)
        fit = np.concatenate([ok, ok])
        scale = np.repeat([np.std(y[: rows.n][ok]) + 1e-9, np.std(y[rows.n :][ok]) + 1e-9], rows.n)
        for _ in range(2):  # each kind of row by its own spread
            theta = np.linalg.lstsq((A / scale[:, None])[fit], (y / scale)[fit], rcond=1e-9)[0]
            left = y - A @ theta
            scale = np.repeat([np.std(left[: rows.n][ok]) + 1e-9, np.std(left[rows.n :][ok]) + 1e-9], rows.n)
        step = float(np.clip(theta[3], -0.05, 0.05))
        clock += step
        if abs(step) < 2e-4:
            break
    assert rows is not None
    return rows


def _coarse_clock(stamps: Floats, poses: Floats, wheels: Increments, reach: float = 0.8) -> float:
    """Return the clock offset [s] at which turn rate and speed of wheels and reference go together best."""
    step = 0.025
    first, last = max(stamps[0], wheels.start[0]) + reach, min(stamps[-1], wheels.end[-1]) - reach
    if last - first < 5.0:
        return 0.0
    grid = np.arange(first - reach, last + reach, step)
    half = 0.1
    at = [np.interp(grid + d, stamps, poses[:, i]) for d in (-half, half) for i in range(3)]
    heading = np.interp(grid, stamps, poses[:, 2])
    turn = at[5] - at[2]
    way = (at[3] - at[0]) * np.cos(heading) + (at[4] - at[1]) * np.sin(heading)
    ends = np.append(wheels.start, wheels.end[-1])
    best = np.zeros(round(2 * reach / step) + 1)
    margin = round(reach / step)
    for seen, said in ((turn, wheels.turn), (way, wheels.way)):
        total = np.concatenate([[0.0], np.cumsum(said)])
        move = np.interp(grid + half, ends, total) - np.interp(grid - half, ends, total)
        inner = seen[margin : len(seen) - margin]
        power = np.sum((inner - inner.mean()) ** 2)
        if power < 1e-12:
            continue
        for k in range(len(best)):  # the odometry at t + tau shows the reference at t
            shifted = move[k : k + len(inner)]
            best[k] -= np.sum((inner - shifted) ** 2) / power
    k = int(np.argmax(best))
    if not 0 < k < len(best) - 1:
        return 0.0
    a, b, c = best[k - 1 : k + 2]
    bend = a - 2 * b + c
    return float((k - margin + (0.5 * (a - c) / bend if bend < 0 else 0.0)) * step)


def lay_out(stamps: Floats, poses: Floats, wheels: Increments, clock: float) -> Rows | None:
    """Group the poses and lay the increments out under them."""
    start, end = wheels.start - clock, wheels.end - clock
    inside = (stamps >= start[0]) & (stamps <= end[-1])
    stamps, poses = stamps[inside], poses[inside]
    if len(stamps) < 10:
        return None
    period = float(np.median(np.diff(stamps)))
    m = max(1, round(GROUP / period))
    n = len(stamps) // m
    t = stamps[: n * m].reshape(n, m)
    levels = poses[: n * m].reshape(n, m, 3).mean(axis=1)
    total = np.concatenate([[0.0], np.cumsum(wheels.turn)])
    ends = np.append(start, end[-1])
    off = levels[:, 2] - np.interp(t, ends, total).mean(axis=1)
    width = _odd(1.0 / (m * period), n)
    padded = np.pad(off, width // 2, mode="edge")
    off = np.convolve(padded, np.ones(width) / width, mode="valid")
    centre = t.mean(axis=1)
    middle = (start + end) / 2
    heading = np.interp(middle, ends, total) + np.interp(middle, centre, off)
    border = (centre[1:] + centre[:-1]) / 2
    phi = np.interp(border, ends, total) + np.interp(border, centre, off)
    step = np.diff(levels, axis=0)
    along = step[:, 0] * np.cos(phi) + step[:, 1] * np.sin(phi)
    valid = (np.diff(centre) < max(LARGEST_GAP, 2.5 * m * period)) & (
        np.ptp(t, axis=1) < LARGEST_GAP + m * period
    )[1:]
    valid &= (np.ptp(t, axis=1) < LARGEST_GAP + m * period)[:-1]
    D, index, ok = _layout(t, start, end)
    valid &= ok
    D_along = _sparse(D * np.cos(heading[index] - phi[:, None]), index, len(start))
    D_yaw = _sparse(D, index, len(start))
    slopes = _slopes(t, wheels, clock, heading, phi)
    between = (levels[1:] + levels[:-1]) / 2
    steps = wheels.way[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    trail = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    told = np.stack([np.interp(centre, ends, column) for column in trail.T], axis=1)
    width = _odd(2.0 / (m * period), n)
    apart = np.pad(levels[:, :2] - told, ((width // 2, width // 2), (0, 0)), mode="edge")
    apart = np.stack(
        [np.convolve(column, np.ones(width) / width, mode="valid") for column in apart.T], axis=1
    )
    smooth = told + apart
    spots = np.stack([np.interp(middle, centre, column) for column in (*smooth.T, levels[:, 2])], axis=1)
    spots[:, 2] = heading
    return Rows(
        clock=clock,
        stamps=border,
        poses=np.column_stack([between[:, :2], phi]),
        levels=np.column_stack([smooth, levels[:, 2]]),
        is_valid=valid,
        along=along,
        yaw=step[:, 2],
        D_along=D_along,
        D_yaw=D_yaw,
        slopes=slopes,
        spots=spots,
    )


def _odd(width: float, n: int) -> int:
    return max(3, min(round(width), n)) // 2 * 2 + 1


def _layout(t: Floats, start: Floats, end: Floats) -> tuple[Floats, np.ndarray, Bools]:
    """Return how much of each increment lies between two averages: weights (n, o), indices (n, o), validity (n,)."""
    first = np.clip(np.searchsorted(end, t[:-1, 0], side="right"), 0, len(end) - 1)
    last = np.clip(np.searchsorted(start, t[1:, -1], side="left"), 0, len(end) - 1)
    reach = int(np.quantile(last - first, 0.995)) + 2
    index = np.minimum(first[:, None] + np.arange(reach), len(end) - 1)
    twice = first[:, None] + np.arange(reach) > len(end) - 1
    a, span = start[index][..., None], (end - start)[index][..., None]
    weights = np.clip((t[1:, None, :] - a) / span, 0, 1).mean(axis=2)
    weights -= np.clip((t[:-1, None, :] - a) / span, 0, 1).mean(axis=2)
    weights[twice] = 0.0
    ok = (last - first < reach) & ((end - start)[index].max(axis=1) < LARGEST_GAP)
    return weights, index, ok


def _sparse(weights: Floats, index: np.ndarray, n: int) -> sparse.csr_array:
    rows = np.repeat(np.arange(len(weights)), weights.shape[1])
    return sparse.csr_array(
        sparse.coo_array((weights.ravel(), (rows, index.ravel())), shape=(len(weights), n))
    )


def _slopes(t: Floats, wheels: Increments, clock: float, heading: Floats, phi: Floats) -> Floats:
    """Return the derivative by the clock of what the wheels say (n, 2), from smoothed increments."""
    kernel = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9
    way, turn = (
        np.convolve(np.pad(x, 2, mode="edge"), kernel, mode="valid") for x in (wheels.way, wheels.turn)
    )
    out = []
    for late in (-0.01, 0.01):
        D, index, _ = _layout(t, wheels.start - clock - late, wheels.end - clock - late)
        out.append(
            np.stack(
                [
                    ((D * np.cos(heading[index] - phi[:, None])) * way[index]).sum(axis=1),
                    (D * turn[index]).sum(axis=1),
                ],
                axis=1,
            )
        )
    return np.asarray((out[1] - out[0]) / 0.02)


def stack(rows: Rows, wheels: Increments, base: float) -> tuple[Floats, Floats]:
    """Return columns (2 n, 5) and rows (2 n,): along first, then yaw.

    Columns: both wheels, difference, base, clock, marker beside the axle.
    """
    way, turn = rows.D_along @ wheels.way, rows.D_yaw @ wheels.turn
    straight = rows.D_yaw @ wheels.way
    nil = np.zeros(rows.n)
    A = np.concatenate(
        [
            np.stack([way, nil, nil, rows.slopes[:, 0], -turn], axis=1),
            np.stack([turn, -straight / base, turn, rows.slopes[:, 1], nil], axis=1),
        ]
    )
    y = np.concatenate([rows.along - way, rows.yaw - turn])
    ok = np.concatenate([rows.is_valid, rows.is_valid])
    return np.where(ok[:, None], A, 0.0), np.where(ok, y, 0.0)
