"""Report of the drive channel: named effects with sizes, rivals, deviations, gap and unobservable effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import Facts, Objection
from sensorgraph.diagnosis.hypotheses import accepted_entry, effect_entry
from sensorgraph.diagnosis.motion.considered import (
    ABSORBED,
    structure_entries,
    unknown_structure,
    unseen_effects,
)
from sensorgraph.diagnosis.motion.families import DRIVE_FAMILIES
from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel, MotorTerm
from sensorgraph.diagnosis.motion.motors.nuisances import longest_wait, stated_smear
from sensorgraph.diagnosis.motion.motors.selection import BY_WAITS, TIMING, MotorSelection
from sensorgraph.diagnosis.motion.motors.slow_leftover import SLOW
from sensorgraph.diagnosis.motion.motors.structure import ANSWER, OTHER_MOTORS, WHAT_CHANGES, column_of_jump
from sensorgraph.diagnosis.motion.regression import held_out_residual
from sensorgraph.diagnosis.motion.rivals import probability, strongest_rival
from sensorgraph.diagnosis.motion.settings import DRIVE, EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import TestedStructure
from sensorgraph.diagnosis.motion.whitening import Whitener, WhiteningFilter, both_kinds
from sensorgraph.diagnosis.result import ChannelResult, Deviation, FitQuality, Gap, Rival, Withdrawn
from sensorgraph.effects import Amendment, Effect
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.types import Floats

FAST, MODERATE = 0.85, 0.4
"""Shares of the maximum commanded speed that separate the listed ranges of speed."""
CHANGING, STEADY, MOVING = 0.1, 0.02, 0.02
"""[m/s², m/s², m/s] acceleration above which v changes and below which it is steady; speed above which the
robot moves."""


def drive_result(
    model: DriveModel,
    selected: MotorSelection,
    evidence: Mapping[MotorTerm, float],
    deviations: tuple[Deviation, ...],
) -> ChannelResult:
    """Return the result of the drive channel for the selected effects.

    Parameters
    ----------
    evidence : [nats] Of each effect.
    deviations : Of the bare simulator, before any selection.
    """
    fit, rows = selected.fit, model.rows
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
        found.append((amendment, term))
        entry = _entry_of(model, amendment, term, selected)
        objection = None
        if _is_material(model, amendment):
            objection = _objection(model, amendment, float(np.hypot(error, term.blur)))
            material |= {term.effect} if objection is None else set()
        entries.append(replace(entry, facts=replace(entry.facts, objection=objection)))
        rival = strongest_rival(term.effect, alternatives)
        if rival is None and term.effect is DEAD_TIME and not rows.has_reference:
            rival = _late_clock(evidence[term])
        if rival is not None:
            rivals.append(rival)
    # a lag or a delay that changes has no single size, and the other one absorbs a part of the change
    structure = selected.structure
    tested = [] if model.tested is None else [model.tested]
    if structure is not None and structure.family.kind not in {k for one in tested for k in one.families}:
        tested.append(TestedStructure(families={}, threshold=structure.threshold, best=structure))
    kind = "" if structure is None else structure.family.kind
    is_change = column_of_jump(kind) is not None
    steady = [a for a, term in found if not (is_change and term.column in WHAT_CHANGES)]
    if structure is not None and kind in OTHER_MOTORS:
        least = np.inf if kind != ANSWER else DRIVE.structure.lead_over_answer * structure.evidence
        steady = [a for a in steady if a.effect not in TIMING or (a.evidence or 0.0) > least]
    withdrawn = [a for a, _ in found if a not in steady]
    return ChannelResult(
        channel="drive",
        effects=tuple(a for a in steady if a.effect in material),
        within_tolerance=tuple(a for a in steady if a.effect not in material),
        withdrawn=tuple(Withdrawn(amendment=a, objection=ABSORBED) for a in withdrawn),
        unknown=None
        if structure is None
        else unknown_structure("drive", DRIVE_FAMILIES[kind][0], structure, rows.n_valid),
        rivals=tuple(rivals),
        deviations=deviations,
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


def _objection(model: DriveModel, a: Amendment, error: float) -> Objection | None:
    """Return what the control loop of the base causes that looks like a delay or a lag; None if the size exceeds it.

    Parameters
    ----------
    error : [unit of its parameter] Standard error of the fit.
    """
    if a.effect is DEAD_TIME and abs(a["L"]) - 2 * error < longest_wait(model.robot):
        return BY_WAITS
    smear = stated_smear(model.robot)
    if a.effect is ACTUATOR_LAG and smear and 0 < a["tau"] < smear + 2 * error:
        return Objection("smear_of_odometry", "the odometry smears its speeds over as long a time")
    return None


# criticism -----------------------------------------------------------------------------------------------------------


def deviations_before_naming(model: DriveModel) -> tuple[Deviation, ...]:
    """Return where the bare simulator differs, in speed along the path."""
    fit = model.fit([])
    n, top = model.rows.n, model.top_speed
    left, _ = both_kinds(fit.regression.y - fit.regression.A @ fit.solution.theta, n)
    v, _ = both_kinds(fit.simulated, n)
    speed = np.abs(v)
    change = np.gradient(v)
    acceleration = np.abs(change) / np.maximum(model.rows.end - model.rows.start, 1e-6)
    fast, moderate = speed > FAST * top, (speed > MODERATE * top) & (speed <= FAST * top)
    steady = (acceleration < STEADY) & (speed > MOVING)
    parts = [
        ("speed", f"|v| above {FAST * top:.2f} m/s", fast, v),
        ("speed", f"|v| from {MODERATE * top:.2f} to {FAST * top:.2f} m/s", moderate, v),
        ("acceleration", "while v changes", acceleration > CHANGING, change),
        ("acceleration", "while v is steady", steady, v),
    ]
    out = []
    for partition, label, mask, direction in parts:
        e = left * np.sign(direction) * mask
        sums = np.bincount(model.clusters[:n], weights=e)
        z = float(e.sum() / np.sqrt(max((sums**2).sum(), mask.sum(), 1.0)))
        if abs(z) > EVIDENCE.listed_z:
            out.append(
                Deviation(
                    family="bias",
                    partition=partition,
                    label=label,
                    z=z,
                    size=float(e.sum() / max(mask.sum(), 1) * model.whitener.filters[0].sigma),
                    n_rays=int(mask.sum()),
                    channel="drive",
                )
            )
    return tuple(sorted(out, key=lambda deviation: -abs(deviation.z)))


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
