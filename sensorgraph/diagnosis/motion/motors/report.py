"""Report of the drive channel: what the accepted effects of the motors are, and how large the gap is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import CONTROL_STEP, Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection, due_to_loop
from sensorgraph.diagnosis.motion.regression import Term, held_out_residual
from sensorgraph.diagnosis.motion.report import (
    AcceptedEffect,
    TriedEffect,
    channel_result,
    exceeds_sizes,
    fit_quality,
)
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import TestedStructure
from sensorgraph.diagnosis.motion.whitening import both_kinds
from sensorgraph.diagnosis.result import ChannelResult, FitQuality, Gap, Rival
from sensorgraph.effects import Amendment, Effect
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.types import Floats

MIN_SATURATION = 0.02
"""[m/s] minimum difference between the largest command and the motors, for a saturation to be material."""
FULL_SPEED_SHARE = 0.9
"""Share of the robot's limit that commands must reach for a saturation to be observable."""


def drive_result(model: DriveModel, selected: MotorSelection) -> ChannelResult:
    """Return the result of the drive channel for the selected effects."""
    fit, rows, structure = selected.fit, model.rows, selected.structure
    tested = [] if model.tested is None else [model.tested]
    if structure is not None and not any(structure.family.kind in one.families for one in tested):
        tested.append(TestedStructure(families={}, threshold=structure.threshold, best=structure))
    return channel_result(
        "drive",
        accepted=_accepted(model, selected),
        tried=_tried(model, selected),
        structures=[] if structure is None else [structure],
        tested=tested,
        gap=_gap(model, selected),
        not_observable=_unseen_saturation(model, selected),
        notes={
            "odometry_from": rows.source,
            "clock_offset_s": rows.late,
            "clock_from_reference": rows.has_reference,
            "gain_v": 1 + float(fit.solution.theta[Column.GAIN_V]),
            "gain_omega": 1 + float(fit.solution.theta[Column.GAIN_OMEGA]),
        },
    )


def _accepted(model: DriveModel, selected: MotorSelection) -> list[AcceptedEffect]:
    """Return the effects of the model."""
    terms, fit = selected.terms, selected.fit
    stderr = np.sqrt(np.diag(fit.regression.clustered_covariance(fit.solution, model.clusters)))
    out = []
    for term in terms:
        rest = model.fit([other for other in terms if other != term], fit.motors)
        evidence = fit.log_posterior - rest.log_posterior - EVIDENCE.price
        error = float(stderr[term.column])
        a = replace(_sized(model, term, fit, error), evidence=evidence)
        is_unclear = term.effect is DEAD_TIME and not model.rows.has_reference
        out.append(
            AcceptedEffect(
                sized=a,
                price=EVIDENCE.price,
                alternatives=_alternatives(model, rest.log_posterior, term, selected),
                error=model.error_without(fit, model.rows.masked(fit.simulated - rest.simulated)),
                is_material=_is_material(model, a),
                due_to_loop=due_to_loop(model.robot, a),
                fit_error=float(np.hypot(error, CONTROL_STEP * (term.effect is DEAD_TIME))),
                late_clock=_late_clock(evidence) if is_unclear else None,
            )
        )
    return out


def _tried(model: DriveModel, selected: MotorSelection) -> Iterator[TriedEffect]:
    """Yield the effects that are not in the model."""
    terms, here = selected.terms, selected.fit
    for term in model.terms:
        if term not in terms:
            fit = model.fit([*terms, term], here.motors)
            evidence = fit.log_posterior - here.log_posterior - EVIDENCE.price
            error = float(np.sqrt(max(float(fit.solution.covariance[term.column, term.column]), 0.0)))
            solution = here.regression.solve(model.prior([*terms, term], here.motors))
            yield TriedEffect(
                amendment=replace(_sized(model, term, fit, error), evidence=evidence),
                price=EVIDENCE.price,
                variance=float(solution.covariance[term.column, term.column]),
            )


def _sized(model: DriveModel, term: Term, fit: DriveFit, error: float) -> Amendment:
    """Return an effect with its size and standard error."""
    key = term.effect.parameters[0].name
    value = model.size_of(term, fit)
    return replace(
        term.effect(**{key: value}), stderr={key: float(np.hypot(error, model.blur_of(term, fit)))}
    )


def _alternatives(
    model: DriveModel, without: float, term: Term, selected: MotorSelection
) -> dict[Effect, float]:
    """Return the evidence of each effect that could replace an effect [nats].

    Parameters
    ----------
    without : [nats] Of the model without the effect.
    """
    rest = [other for other in selected.terms if other != term]
    return {
        other.effect: model.fit([*rest, other], selected.fit.motors).log_posterior - without - EVIDENCE.price
        for other in model.terms
        if other not in selected.terms
    }


def _late_clock(evidence: float) -> Rival:
    """Return the rival of a dead time in a run without reference poses."""
    return Rival(
        name=POSE_CLOCK_OFFSET.name,
        instead_of=DEAD_TIME.name,
        evidence_nats=evidence,
        separates="reference poses, which this run lacks; a late odometry clock looks the same",
    )


def _is_material(model: DriveModel, a: Amendment) -> bool:
    """Return whether an effect exceeds its materiality."""
    if a.effect is SPEED_SATURATION:
        return bool(model.top_speed - a["v_max"] > MIN_SATURATION)
    return exceeds_sizes(a)


def _gap(model: DriveModel, selected: MotorSelection) -> Gap:
    """Return the gap, by fits to every other block of 5 s and measurements on the rest, and vice versa."""
    rows, fit = model.rows, selected.fit
    prior = model.prior(selected.terms, fit.motors)
    after = held_out_residual(fit.regression, prior, fit.columns, rows.y - fit.simulated, rows.start)
    n, k = 2 * rows.n_valid, fit.columns.shape[1]
    floor = model.residual(fit) * np.sqrt(n / max(n - k, 1))
    return Gap(
        before=_quality(model, rows.y - model.simulation.rates(model.nominal)),
        after=_quality(model, after),
        noise_floor=_quality(model, floor),
        n_rays=n,
    )


def _quality(model: DriveModel, residual: Floats) -> FitQuality:
    """Return the quality of a residual (2 n,)."""
    use = model.rows.masked(residual)
    rates = [part[model.rows.valid] for part in both_kinds(use, model.rows.n)]
    return fit_quality(model.whitener, use, rates, model.robot.wheels.base)


def _unseen_saturation(model: DriveModel, selected: MotorSelection) -> dict[str, str]:
    """Return the reason why a saturation would not show, if no command is near the limit of the robot."""
    limit = model.robot.limits.v
    if model.top_speed >= FULL_SPEED_SHARE * limit:
        return {}
    if any(term.effect is SPEED_SATURATION for term in selected.terms):
        return {}
    top = f"no command exceeds {model.top_speed:.2f} m/s (limit: {limit:.2f} m/s)"
    return {SPEED_SATURATION.name: f"{top}; a saturation above that is not observable"}
