"""Clock offset between odometry and reference poses: a coarse search, then Gauss-Newton.

    maximise over tau  - sum over t of (reference(t) - wheels(t + tau))² / power of the reference

The sum includes turn and distance. Aligning sensors by their turn rates is the method of Olson (2010), "A
passive solution to the sensor synchronization problem".
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.increments import ChannelSkippedError
from sensorgraph.diagnosis.motion.wheels.rows import (
    MIN_ROWS,
    MotionSignals,
    OdometryRows,
    WheelColumns,
    rows_at,
    wheel_rows,
)
from sensorgraph.types import Floats

MAX_STEPS = 3
"""Maximum number of Gauss-Newton steps."""
MAX_CLOCK = 0.8
"""[s] maximum clock offset of the search."""
CLOCK_STEP = 0.025
"""[s] step of the search."""
CLOCK_HALF_WINDOW = 0.1
"""[s] half the window over which rates are compared."""
MIN_CLOCK_OVERLAP = 5.0
"""[s] minimum overlap for the search; otherwise it starts at a clock offset of 0."""
CLOCK_RESOLUTION = 2e-4
"""[s] step of the clock offset, below which it has converged."""


def aligned_rows(signals: MotionSignals) -> OdometryRows:
    """Return the rows at the clock offset that fits best.

    Raises
    ------
    ChannelSkippedError
        Poses and odometry hardly overlap.
    """
    rows = _enough_rows(signals, _coarse_offset(signals))
    for _ in range(MAX_STEPS):
        step = _offset_left(rows, signals)
        if abs(step) < CLOCK_RESOLUTION:
            break
        rows = _enough_rows(signals, rows.clock + step)
    return rows


def _enough_rows(signals: MotionSignals, clock: float) -> OdometryRows:
    rows = rows_at(signals, clock)
    n = 0 if rows is None else int(rows.valid.sum())
    if rows is None or n < MIN_ROWS:
        raise ChannelSkippedError(
            f"poses and odometry overlap in {n} tenths of a second, expected at least {MIN_ROWS}"
        )
    return rows


def _offset_left(rows: OdometryRows, signals: MotionSignals) -> float:
    """Return the next step of the clock offset [s], with all columns free and the rows scaled by their spread."""
    columns = WheelColumns.of_library()
    A = columns.evaluate(rows, signals.wheels, 1.0)  # the wheelbase only scales a free column
    y = wheel_rows(rows, signals.wheels)
    some = np.tile(rows.valid, 2)
    residual = y
    theta: Floats = np.zeros(0)
    for _ in range(2):
        spreads = [np.std(part[rows.valid]) + 1e-9 for part in (residual[: rows.n], residual[rows.n :])]
        scale = np.repeat(spreads, rows.n)
        theta = np.asarray(np.linalg.lstsq((A / scale[:, None])[some], (y / scale)[some], rcond=1e-9)[0])
        residual = np.asarray(y - A @ theta)
    return float(theta[columns.clock])


def _coarse_offset(signals: MotionSignals) -> float:
    """Return the clock offset [s] at which turn rate and speed of wheels and reference agree best."""
    stamps, poses, wheels = signals.stamps, signals.poses, signals.wheels
    reach, step, half = MAX_CLOCK, CLOCK_STEP, CLOCK_HALF_WINDOW
    first, last = max(stamps[0], wheels.start[0]) + reach, min(stamps[-1], wheels.end[-1]) - reach
    if last - first < MIN_CLOCK_OVERLAP:
        return 0.0
    grid = np.arange(first - reach, last + reach, step)
    before, after = (
        np.stack([np.interp(grid + d, stamps, column) for column in poses.T]) for d in (-half, half)
    )
    heading = np.interp(grid, stamps, poses[:, 2])
    dx, dy, turn = after - before
    distance = dx * np.cos(heading) + dy * np.sin(heading)
    ends = np.append(wheels.start, wheels.end[-1])
    margin = round(reach / step)
    fit = np.zeros(round(2 * reach / step) + 1)
    for of_reference, of_wheels in ((turn, wheels.turn), (distance, wheels.distance)):
        total = np.concatenate([[0.0], np.cumsum(of_wheels)])
        move = np.interp(grid + half, ends, total) - np.interp(grid - half, ends, total)
        fit += _fit_by_shift(of_reference, move, margin, len(fit))
    k = int(np.argmax(fit))
    if not 0 < k < len(fit) - 1:
        return 0.0
    a, b, c = fit[k - 1 : k + 2]
    bend = a - 2 * b + c
    return float((k - margin + (0.5 * (a - c) / bend if bend < 0 else 0.0)) * step)


def _fit_by_shift(reference: Floats, move: Floats, margin: int, n_shifts: int) -> Floats:
    """Return minus the squared difference, divided by the power of the reference, for each shift (n_shifts,).

    It is 0 if nothing moves.
    """
    inner = reference[margin : len(reference) - margin]
    power = np.sum((inner - inner.mean()) ** 2)
    if power < 1e-12:
        return np.zeros(n_shifts)
    # the odometry at t + tau corresponds to the reference at t
    return np.array([-np.sum((inner - move[k : k + len(inner)]) ** 2) / power for k in range(n_shifts)])
