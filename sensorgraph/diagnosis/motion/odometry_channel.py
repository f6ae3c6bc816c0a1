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
from sensorgraph.diagnosis.motion.wheels.clock import aligned_rows
from sensorgraph.diagnosis.motion.wheels.model import WheelModel
from sensorgraph.diagnosis.motion.wheels.report import odometry_result
from sensorgraph.diagnosis.motion.wheels.rows import MotionSignals, motion_signals, rows_at
from sensorgraph.diagnosis.motion.wheels.selection import select
from sensorgraph.diagnosis.motion.wheels.sideways import sideways_structure
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.localization.locate import is_located
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

MIN_CLOCK_SHIFT = 3e-4
"""[s] minimum change of the clock offset for which the rows are computed again."""
WINDOW = 1.0
"""[s] Duration of the motions that are compared; long against the offset of a usual clock."""
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
