"""Report of the odometry channel: what the accepted wheel effects and patches are, and how large the gap is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.motion.regression import RegressionFit, Term, held_out_residual
from sensorgraph.diagnosis.motion.report import (
    AcceptedEffect,
    TriedEffect,
    channel_result,
    exceeds_sizes,
    fit_quality,
)
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure
from sensorgraph.diagnosis.motion.wheels.model import RIM, WheelModel, price
from sensorgraph.diagnosis.motion.wheels.patch_search import PATCH_PRICE, best_patch, gains_of_discs
from sensorgraph.diagnosis.motion.wheels.rows import WINDOW
from sensorgraph.diagnosis.motion.whitening import both_kinds
from sensorgraph.diagnosis.result import ChannelResult, FitQuality, Gap, MotionDifference
from sensorgraph.effects import Amendment, Effect
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats

EVEN_PART = 0.5
"""Share of the contribution of a whole-run effect, above which structure takes its name."""
STAMP_AVERAGING = 8.0
"""Ratio of the tolerance of one stamp to the error of the mean over a run."""
MIN_DISTANCE = 1.0
"""[m] minimum path for a slip to be observable."""


def odometry_result(
    model: WheelModel,
    terms: Sequence[Term],
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
    slips = any(term.effect is WHEEL_SLIP for term in terms)
    hides_slip = not slips and float(np.abs(model.wheels.distance).sum()) < MIN_DISTANCE
    return channel_result(
        "odometry",
        accepted=_accepted(model, terms, fit, rng),
        tried=[*_tried(model, terms), *([] if slips else _tried_patch(model, terms))],
        structures=[one for one in (model.structure, aside) if one is not None],
        tested=model.tested,
        gap=_gap(model, terms),
        not_observable={WHEEL_SLIP.name: "the robot drove less than 1 m"} if hides_slip else {},
        notes={
            **notes,
            "clock_offset_s": model.rows.clock + float(fit.theta[model.layout.clock]),
            "rows": 2 * model.rows.n_valid,
        },
        motion=_motion_difference(model, fit),
    )


def _accepted(
    model: WheelModel, terms: Sequence[Term], fit: RegressionFit, rng: np.random.Generator
) -> list[AcceptedEffect]:
    """Return the effects of the model."""
    stderr = np.sqrt(np.diag(model.regression.clustered_covariance(fit, model.clusters)))
    radius = [term.column for term in terms if term.effect is WHEEL_RADIUS]
    gain = 1 + float(fit.theta[radius[0]]) if radius else 1.0
    out = []
    for term in terms:
        theta, error = float(fit.theta[term.column]), float(stderr[term.column])
        if term.effect is WHEEL_SLIP:
            sized = _slip(model, term.column - model.layout.n, theta, error)
        else:
            sized = _everywhere(model, term.effect, theta, error, gain)
        out.append(
            AcceptedEffect(
                sized=replace(sized, evidence=model.evidence(terms, term)),
                price=price(term),
                alternatives=_alternatives(model, term, terms, rng),
                error=model.error_without(model.columns[:, term.column] * theta),
                is_material=exceeds_sizes(sized),
                is_absorbed=_is_absorbed(model, term, fit),
            )
        )
    return out


def _tried(model: WheelModel, terms: Sequence[Term]) -> Iterator[TriedEffect]:
    """Yield the effects that act everywhere and are not in the model."""
    without = model.log_posterior(terms)
    for term in model.layout.terms:
        if term not in terms:
            fit = model.regression.solve(model.prior([*terms, term]))
            variance = max(float(fit.covariance[term.column, term.column]), 0.0)
            a = _everywhere(model, term.effect, float(fit.theta[term.column]), float(np.sqrt(variance)), 1.0)
            evidence = fit.log_posterior - without - price(term)
            yield TriedEffect(amendment=replace(a, evidence=evidence), price=price(term), variance=variance)


def _tried_patch(model: WheelModel, terms: Sequence[Term]) -> Iterator[TriedEffect]:
    """Yield the best slippery patch if one was found."""
    if model.last_patch is not None:
        patch, evidence = model.last_patch
        _, lost = gains_of_discs(model, patch.disc[None], patch.track, terms)
        slip = WHEEL_SLIP(s=float(lost[0]), x=patch.x, y=patch.y, r=patch.r).at(xy=(patch.x, patch.y))
        yield TriedEffect(amendment=replace(slip, evidence=evidence), price=PATCH_PRICE)


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


def _slip(model: WheelModel, i: int, share: float, error: float) -> Amendment:
    """Return a patch with its place; the standard errors combine those of the fit and of the search."""
    patch = model.patches[i]
    width = np.sqrt(np.diag(patch.covariance))
    stderr = {"s": float(np.hypot(error, width[0]))} | {
        key: float(np.hypot(w, RIM)) for key, w in zip("xyr", width[1:], strict=True)
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
        stderr = float(np.hypot(error, model.robot.tolerances.stamp / STAMP_AVERAGING))
    return replace(effect(**{key: value}), stderr={key: stderr})


def _is_absorbed(model: WheelModel, term: Term, fit: RegressionFit) -> bool:
    """Tell whether structure absorbs a whole-run effect, because its contribution is at least half as large.

    The effect may be the even part of another cause. For example, a floor that takes a share of left turns only is
    equivalent to half a wheelbase error and half a difference between left and right.
    """
    A, first = model.regression.A, model.layout.n + len(model.patches)
    structure = float(np.linalg.norm(A[:, first:] @ fit.theta[first:]))
    own = float(np.linalg.norm(A[:, term.column] * fit.theta[term.column]))
    return term.effect is not WHEEL_SLIP and structure > EVEN_PART * own


def _alternatives(
    model: WheelModel, term: Term, terms: Sequence[Term], rng: np.random.Generator
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


def _gap(model: WheelModel, terms: Sequence[Term]) -> Gap:
    """Return the gap, by fits to every other block of 5 s and measurements on the rest, and vice versa."""
    rows, columns, prior = model.rows, model.columns, model.prior(terms)
    fit = model.regression.solve(prior)
    nominal = np.zeros(columns.shape[1])
    nominal[model.layout.clock] = -rows.clock
    n, k = 2 * rows.n_valid, columns.shape[1]
    return Gap(
        before=_quality(model, model.y - columns @ nominal),
        after=_quality(model, held_out_residual(model.regression, prior, columns, model.y, rows.stamps)),
        noise_floor=_quality(model, (model.y - columns @ fit.theta) * np.sqrt(n / max(n - k, 1))),
        n_rays=n,
    )


def _quality(model: WheelModel, residual: Floats) -> FitQuality:
    """Return the quality of a residual (2 n,), with RMS speeds over a second."""
    rows = model.rows
    step = float(np.median(np.diff(rows.stamps)))
    m = max(1, round(WINDOW / step))
    k = rows.n // m
    use = rows.masked(residual)
    rates = [part[: k * m].reshape(k, m).sum(axis=1) / (m * step) for part in both_kinds(use, rows.n)]
    return fit_quality(model.whitener, use, rates, model.robot.wheels.base)
