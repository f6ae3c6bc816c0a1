"""`auto_fit`: identify a model for free run without settings, by cross-validation.

It selects lags, degree, terms and saturation limits. Each fold holds out the output of one block of every record. Terms
are searched by the simulation error on the remaining samples. Models of every size then run freely through the
held-out block, which requires only the inputs. The smallest model within one standard error of the best is selected,
and the search is repeated with all data.

At the end, the model is compared with alternatives over whole records: linear models, friction, unsigned outputs.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import LevenbergMarquardt
from robotmodic_ident.fitting import fit, refined
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import Record, Records, as_records, check_names, cut
from robotmodic_ident.selection.candidates import dictionary, linear_part, output_limits
from robotmodic_ident.selection.criteria import MAX_TERMS, PATIENCE
from robotmodic_ident.selection.free_run_terms import SHORT_DESCENT, FreeRunTerms, Simulated
from robotmodic_ident.selection.hidden_stretches import HiddenStretches, whole_mean_square
from robotmodic_ident.selection.readable_forms import friction_models, magnitude_models
from robotmodic_ident.terms import Terms
from robotmodic_ident.trials import AUTO, MIN_ORDER_GAIN, MIN_SURE_GAIN, AutoSettings, Trial

logger = logging.getLogger(__name__)

MIN_ONE_STEP_GAIN = 0.15
"""Minimum relative decrease of the one-step error of a linear model for a larger order."""
MIN_LIMIT_GAIN = 0.02
"""Minimum relative decrease of the RMSE for keeping saturation limits."""
N_PIECES = 4
"""Number of pieces per record if the records are longer than `AutoSettings.max_rows`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AutoFit:
    """The model of `auto_fit`, and the trials of the search."""

    model: Narmax
    chosen: Trial
    trials: tuple[Trial, ...]

    def __repr__(self) -> str:
        return (
            f"{self.model!r}\n  selected from {len(self.trials)} dictionaries: order {self.chosen.order}, degree "
            f"{self.chosen.degree}, {self.chosen.n_terms} terms; free-run RMSE on held-out blocks {self.chosen.rmse:.4g}"
        )


def auto_fit(
    records: Records, output: str, inputs: Sequence[str] = (), *, settings: AutoSettings = AUTO
) -> AutoFit:
    """Identify one output for free run; lags, degree and number of terms are selected automatically.

    Parameters
    ----------
    records : Training data.
    inputs : Signals that drive the output, with lags from 0.

    Raises
    ------
    IdentError
        If the records are too short, a signal is missing, several outputs are given, or every model diverges in free
        run.
    """
    check_names(output, inputs)
    records = as_records(records)
    searched = _searched(records, settings)
    stretches = HiddenStretches(records=searched, output=output, n_folds=settings.n_folds)
    trials: list[Trial] = []

    def tried(order: int, degree: int, limits: tuple[float, float]) -> Trial:
        terms = dictionary(output, inputs, order, degree, settings.max_product_lag)
        trial = _cross_validated(stretches, terms, order, degree, limits)
        logger.info("order %d, degree %d: %d terms, RMSE %.4g", order, degree, trial.n_terms, trial.rmse)
        trials.append(trial)
        return trial

    limits = output_limits(records, output)
    first, *longer = linear_orders(records, stretches, inputs, limits, settings)
    best = _best_degree(tried, first, limits, settings)
    idle = 0
    for order in longer:
        if idle == PATIENCE:
            break
        now = tried(order, best.degree, best.limits)
        best, idle = (now, 0) if now.beats(best) else (best, idle + 1)
    if not np.isfinite(best.rmse):
        raise IdentError(
            f"every model of {output} diverges in free run over the held-out blocks; use longer records, or "
            "fit one step ahead"
        )
    terms = dictionary(output, inputs, best.order, best.degree, settings.max_product_lag)
    model = _final(stretches, records, terms, best)
    others: list[Trial] = []
    if sum(map(len, searched)) != sum(map(len, records)):
        others = [*trials, linear_trial(records, best, inputs, settings)]
    if unexplained(model, records) > settings.min_unexplained:
        others += other_forms(records, best, inputs, settings)
    model, best = over_whole_records(model, best, others, records)
    return AutoFit(model=model, chosen=best, trials=tuple(trials))


