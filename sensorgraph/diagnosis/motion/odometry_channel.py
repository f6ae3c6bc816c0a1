"""Odometry channel: odometry against reference poses, for wheel effects, slippery patches and the clock offset.

Reference poses are averaged over a tenth of a second. Between two averages, the motion of the body along its
heading and in yaw is compared with the wheels. Its motion across the heading is compared with wheels that
roll without slipping.
"""

from __future__ import annotations

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.motion.increments import ChannelSkippedError
from sensorgraph.diagnosis.motion.wheels.backwards import counts_backwards
from sensorgraph.diagnosis.motion.wheels.clock import aligned_rows
from sensorgraph.diagnosis.motion.wheels.model import WheelModel
from sensorgraph.diagnosis.motion.wheels.report import odometry_result
from sensorgraph.diagnosis.motion.wheels.rows import rows_at
from sensorgraph.diagnosis.motion.wheels.selection import select
from sensorgraph.diagnosis.motion.wheels.sideways import sideways_structure
from sensorgraph.diagnosis.motion.wheels.signals import motion_signals
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.localization.locate import is_located
from sensorgraph.world.robot import Robot

MIN_CLOCK_SHIFT = 3e-4
"""[s] minimum change of the clock offset for which the rows are computed again."""


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
