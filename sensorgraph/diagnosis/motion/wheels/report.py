"""Report of the odometry channel: named effects with sizes, rivals, deviations, gap, unobservable effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import Facts
from sensorgraph.diagnosis.hypotheses import accepted_entry, effect_entry
from sensorgraph.diagnosis.motion.considered import (
    ABSORBED,
    name_of,
    structure_entries,
    unknown_structure,
    unseen_effects,
)
from sensorgraph.diagnosis.motion.regression import RegressionFit, held_out_residual, ridge_solution
from sensorgraph.diagnosis.motion.rivals import probability, strongest_rival
from sensorgraph.diagnosis.motion.settings import EVIDENCE, ODOMETRY
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, StructureFamily
from sensorgraph.diagnosis.motion.wheels.columns import WheelTerm
from sensorgraph.diagnosis.motion.wheels.model import WheelModel, price
from sensorgraph.diagnosis.motion.wheels.patch_search import PATCH_PRICE, best_patch, gains_of_discs
from sensorgraph.diagnosis.motion.wheels.structure import odometry_families
from sensorgraph.diagnosis.motion.whitening import both_kinds
from sensorgraph.diagnosis.result import (
    ChannelResult,
    FitQuality,
    Gap,
    MotionDifference,
    Rival,
    Unknown,
    Withdrawn,
)
from sensorgraph.effects import Amendment, Effect
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats

RMSE_WINDOW = 1.0
"""[s] averaging time of the speeds in the gap."""


def odometry_result(
    model: WheelModel,
    terms: Sequence[WheelTerm],
    aside: AcceptedStructure | None,
    notes: Mapping[str, object],
    rng: np.random.Generator,
) -> ChannelResult:
    """Return the result of the odometry channel for the selected effects.

    Parameters
    ----------
    aside : Structure that moves the body across its heading.
    """
    fit = model.regression.solve(model.prior(terms))
    covariance = model.regression.clustered_covariance(fit, model.clusters)
    found, entries, rivals = list[Amendment](), [], list[Rival]()
    for term in terms:
        alternatives = _alternatives(model, term, terms, rng)
        a = _amendment(model, term, terms, fit, covariance, alternatives)
        found.append(a)
        entries.append(_entry_of(model, term, a, fit))
        rival = strongest_rival(term.effect, alternatives)
        rivals += [] if rival is None else [rival]
    found.sort(key=lambda a: -(a.evidence or 0.0))
    absorbed = list[Amendment]()
    if model.structure is not None:  # effects that structure absorbs are not named
        taken = _taken_by_structure(model, terms, fit)
        absorbed = [a for a in found if a.effect in taken]
        found = [a for a in found if a not in absorbed]
    named = [a for a in found if _is_material(a)]
    return ChannelResult(
        channel="odometry",
        effects=tuple(named),
        within_tolerance=tuple(a for a in found if not _is_material(a)),
        withdrawn=tuple(Withdrawn(amendment=a, objection=ABSORBED) for a in absorbed),
        unknown=_unknown(model, aside),
        rivals=tuple(rival for rival in rivals if any(a.name == rival.instead_of for a in named)),
        gap=_gap(model, terms),
        not_observable=_not_observable(model, terms),
        considered=(
            *entries,
            *(_term_entry(model, term, terms) for term in model.layout.terms if term not in terms),
            *_patch_entry(model, terms),
            *structure_entries("odometry", model.tested),
        ),
        notes={
            **notes,
            "clock_offset_s": model.rows.clock + float(fit.theta[model.layout.clock]),
            "rows": int(model.rows.valid_rows.sum()),
        },
        motion=_motion_difference(model, fit),
    )


def _entry_of(model: WheelModel, term: WheelTerm, a: Amendment, fit: RegressionFit) -> Entry:
    """Return the ledger's entry of an effect of the model, with the error of a simulation without it."""
    size = model.error_without(model.columns[:, term.column] * fit.theta[term.column])
    return accepted_entry(a, EVIDENCE.threshold, price(term), size)


def _term_entry(model: WheelModel, term: WheelTerm, terms: Sequence[WheelTerm]) -> Entry:
    """Return the ledger's entry of an effect that is not in the model, at its most likely size."""
    fit = model.regression.solve(model.prior([*terms, term]))
    theta = float(fit.theta[term.column])
    error = float(np.sqrt(max(float(fit.covariance[term.column, term.column]), 0.0)))
    evidence = fit.log_posterior - model.log_posterior(terms) - price(term)
    facts = Facts(has_name=True, evidence=evidence, threshold=EVIDENCE.threshold)
    return effect_entry(_everywhere(model, term.effect, theta, error, 1.0), facts, price=price(term))


