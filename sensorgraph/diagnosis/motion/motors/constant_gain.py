"""Constant gain from commands to motion beyond the tolerances, which no effect of the library explains.

The error of the odometry is a bounded tolerance of the model (`GAIN_SIGMA`, `TURN_SIGMA`). A gain
beyond these bounds belongs to the base, unless wheel errors that the odometry channel has named cause it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import GAINS, Column, DriveModel
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection, select
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, StructureFamily
from sensorgraph.effects import Amendment
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.types import Floats


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
