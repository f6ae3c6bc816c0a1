"""Odometry channel: odometry against reference poses, for wheel effects, slippery patches and the clock offset.

Reference poses are averaged over a tenth of a second. Between two averages, the motion of the body along its
heading and in yaw is compared with the wheels. Its motion across the heading is compared with wheels that
roll without slipping.

Odometry may count backwards: its distance, its turns, both, or one of its wheels. With the wheels l and r, distance (l + r) / 2 and turn (r - l) / b, a left wheel that counts backwards exchanges distance
and turn; a right one does it with the opposite sign.
"""

from __future__ import annotations

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.motion.increments import ChannelSkippedError
from sensorgraph.diagnosis.motion.wheels.model import WheelModel
from sensorgraph.diagnosis.motion.wheels.report import odometry_result
from sensorgraph.diagnosis.motion.wheels.rows import (
    AVERAGING_TIME,
    MIN_ROWS,
    WINDOW,
    MotionSignals,
    OdometryRows,
    motion_signals,
    rows_at,
)
from sensorgraph.diagnosis.motion.wheels.selection import select
from sensorgraph.diagnosis.motion.wheels.sideways import sideways_structure
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.localization.locate import is_located
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

MIN_CLOCK_SHIFT = 3e-4
"""[s] minimum change of the clock offset for which the rows are computed again."""
MAX_CLOCK = 0.8
"""[s] maximum clock offset of the search."""
CLOCK_STEP = 0.025
"""[s] step of the search."""
MIN_CLOCK_OVERLAP = 5.0
"""[s] minimum overlap for the search; otherwise it starts at a clock offset of 0."""
MIN_WINDOWS = 10
"""Minimum number of windows for a statement."""
CERTAIN = 0.8
"""Correlation above which two motions are the same, and below minus which they are opposite."""
NONE = 0.5
"""Correlation below which two motions are different."""


def diagnose_odometry(
    run: Run, robot: Robot, *, seed: int = 0, is_reference_straight: bool = False
) -> ChannelResult:
    """Name the effects that make odometry and reference poses differ.

    A run without odometry or separate reference poses is skipped, with the reason in `ChannelResult.skipped`.

    Parameters
    ----------
    is_reference_straight : The scans have shown that the reference poses are not distorted over the place.
    """
    try:
        signals = motion_signals(run)
        if backwards := counts_backwards(signals):
            words = f"{backwards}; correct the sign, then diagnose again"
            return ChannelResult(channel="odometry", unknown=Unknown(statement=words))
        rows = aligned_rows(signals)
    except ChannelSkippedError as exc:
        return ChannelResult(channel="odometry", skipped=str(exc))
    rng = np.random.default_rng(seed)
    model = WheelModel(rows, signals.wheels, robot)
    late = model.clock_left()
    moved = rows_at(signals, rows.clock + late) if abs(late) > MIN_CLOCK_SHIFT else None
    if moved is not None:
        model = WheelModel(moved, signals.wheels, robot)
    terms = select(model, rng, is_reference_straight=is_reference_straight)
    own_heading = run.pose_frame == "base_link" and not is_located(run)
    aside = sideways_structure(model, heading_is_of_base=own_heading)
    return odometry_result(model, terms, aside, signals.notes, rng)


def odometry_clock_offset(run: Run, robot: Robot) -> tuple[float, float] | None:
    """Return the age of the odometry at its stamps, and its standard error [s]; None if it is not observable."""
    try:
        signals = motion_signals(run)
        rows = aligned_rows(signals)
    except ChannelSkippedError:
        return None
    model = WheelModel(rows, signals.wheels, robot)
    fit = model.regression.solve(model.prior(model.layout.terms))
    covariance = model.regression.clustered_covariance(fit, model.clusters)
    clock = model.layout.clock
    return rows.clock + float(fit.theta[clock]), float(np.sqrt(covariance[clock, clock]))


def aligned_rows(signals: MotionSignals) -> OdometryRows:
    """Return the rows at the clock offset of the coarse search; the regression has a column for what is left of it.

    Raises
    ------
    ChannelSkippedError
        Poses and odometry hardly overlap.
    """
    rows = rows_at(signals, coarse_offset(signals))
    n = 0 if rows is None else int(rows.valid.sum())
    if rows is None or n < MIN_ROWS:
        raise ChannelSkippedError(
            f"poses and odometry overlap in {n} tenths of a second, expected at least {MIN_ROWS}"
        )
    return rows


def coarse_offset(signals: MotionSignals) -> float:
    """Return the clock offset [s] at which turn rate and speed of wheels and reference agree best.

        maximise over tau  - sum over t of (reference(t) - wheels(t + tau))² / power of the reference

    The sum includes turn and distance. Aligning sensors by their turn rates is the method of Olson (2010), "A passive
    solution to the sensor synchronization problem".
    """
    stamps, poses, wheels = signals.stamps, signals.poses, signals.wheels
    reach, step, half = MAX_CLOCK, CLOCK_STEP, AVERAGING_TIME
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


def counts_backwards(signals: MotionSignals) -> str:
    """Return what of the odometry counts backwards, relative to the reference poses; empty if nothing does."""
    wheels, poses = signals.wheels, signals.poses
    first, last = max(wheels.start[0], signals.stamps[0]), min(wheels.end[-1], signals.stamps[-1])
    edges = np.arange(first, last, WINDOW)
    if len(edges) <= MIN_WINDOWS:
        return ""
    ends = np.append(wheels.start, wheels.end[-1])
    counted = [
        np.diff(np.interp(edges, ends, np.append(0.0, np.cumsum(part))))
        for part in (wheels.distance, wheels.turn)
    ]
    heading = np.unwrap(poses[:, 2])
    steps, middle = np.diff(poses[:, :2], axis=0), (heading[1:] + heading[:-1]) / 2
    ahead = np.append(0.0, np.cumsum(steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle)))
    seen = [np.diff(np.interp(edges, signals.stamps, part)) for part in (ahead, heading)]
    (way, cross), (other, turn) = ([_correlation(a, b) for b in counted] for a in seen)
    parts = [name for name, r in (("distance", way), ("turns", turn)) if r < -CERTAIN]
    if parts:
        found = " and ".join(parts)
        askew = ", or the reference poses look backwards" if parts == ["distance"] else ""
        swapped = " (left and right wheel exchanged)" if parts == ["turns"] else ""
        return f"the odometry counts its {found} backwards{swapped}{askew}"
    if max(abs(way), abs(turn)) < NONE and min(abs(cross), abs(other)) > CERTAIN and cross * other > 0:
        return f"the {'left' if cross > 0 else 'right'} wheel of the odometry counts backwards"
    return ""


def _correlation(a: Floats, b: Floats) -> float:
    """Return the correlation of two signals about zero; 0 if one of them does not move."""
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
