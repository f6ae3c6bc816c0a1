"""Report of the drive channel: named effects with sizes, rivals, gap and unobservable effects."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import SURELY, Facts, Verdict
from sensorgraph.diagnosis.hypotheses import accepted_entry, effect_entry
from sensorgraph.diagnosis.motion.considered import (
    structure_entries,
    unknown_structure,
    unseen_effects,
)
from sensorgraph.diagnosis.motion.families import DRIVE_FAMILIES
from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel, MotorTerm
from sensorgraph.diagnosis.motion.motors.nuisances import due_to_loop
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection, evidence_of_each
from sensorgraph.diagnosis.motion.motors.slow_leftover import SLOW
from sensorgraph.diagnosis.motion.regression import held_out_residual
from sensorgraph.diagnosis.motion.rivals import probability, strongest_rival
from sensorgraph.diagnosis.motion.settings import DRIVE, EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import TestedStructure
from sensorgraph.diagnosis.motion.whitening import Whitener, WhiteningFilter, both_kinds
from sensorgraph.diagnosis.result import ChannelResult, FitQuality, Gap, Rival
from sensorgraph.effects import Amendment, Effect
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.types import Floats


def drive_result(model: DriveModel, selected: MotorSelection) -> ChannelResult:
    """Return the result of the drive channel for the selected effects."""
    fit, rows = selected.fit, model.rows
    evidence = evidence_of_each(model, selected.terms, fit)
    covariance = fit.regression.clustered_covariance(fit.solution, model.clusters)
    found, rivals, material, entries = [], [], set(), []
    for term in sorted(selected.terms, key=lambda term: -evidence[term]):
        alternatives = _alternatives(model, term, selected)
        error = float(np.sqrt(covariance[term.column, term.column]))
        amendment = replace(
            _sized(model, term, fit, error),
            probability=probability(evidence[term], alternatives.values()),
            evidence=evidence[term],
        )
        found.append(amendment)
        entry = _entry_of(model, amendment, term, selected)
        entry = _with_materiality(entry, model, amendment, float(np.hypot(error, term.blur)))
        material |= {term.effect} if entry.verdict is Verdict.NAMED else set()
        entries.append(entry)
        rival = strongest_rival(term.effect, alternatives)
        if rival is None and term.effect is DEAD_TIME and not rows.has_reference:
            rival = _late_clock(evidence[term])
        if rival is not None:
            rivals.append(rival)
    structure = selected.structure
    tested = [] if model.tested is None else [model.tested]
    if structure is not None and structure.family.kind not in {k for one in tested for k in one.families}:
        tested.append(TestedStructure(families={}, threshold=structure.threshold, best=structure))
    return ChannelResult(
        channel="drive",
        effects=tuple(a for a in found if a.effect in material),
        within_tolerance=tuple(a for a in found if a.effect not in material),
        unknown=None
        if structure is None
        else unknown_structure("drive", DRIVE_FAMILIES[structure.family.kind][0], structure, rows.n_valid),
        rivals=tuple(rivals),
        gap=_gap(model, selected),
        not_observable=_not_observable(model, selected.terms, fit),
        considered=(
            *entries,
            *(_term_entry(model, term, selected) for term in model.terms if term not in selected.terms),
            *structure_entries("drive", tested),
        ),
        notes={
            "odometry_from": rows.source,
            "clock_offset_s": rows.late,
            "clock_from_reference": rows.has_reference,
            "gain_v": 1 + float(fit.solution.theta[Column.GAIN_V]),
            "gain_omega": 1 + float(fit.solution.theta[Column.GAIN_OMEGA]),
        },
    )


def _entry_of(model: DriveModel, a: Amendment, term: MotorTerm, selected: MotorSelection) -> Entry:
    """Return the ledger's entry of an effect of the model, with the error of a simulation without it."""
    rest = model.fit([other for other in selected.terms if other != term], selected.fit.motors)
    missing = model.rows.masked(selected.fit.simulated - rest.simulated)
    size = model.error_without(selected.fit, missing)
    return accepted_entry(a, EVIDENCE.threshold, EVIDENCE.price, size)


def _term_entry(model: DriveModel, term: MotorTerm, selected: MotorSelection) -> Entry:
    """Return the ledger's entry of an effect that is not in the model, at its most likely size."""
    fit = model.fit([*selected.terms, term], selected.fit.motors)
    evidence = fit.log_posterior - selected.fit.log_posterior - EVIDENCE.price
    error = float(np.sqrt(max(float(fit.solution.covariance[term.column, term.column]), 0.0)))
    facts = Facts(has_name=True, evidence=evidence, threshold=EVIDENCE.threshold)
    return effect_entry(_sized(model, term, fit, error), facts, price=EVIDENCE.price)


