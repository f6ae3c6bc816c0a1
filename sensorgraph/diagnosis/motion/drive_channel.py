"""Drive channel: commands against odometry, for lag, dead time and saturation of the motors.

Each set of effects is a small simulation of the motors (dead time, first-order lag, limited acceleration). It
is fitted to the motion that the wheels report.

The error of the odometry is a bounded tolerance of the model (`GAIN_SIGMA`, `TURN_SIGMA`). A constant gain from
commands to motion beyond these bounds belongs to the base: it is a hypothesis without a name, which frees the bound.
Ticks of the control loop of the base and jitter of the transport are no effect. Every model that is tested for structure
contains columns for these, in units of their prior standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.engine import selection as engine
from sensorgraph.diagnosis.motion.increments import (
    ChannelSkippedError,
    commands_of,
    drive_rows,
    wheel_increments,
)
from sensorgraph.diagnosis.motion.motor_model import Column, DriveModel
from sensorgraph.diagnosis.motion.motor_simulation import AccelerationLimit
from sensorgraph.diagnosis.motion.motor_structure import drive_families
from sensorgraph.diagnosis.motion.odometry_channel import odometry_clock_offset
from sensorgraph.diagnosis.motion.regression import Fit, Term
from sensorgraph.diagnosis.motion.report import channel_result, exceeds_sizes
from sensorgraph.diagnosis.motion.selection import MotionChannel, admitted_structure
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, StructureTest, pieces
from sensorgraph.diagnosis.motion.whitening import Whitener
from sensorgraph.diagnosis.result import ChannelResult, MotionDifference, Rival
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

TIMING = (ACTUATOR_LAG, DEAD_TIME)
"""Effects that delay the response of the motors to a command."""
OTHER_MOTORS = ("answer", "ramp")
"""Kinds of the families of motors whose response is not a single lag, although a lag absorbs most of it."""
FULL_SPEED_SHARE = 0.9
"""Share of the robot's limit that commands must reach for a saturation to be observable."""


def diagnose_drive(
    run: Run,
    robot: Robot,
    *,
    use_clock: bool = True,
    wheels: MotionDifference | None = None,
    named_wheels: Sequence[Amendment] = (),
) -> ChannelResult:
    """Name the effects that make commands and odometry differ.

    A run without odometry or commands is skipped, with the reason in `ChannelResult.skipped`.

    Parameters
    ----------
    use_clock : Use the reference poses to correct the clock offset of the odometry.
    wheels : Motion that the odometry channel has explained by slip or structure.
    named_wheels : Effects that the odometry channel has named.
    """
    try:
        increments = wheel_increments(run)
        commands = commands_of(run)
        clock = odometry_clock_offset(run, robot) if use_clock else None
        rows = drive_rows(increments, commands, robot, clock)
    except ChannelSkippedError as exc:
        return ChannelResult(channel="drive", skipped=str(exc))
    model = DriveModel(commands, rows, robot, wheels, named_wheels)
    fit_noise_with_all_effects(model)
    channel = MotionChannel(model)
    terms = engine.select(channel, threshold=SCAN.selection.threshold, most=len(model.terms))
    fit = add_structure(model, terms, channel.fit)
    return drive_result(model, terms, fit)


def fit_noise_with_all_effects(model: DriveModel) -> None:
    """Choose where the acceleration is limited, and fit the noise with all effects free.

    A base that ramps the set point must explain the run better by as much as an effect does.
    """
    effects = [term for term in model.terms if term.effect is not None]
    found, stated = list[tuple[float, AccelerationLimit, Whitener]](), model.whitener
    for limit in AccelerationLimit:
        model.simulation.limit, model.whitener = limit, stated
        full = model.fit(effects)
        for _ in range(2):
            model.fit_noise(full.residual)
            full = model.fit(effects, full)
        is_ramped = limit is AccelerationLimit.SET_POINT
        price = SCAN.selection.threshold + model.rows.price(1) if is_ramped else 0.0
        found.append((full.log_posterior + model.whitener.log_likelihood - price, limit, model.whitener))
    _, model.simulation.limit, model.whitener = max(found, key=lambda one: one[0])


