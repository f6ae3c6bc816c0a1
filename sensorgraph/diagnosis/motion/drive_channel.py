"""Drive channel: commands against odometry, for lag, dead time and saturation of the motors.

Each set of effects is a small simulation of the motors (dead time, first-order lag, limited acceleration). It
is fitted to the motion that the wheels report.

A constant gain from commands to motion beyond the tolerances is structure that no effect explains. The error of the odometry is a bounded tolerance of the model (`GAIN_SIGMA`, `TURN_SIGMA`). A gain
beyond these bounds belongs to the base, unless wheel errors that the odometry channel has named cause it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.motion.increments import ChannelSkippedError, wheel_increments
from sensorgraph.diagnosis.motion.motors.model import GAINS, Column, DriveModel
from sensorgraph.diagnosis.motion.motors.report import drive_result
from sensorgraph.diagnosis.motion.motors.rows import commands_of, drive_rows
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection, select, with_structure
from sensorgraph.diagnosis.motion.odometry_channel import odometry_clock_offset
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, StructureFamily
from sensorgraph.diagnosis.result import ChannelResult, MotionDifference
from sensorgraph.effects import Amendment
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot


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
    model, selected = _explain(DriveModel(commands, rows, robot, wheels), named_wheels)
    if selected.terms or selected.structure is not None:
        ramped, other = _explain(model.with_ramped_set_point(), named_wheels)
        if other.log_likelihood(ramped) > selected.log_likelihood(model) + EVIDENCE.threshold:
            model, selected = ramped, other
    return drive_result(model, selected)


def _explain(model: DriveModel, named_wheels: Sequence[Amendment]) -> tuple[DriveModel, MotorSelection]:
    """Select effects and structure under the acceleration limits of the model, with a separate noise fit.

    Returns the model, with its gains bounded or free, and the selection.
    """
    model, selected = select_under_any_gain(model)
    return model, with_constant_gain(model, with_structure(model, selected), named_wheels)


def select_under_any_gain(model: DriveModel) -> tuple[DriveModel, MotorSelection]:
    """Select effects with bounded gains; with free gains, if one is at its bound and free gains are more likely.

    At a bound, effects would otherwise explain the remaining gain.
    """
    within = select(model)
    if within.fit.solution.covariance[GAINS, GAINS].all():
        return model, within
    free = model.with_any_gain()
    found = select(free)
    return (free, found) if _lead(free, found, within) > EVIDENCE.threshold else (model, within)


def with_constant_gain(
    model: DriveModel, selected: MotorSelection, wheels: Iterable[Amendment]
) -> MotorSelection:
    """Add a constant gain that is certainly beyond tolerance, both as measured and without the named wheel errors.

    Parameters
    ----------
    wheels : Effects that the odometry channel has named.
    """
    if not model.has_any_gain or selected.structure is not None:
        return selected
    fit, gains = selected.fit, _gains(selected)
    covariance = fit.regression.clustered_covariance(fit.solution, model.clusters)
    doubt = 2 * np.sqrt(np.diag(covariance)[list(GAINS)])
    of_base = _without_wheels(gains, wheels, model.robot.wheels.base)
    beyond = np.minimum(np.abs(gains), np.abs(of_base)) - doubt > _tolerances(model)
    if not beyond.any():
        return selected
    columns = [column for column, is_beyond in zip(GAINS, beyond, strict=True) if is_beyond]
    structure = AcceptedStructure(
        family=StructureFamily(
            kind="constant gain",
            columns=fit.columns[:, columns],
            statement=f"a constant gain: the base {_said(gains, columns)}",
        ),
        evidence=_lead(model, selected, selected),
        threshold=EVIDENCE.threshold,
        size=model.error_without(fit, fit.columns[:, columns] @ gains[beyond]),
    )
    return replace(selected, structure=structure)


def _said(gains: Floats, columns: Iterable[Column]) -> str:
    way, turn, aside = gains
    words = {
        Column.GAIN_V: f"drives {1 + way:.2f} times the commanded speed",
        Column.GAIN_OMEGA: f"turns {1 + turn:.2f} times the commanded rate",
        Column.TURN_PER_DISTANCE: f"turns {np.degrees(aside):+.1f}° per metre driven, in addition to the command",
    }
    return " and ".join(words[column] for column in columns)


def _gains(selected: MotorSelection) -> Floats:
    """Return the gains (3,) of a fit: of distance and turn, less 1, and the turn per distance [rad/m]."""
    return np.asarray(selected.fit.solution.theta[list(GAINS)])


def _tolerances(model: DriveModel) -> Floats:
    """Return the maximum gains (3,) within the tolerances of a careful setup."""
    bounded = model.with_any_gain(False)
    return np.asarray(bounded.prior([], bounded.nominal).reach[list(GAINS)])


def _lead(free: DriveModel, found: MotorSelection, within: MotorSelection) -> float:
    """Return the evidence [nats] for free gains, less the complexity penalty, under the same noise."""
    held = free.with_any_gain(False).fit(within.terms, within.fit.motors)
    price = EVIDENCE.price * (len(GAINS) + len(found.terms) - len(within.terms))
    return found.fit.log_posterior - held.log_posterior - price


def _without_wheels(gains: Floats, wheels: Iterable[Amendment], base: float) -> Floats:
    """Return the gains (3,) that remain after the named wheel errors.

    Parameters
    ----------
    base : [m] Wheelbase.
    """
    named = dict.fromkeys((WHEEL_RADIUS, WHEEL_BASE, WHEEL_RADIUS_DIFF), 0.0)
    named |= {a.effect: a["s"] for a in wheels if a.effect in named}
    way, turn, aside = gains
    radius, wider = 1 + named[WHEEL_RADIUS], 1 + named[WHEEL_BASE]
    return np.array(
        [(1 + way) / radius - 1, (1 + turn) * wider / radius - 1, aside - named[WHEEL_RADIUS_DIFF] / base]
    )