def _sized(model: DriveModel, term: MotorTerm, fit: DriveFit, error: float) -> Amendment:
    """Return an effect with its size and standard error."""
    key = term.effect.parameters[0].name
    value = model.size_of(term, fit)
    return replace(
        term.effect(**{key: value}), stderr={key: float(np.hypot(error, model.blur_of(term, fit)))}
    )


def _alternatives(model: DriveModel, term: MotorTerm, selected: MotorSelection) -> dict[Effect, float]:
    """Return the evidence of each effect that could replace an effect [nats]."""
    rest = [other for other in selected.terms if other != term]
    start = selected.fit.motors
    without = model.fit(rest, start).log_posterior
    return {
        other.effect: model.fit([*rest, other], start).log_posterior - without - EVIDENCE.price
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
        return bool(model.top_speed - a["v_max"] > DRIVE.min_saturation)
    return all(abs(a.parameters[key]) >= limit for key, limit in a.effect.sizes.items())


def _with_materiality(entry: Entry, model: DriveModel, a: Amendment, error: float) -> Entry:
    """Return the entry with the probability that the size exceeds what the control loop of the base may cause.

        P = Phi((|size| - loop) / error)

    Parameters
    ----------
    error : [unit of its parameter] Standard error of the fit.
    """
    facts, loop = replace(entry.facts, is_material=_is_material(model, a)), due_to_loop(model.robot, a)
    if not (facts.is_material and loop):
        return replace(entry, facts=facts)
    (size,) = a.parameters.values()
    chance = float(ndtr((abs(size) - loop) / max(error, 1e-12)))
    return replace(
        entry,
        facts=replace(facts, material_probability=chance, required_probability=SURELY),
        remark=f"the control loop of the base may cause {1000 * loop:.0f} ms of it",
    )


# criticism -----------------------------------------------------------------------------------------------------------


def _gap(model: DriveModel, selected: MotorSelection) -> Gap:
    """Return the gap, by fits to every other block of 5 s and measurements on the rest, and vice versa.

    A residual that lasts for seconds does not count as noise.
    """
    rows, fit, structure = model.rows, selected.fit, selected.structure
    prior = model.prior(selected.terms, fit.motors)
    after = held_out_residual(fit.regression, prior, fit.columns, rows.y - fit.simulated, rows.start)
    n, k = 2 * rows.n_valid, fit.columns.shape[1]
    left = model.residual(fit)
    if structure is not None and structure.family.kind == SLOW:
        left = left - structure.family.columns[:, 0]
        model = copy(model)  # white noise, since a filter would remove the smooth residual
        sigmas = [float(np.std(part[rows.valid])) for part in both_kinds(left, rows.n)]
        first, second = (WhiteningFilter.white(DRIVE.filter_order, sigma + 1e-12) for sigma in sigmas)
        model.whitener = Whitener.plain((first, second), rows.valid)
    floor = left * np.sqrt(n / max(n - k, 1))
    return Gap(
        before=_quality(model, rows.y - model.simulation.rates(model.nominal)),
        after=_quality(model, after),
        noise_floor=_quality(model, floor),
        n_rays=n,
    )


def _quality(model: DriveModel, residual: Floats) -> FitQuality:
    """Return the quality of a residual (2 n,): RMS speed of body and wheels, and log-likelihood [nats]."""
    rows = model.rows
    use = rows.masked(residual)
    v, omega = (part[rows.valid] for part in both_kinds(use, rows.n))
    rmse = float(np.sqrt(np.mean(v**2 + (model.robot.wheels.base / 2 * omega) ** 2)))
    nats, rms = model.whitener.nats_and_rms(use)
    return FitQuality(rmse_m=rmse, normalised=rms, nats_per_ray=nats)


def _not_observable(model: DriveModel, terms: Sequence[MotorTerm], fit: DriveFit) -> dict[str, str]:
    """Return the effects that would not show at three times their materiality, with the reason."""

    def variance(term: MotorTerm) -> float:
        covariance = fit.regression.solve(model.prior([*terms, term], fit.motors)).covariance
        return float(covariance[term.column, term.column])

    others = [term for term in model.library_terms if term not in terms and term.effect.sizes]
    out = unseen_effects({term.effect: variance(term) for term in others})
    limit = model.robot.limits.v
    can_saturate = any(term.effect is SPEED_SATURATION for term in terms)
    if not can_saturate and model.top_speed < DRIVE.full_speed_share * limit:
        out[SPEED_SATURATION.name] = (
            f"no command exceeds {model.top_speed:.2f} m/s (limit: {limit:.2f} m/s); a saturation above that is not observable"
        )
    return out