def add_structure(model: DriveModel, terms: list[Term], here: Fit) -> Fit:
    """Let structure that no effect explains enter the model, beside the effects or in place of lag and dead time.

    A shorter lag and a longer dead time would absorb part of the response of a base that rings. Returns the fit.
    """
    fit, left, stands_for_material = here, [*terms], False
    test, own, families = left_by(model, terms, here)
    family, gain = test.best(own, families)
    others = [term for term in terms if term.effect not in TIMING]
    if gain >= SCAN.selection.threshold and family.kind in OTHER_MOTORS and len(others) < len(terms):
        plain = model.fit(others)
        alone, plain_own, families = left_by(model, others, plain)
        other, more = alone.best(plain_own, [one for one in families if one.kind in OTHER_MOTORS])
        if alone.evidence(plain_own, other) > test.evidence(own) + SCAN.selection.threshold:
            fit, left, test, own, family, gain = plain, others, alone, plain_own, other, more
            gone = [model.sized(term, here, 0.0) for term in terms if term not in others]
            stands_for_material = any(exceeds_sizes(a) for a in gone)
    found = admitted_structure(
        model,
        test,
        own,
        (family, gain),
        SCAN.selection.threshold,
        lambda missing, _: model.error_without(fit, missing),
        stands_for_material=stands_for_material,
    )
    if found is None:
        return here
    model.structure, terms[:] = found, left
    full = model.fit(terms, fit)
    model.fit_noise(full.residual)
    channel = MotionChannel(model, terms, full)
    engine.remove_superfluous(channel, terms, threshold=SCAN.selection.threshold)
    return channel.fit


def left_by(
    model: DriveModel, terms: Sequence[Term], fit: Fit
) -> tuple[StructureTest, Floats, list[StructureFamily]]:
    """Return the test of what a fit leaves, the columns (2 n, k) of the model, and the families."""
    has_limit = any(term.effect is SPEED_SATURATION for term in terms)
    own = fit.columns[:, [k for k in range(model.n_own) if has_limit or k != Column.V_MAX]]
    left = model.rows.masked(fit.y - fit.simulated)
    test = StructureTest(model.rows.valid, left, model.fitted_noise, drive_nuisances(model, fit))
    return test, own, drive_families(model, fit)


def drive_nuisances(model: DriveModel, fit: Fit) -> Floats:
    """Return the columns (2 n, m) of normal differences between commands and odometry.

        delay_sigma² = control_period² / 12 + transport_jitter²

    The wait for a tick of the base is uniform over one period.
    """
    rows, tolerances = model.rows, model.robot.tolerances
    sigma = float(np.hypot(tolerances.control_period / np.sqrt(12), tolerances.transport_jitter))
    parts = pieces(rows.end - rows.end[0], float(np.ptp(rows.end)))
    by_delay = fit.columns[:, Column.DELAY] * sigma
    return rows.masked(np.stack([by_delay * np.tile(part, 2) for part in parts], axis=1))


# report --------------------------------------------------------------------------------------------------------------


def drive_result(model: DriveModel, terms: Sequence[Term], fit: Fit) -> ChannelResult:
    """Return the result of the drive channel for the selected hypotheses."""
    rows, limit = model.rows, model.robot.limits.v
    unseen = {}
    if model.top_speed < FULL_SPEED_SHARE * limit and all(
        term.effect is not SPEED_SATURATION for term in terms
    ):
        top = f"no command exceeds {model.top_speed:.2f} m/s (limit: {limit:.2f} m/s)"
        unseen[SPEED_SATURATION.name] = f"{top}; a saturation above that is not observable"
    return channel_result(
        model,
        terms,
        fit,
        usual_rival=lambda a: None if rows.has_reference else late_clock(a),
        not_observable=unseen,
        notes={
            "odometry_from": rows.source,
            "clock_offset_s": rows.late,
            "clock_from_reference": rows.has_reference,
            "gain_v": 1 + float(fit.solution.theta[Column.GAIN_V]),
            "gain_omega": 1 + float(fit.solution.theta[Column.GAIN_OMEGA]),
        },
    )


def late_clock(a: Amendment) -> Rival | None:
    """Return the rival of a dead time in a run without reference poses."""
    if a.effect is not DEAD_TIME:
        return None
    return Rival(
        name=POSE_CLOCK_OFFSET.name,
        instead_of=DEAD_TIME.name,
        evidence_nats=a.evidence or 0.0,
        separates="reference poses, which this run lacks; a late odometry clock looks the same",
    )