def linear_orders(
    records: Sequence[Record],
    stretches: HiddenStretches,
    inputs: Sequence[str],
    limits: tuple[float, float],
    settings: AutoSettings,
) -> tuple[int, ...]:
    """Return the orders for the search of nonlinear terms, preselected with linear models, which are cheap to fit.

    The first order is the smallest one that no larger order beats in free run by `MIN_ORDER_GAIN` and in every fold.
    With too few lags, products of signals would fit spurious effects. The last order is the one beyond which the
    one-step error decreases by less than `MIN_ONE_STEP_GAIN`. The one-step error also reveals dynamics that the free
    run of a linear model misses because of the nonlinear part. It is, however, sensitive to noise of the output, which
    calls for more lags than the process has.
    """
    n = len(settings.orders)
    in_free_run, one_step = np.full((n, stretches.n_folds), np.inf), np.full(n, np.inf)
    for i, order in enumerate(settings.orders):
        terms = dictionary(stretches.output, inputs, order, 1, settings.max_product_lag)
        with suppress(IdentError):  # it diverges, or the records are too short for so many lags
            one_step[i] = _linear_start(records, stretches.output, terms, limits).sigma
            in_free_run[i] = _linear_errors(stretches, terms, limits)
        rmse = np.sqrt(in_free_run[i].mean())
        logger.info("order %d, linear: RMSE %.4g in free run, %.4g one step ahead", order, rmse, one_step[i])
    first = last = 0
    for i in range(n):
        worth = (1.0 - MIN_ORDER_GAIN) ** 2 * in_free_run[first].mean()
        if in_free_run[i].mean() < worth and (in_free_run[i] < in_free_run[first]).all():
            first = i
        if one_step[i] < one_step[last] * (1.0 - MIN_ONE_STEP_GAIN):
            last = i
    return settings.orders[first : max(first, last) + 1]


def _linear_errors(stretches: HiddenStretches, terms: Terms, limits: tuple[float, float]) -> list[float]:
    """Return the mean squared error of a linear model on every held-out block, after fitting the other samples."""
    out = []
    for fold, shown in enumerate(stretches.shown):
        start = _linear_start(shown, stretches.output, terms, limits)
        model = FreeRunTerms(shown, terms).started(start).model
        out.append(stretches.mean_square(model, fold))
    return out


def _best_degree(
    tried: Callable[[int, int, tuple[float, float]], Trial],
    order: int,
    limits: tuple[float, float],
    settings: AutoSettings,
) -> Trial:
    """Return the best trial of one order over all degrees, with or without saturation limits of the output."""
    first, *others = settings.degrees
    best = tried(order, first, limits)
    if limits != UNLIMITED:
        free = tried(order, first, UNLIMITED)
        best = best if best.rmse < free.rmse * (1.0 - MIN_LIMIT_GAIN) else free
    for degree in others:
        best = min(best, tried(order, degree, best.limits), key=lambda one: one.rmse)
    return best


def _searched(records: Sequence[Record], settings: AutoSettings) -> list[Record]:
    """Return the records, or evenly spaced pieces of each record if they are too long for the search."""
    total = sum(map(len, records))
    if total <= settings.max_rows:
        return list(records)
    out = []
    for record in records:
        edges = np.linspace(0, len(record), N_PIECES + 1).round().astype(int)
        for first, last in pairwise(edges.tolist()):
            n = int(np.ceil((last - first) * settings.max_rows / total))
            out.append(cut(record, slice(first, first + n)))
    return out


def _cross_validated(
    stretches: HiddenStretches,
    terms: Terms,
    order: int,
    degree: int,
    limits: tuple[float, float],
) -> Trial:
    """Cross-validate one dictionary; return the smallest model within one standard error of the best.

    Each fold holds out one block of every record (one-standard-error rule: Breiman et al. 1984, sec. 3.4.3).
    """
    most = MAX_TERMS
    errors = np.full((stretches.n_folds, most + 1), np.inf)
    paths: list[dict[int, Simulated]] = []
    for i, shown in enumerate(stretches.shown):
        try:
            path = _path(shown, stretches.output, terms, limits)
        except IdentError:
            continue
        paths.append(path)
        for size in range(1, most + 1):
            if size in path:
                errors[i, size] = stretches.mean_square(path[size].model, i)
            elif size > min(path):  # that many terms brought no gain
                errors[i, size] = errors[i, size - 1]
    means, best = errors.mean(axis=0), int(errors.mean(axis=0).argmin())
    spread = float(errors[:, best].std(ddof=1) / np.sqrt(len(errors))) if np.isfinite(means[best]) else 0.0
    size = int((means <= means[best] + spread).argmax())  # one-standard-error rule
    return Trial(
        order=order,
        degree=degree,
        limits=limits,
        n_candidates=len(terms),
        n_terms=size,
        rmse=float(np.sqrt(means[size])),
        errors=tuple(errors[:, size].tolist()),
        found=tuple(path[size].model for path in paths if size in path),
    )


def _path(
    records: Sequence[Record],
    output: str,
    terms: Terms,
    limits: tuple[float, float],
) -> dict[int, Simulated]:
    """Search the best models of every size, starting from the linear model."""
    start = _linear_start(records, output, terms, limits)
    return FreeRunTerms(records, terms).path(start)


def _linear_start(
    records: Sequence[Record], output: str, terms: Terms, limits: tuple[float, float]
) -> Narmax:
    """Return the linear model with the least one-step error."""
    linear = linear_part(terms)
    return fit(records, output, linear, n_terms=len(linear), search="forward", limits=limits)