def _patch_entry(model: WheelModel, terms: Sequence[WheelTerm]) -> list[Entry]:
    """Return the ledger's entry of the best slippery patch, if no patch is in the model and one was found."""
    if model.last_patch is None or any(term.effect is WHEEL_SLIP for term in terms):
        return []
    patch, evidence = model.last_patch
    _, lost = gains_of_discs(model, patch.disc[None], patch.track, terms)
    slip = WHEEL_SLIP(s=float(lost[0]), x=patch.x, y=patch.y, r=patch.r).at(xy=(patch.x, patch.y))
    facts = Facts(has_name=True, evidence=evidence, threshold=EVIDENCE.threshold)
    return [effect_entry(slip, facts, price=PATCH_PRICE)]


def _motion_difference(model: WheelModel, fit: RegressionFit) -> MotionDifference | None:
    """Return the motion that patches and structure explain; None without these."""
    more = model.columns[:, model.layout.n :]
    if not more.shape[1]:
        return None
    rows = both_kinds(more @ fit.theta[model.layout.n :], model.rows.n)
    dt = np.gradient(model.rows.stamps)
    return MotionDifference(
        stamps=model.rows.stamps,
        rates=np.stack([np.where(model.rows.valid, x, 0.0) / dt for x in rows], axis=1),
    )


def _amendment(
    model: WheelModel,
    term: WheelTerm,
    terms: Sequence[WheelTerm],
    fit: RegressionFit,
    covariance: Floats,
    alternatives: Mapping[Effect, float],
) -> Amendment:
    """Return an effect with sizes, standard errors, evidence and probability.

    Parameters
    ----------
    alternatives : [nats] Evidence of each effect that could replace it.
    """
    evidence = model.evidence(terms, term)
    sure = probability(evidence, alternatives.values())
    theta, error = float(fit.theta[term.column]), float(np.sqrt(covariance[term.column, term.column]))
    if term.effect is WHEEL_SLIP:
        amendment = _slip(model, term.column - model.layout.n, theta, error)
    else:
        radius = [other.column for other in terms if other.effect is WHEEL_RADIUS]
        gain = 1 + float(fit.theta[radius[0]]) if radius else 1.0
        amendment = _everywhere(model, term.effect, theta, error, gain)
    return replace(amendment, probability=sure, evidence=evidence)


def _slip(model: WheelModel, i: int, share: float, error: float) -> Amendment:
    """Return a patch with its place; the standard errors combine those of the fit and of the search."""
    patch, settings = model.patches[i], ODOMETRY.patch
    width = np.sqrt(np.diag(patch.covariance))
    stderr = {"s": float(np.hypot(error, width[0]))} | {
        key: float(np.hypot(w, settings.min_place_error)) for key, w in zip("xyr", width[1:], strict=True)
    }
    slip = WHEEL_SLIP(s=float(np.clip(share, 0, 1)), x=patch.x, y=patch.y, r=patch.r)
    return replace(slip, stderr=stderr).at(xy=(patch.x, patch.y))


def _everywhere(model: WheelModel, effect: Effect, theta: float, error: float, gain: float) -> Amendment:
    """Return an effect that acts everywhere.

    Parameters
    ----------
    gain : Of both wheels, true over measured.
    """
    key = effect.parameters[0].name
    regressor = effect.diagnostics.wheel_regressor
    if regressor is not None:
        value, stderr = regressor.size(theta, gain), regressor.stderr(error, gain)
    else:  # the clock: no more accurate than the mean of the run's stamps
        value = float(model.rows.clock + theta)
        stderr = float(np.hypot(error, model.robot.tolerances.stamp / ODOMETRY.stamp_averaging))
    return replace(effect(**{key: value}), stderr={key: stderr})


def _taken_by_structure(model: WheelModel, terms: Sequence[WheelTerm], fit: RegressionFit) -> set[Effect]:
    """Return whole-run effects that structure absorbs, because its contribution is at least half of theirs.

    They may be the even part of another cause. For example, a floor that takes a share of left turns only is
    equivalent to half a wheelbase error and half a difference between left and right.
    """
    A, structure = model.regression.A, model.layout.n + len(model.patches)
    size = float(np.linalg.norm(A[:, structure:] @ fit.theta[structure:]))
    return {
        term.effect
        for term in terms
        if term.effect is not WHEEL_SLIP
        and size > ODOMETRY.structure.even_part * np.linalg.norm(A[:, term.column] * fit.theta[term.column])
    }


def _is_material(a: Amendment) -> bool:
    return all(abs(a.parameters[key]) >= limit for key, limit in a.effect.sizes.items())


def _alternatives(
    model: WheelModel, term: WheelTerm, terms: Sequence[WheelTerm], rng: np.random.Generator
) -> dict[Effect, float]:
    """Return the evidence of each effect that could replace an effect [nats]."""
    rest = [other for other in terms if other != term]
    out = {
        other.effect: model.evidence([*rest, other], other)
        for other in model.layout.terms
        if other not in terms
    }
    if term.effect is not WHEEL_SLIP:
        found = best_patch(model, rest, rng)
        out[WHEEL_SLIP] = -np.inf if found is None else found[1]
    return out


# criticism -----------------------------------------------------------------------------------------------------------


def _steady(families: Sequence[StructureFamily]) -> list[StructureFamily]:
    """Return the families with a fixed choice of columns; the moments of a jump are one choice among many."""
    return [family for family in families if not family.choice_price]


def _unknown(model: WheelModel, aside: AcceptedStructure | None) -> Unknown | None:
    """Describe the structure with the most evidence, in the model or across the heading."""
    found = sorted(
        [one for one in (model.structure, aside) if one is not None], key=lambda one: -one.evidence
    )
    if not found:
        return None
    first, rivals = found[0], [one.family.statement for one in found[1:]]
    first = replace(first, rivals=[*rivals, *first.rivals][:2])
    name = name_of("odometry", model.tested, found[0])
    return unknown_structure("odometry", name, first, int(model.rows.valid_rows.sum()))


def _gap(model: WheelModel, terms: Sequence[WheelTerm]) -> Gap:
    """Return the gap, by fits to every other block of 5 s and measurements on the rest, and vice versa."""
    rows, regression, prior, columns = model.rows, model.regression, model.prior(terms), model.columns
    after = held_out_residual(regression, prior, columns, model.y, rows.stamps)
    nominal = np.zeros(columns.shape[1])
    nominal[model.layout.clock] = -rows.clock
    # noise floor: the residual with all structure fitted as well
    families = _steady(odometry_families(model.rows, model.motion, model.robot.wheels))
    rich = np.concatenate([columns, *[family.columns for family in families]], axis=1)
    theta = ridge_solution(model.whitener(rich), regression.y)
    n_valid = rows.valid_rows.sum()
    floor = (model.y - rich @ theta) * np.sqrt(n_valid / max(int(n_valid) - len(theta), 1))
    return Gap(
        before=_quality(model, model.y - columns @ nominal),
        after=_quality(model, after),
        noise_floor=_quality(model, floor),
        n_rays=2 * rows.n,
    )


def _quality(model: WheelModel, residual: Floats) -> FitQuality:
    """Return the quality of a residual (2 n,): RMS speed of body and wheels over a second, log-likelihood [nats]."""
    rows = model.rows
    step = float(np.median(np.diff(rows.stamps)))
    m = max(1, round(RMSE_WINDOW / step))
    k = rows.n // m
    use = rows.masked(residual)
    along, yaw = (part[: k * m].reshape(k, m).sum(axis=1) / (m * step) for part in both_kinds(use, rows.n))
    rmse = float(np.sqrt(np.mean(along**2 + (model.robot.wheels.base / 2 * yaw) ** 2)))
    nats, rms = model.whitener.nats_and_rms(use)
    return FitQuality(rmse_m=rmse, normalised=rms, nats_per_ray=nats)


def _not_observable(model: WheelModel, terms: Sequence[WheelTerm]) -> dict[str, str]:
    """Return the effects that would not show at three times their materiality, with the reason."""

    def variance(term: WheelTerm) -> float:
        covariance = model.regression.solve(model.prior([*terms, term])).covariance
        return float(covariance[term.column, term.column])

    out = unseen_effects({term.effect: variance(term) for term in model.layout.terms if term not in terms})
    slips = any(term.effect is WHEEL_SLIP for term in terms)
    if not slips and float(np.abs(model.wheels.distance).sum()) < ODOMETRY.min_distance:
        out[WHEEL_SLIP.name] = "the robot drove less than 1 m"
    return out