def _final(
    stretches: HiddenStretches,
    records: Sequence[Record],
    terms: Terms,
    best: Trial,
) -> Narmax:
    """Estimate on all records the structure with the least error on held-out blocks.

    The candidates are the structure found with all data, and those found in the folds. The result of a search depends
    on the data, and a structure with poorly determined coefficients has a large error in other folds.
    """
    path = _path(stretches.records, stretches.output, terms, best.limits)
    size = min(path, key=lambda k: (abs(k - best.n_terms), k))
    tried = (path[size].model, *best.found)
    errors = [_structure_error(model, stretches, terms) for model in tried]
    model = replace(tried[int(np.argmin(errors))], notes=path[size].model.notes)
    model = refined(model, records, "simulation", "hac")
    note = (
        f"order {best.order}, degree {best.degree} and {len(model.terms)} terms have the least free-run error "
        "on held-out blocks"
    )
    return replace(model, notes=(*model.notes, note), stop="cv")


def _structure_error(model: Narmax, stretches: HiddenStretches, terms: Terms) -> float:
    """Return the mean squared error of a structure on held-out blocks; inf if it diverges.

    The coefficients are estimated on the other samples of each fold.
    """
    squares = []
    for i, shown in enumerate(stretches.shown):
        try:
            there = FreeRunTerms(shown, terms).minimised(model, model.theta, SHORT_DESCENT)
        except IdentError:
            return float("inf")
        squares.append(stretches.mean_square(there.model, i))
    return float(np.mean(squares))


MAX_FRICTION_ROWS = 25_000
"""Number of samples, from the start of the records, for estimating friction; a motor drifts slowly."""


def over_whole_records(
    model: Narmax, best: Trial, trials: Sequence[Trial], records: Sequence[Record]
) -> tuple[Narmax, Trial]:
    """Return the model, or an alternative with a far smaller free-run error over whole records.

    A search on pieces of a long record does not measure the drift of a free run over the whole record, which is large
    for an integrating output. Friction and unsigned outputs cannot be described by polynomials.
    """

    def error(one: Narmax) -> float:
        return whole_mean_square(one, records)

    found = [(error(one), one, trial) for trial in trials for one in trial.found]
    if not found:
        return model, best
    worth = min(found, key=lambda one: one[0])[0] * (1.0 + MIN_SURE_GAIN) ** 2
    least, other, trial = min(
        (one for one in found if one[0] <= worth), key=lambda one: len(one[1].terms), default=found[0]
    )
    if not least < (1.0 - MIN_ORDER_GAIN) ** 2 * error(model):
        return model, best
    kept = other
    if not other.is_magnitude:
        descended = refined(other, records, "simulation", "hac")
        stay = LevenbergMarquardt(max_steps=0)
        kept = descended if error(descended) < least else refined(other, records, "simulation", "hac", stay)
    note = f"this model has the least free-run error over whole records: order {trial.order}, degree {trial.degree}"
    return replace(kept, notes=(*kept.notes, note), stop="cv"), replace(trial, rmse=float(np.sqrt(least)))


def unexplained(model: Narmax, records: Sequence[Record]) -> float:
    """Return the free-run RMSE over whole records divided by the standard deviation of the output."""
    spread = np.nanstd(np.concatenate([record.signals[model.output] for record in records]))
    return float(np.sqrt(whole_mean_square(model, records)) / max(spread, 1e-300))


def linear_trial(
    records: Sequence[Record], best: Trial, inputs: Sequence[str], settings: AutoSettings
) -> Trial:
    """Return linear models estimated in free run over one long section at the start of every record."""
    heads = _heads(records, 2 * settings.max_rows)
    output = best.found[0].output
    found = []
    for order in dict.fromkeys((settings.orders[0], best.order)):
        terms = dictionary(output, inputs, order, 1, settings.max_product_lag)
        with suppress(IdentError):
            found.append(
                fit(
                    heads,
                    output,
                    terms,
                    n_terms=len(terms),
                    search="forward",
                    estimator="simulation",
                    limits=best.limits,
                )
            )
    return replace(
        best, degree=1, n_candidates=len(terms), n_terms=len(terms), rmse=float("nan"), found=tuple(found)
    )


def other_forms(
    records: Sequence[Record], best: Trial, inputs: Sequence[str], settings: AutoSettings
) -> list[Trial]:
    """Return linear models with dry friction, and linear models of a signed output with measured magnitude."""
    output, out = best.found[0].output, []
    heads = _heads(records, MAX_FRICTION_ROWS)
    order = settings.orders[0]
    found = {order: friction_models(heads, output, inputs, order, best.limits)}
    if (
        best.limits[1] == UNLIMITED[1]
    ):  # a magnitude often rests at its minimum 0, so only the upper limit counts
        heads = _heads(records, 2 * settings.max_rows)
        for order in (order for order in settings.orders if order <= settings.max_magnitude_order):
            found[order] = [*found.get(order, []), *magnitude_models(heads, output, inputs, order)]
    for order, models in found.items():
        out += [replace(best, order=order, degree=1, n_terms=len(m.terms), found=(m,)) for m in models]
    return out


def _heads(records: Sequence[Record], n: int) -> list[Record]:
    """Return the start of every record, about n samples in total."""
    share = n / sum(map(len, records))
    return [cut(record, slice(0, int(share * len(record)) + 1)) for record in records]
