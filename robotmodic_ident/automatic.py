"""`auto_fit`: identify a model for free run without settings, by cross-validation.

It selects lags, degree, terms and saturation limits. Each fold holds out the output of one block of every record. Terms
are searched by the simulation error on the remaining samples. Models of every size then run freely through the
held-out block, which requires only the inputs. The smallest model within one standard error of the best is selected,
and the search is repeated with all data.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.fitting import fit, refined
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import Record, Records, as_records, check_names, cut
from robotmodic_ident.selection.candidates import dictionary, linear_part, output_limits
from robotmodic_ident.selection.free_run_terms import (
    SHORT_DESCENT,
    FreeRunTerms,
    Simulated,
)
from robotmodic_ident.selection.hidden_stretches import HiddenStretches
from robotmodic_ident.terms import Terms
from robotmodic_ident.trials import AUTO, AutoSettings, Trial
from robotmodic_ident.whole_records import linear_trial, other_forms, over_whole_records, unexplained

logger = logging.getLogger(__name__)


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
    stretches = HiddenStretches(
        records=searched, output=output, n_folds=settings.n_folds, warm_up=settings.warm_up
    )
    trials: list[Trial] = []

    def tried(order: int, degree: int, limits: tuple[float, float]) -> Trial:
        terms = dictionary(output, inputs, order, degree, settings.max_product_lag)
        trial = _cross_validated(stretches, terms, order, degree, limits, settings)
        logger.info("order %d, degree %d: %d terms, RMSE %.4g", order, degree, trial.n_terms, trial.rmse)
        trials.append(trial)
        return trial

    limits = output_limits(records, output)
    first, *longer = linear_orders(records, stretches, inputs, limits, settings)
    best = _best_degree(tried, first, limits, settings)
    idle = 0
    for order in longer:
        if idle == settings.patience:
            break
        now = tried(order, best.degree, best.limits)
        best, idle = (now, 0) if now.beats(best, settings) else (best, idle + 1)
    if not np.isfinite(best.rmse):
        raise IdentError(
            f"every model of {output} diverges in free run over the held-out blocks; use longer records, or "
            "fit one step ahead"
        )
    terms = dictionary(output, inputs, best.order, best.degree, settings.max_product_lag)
    model = _final(stretches, records, terms, best, settings)
    others: list[Trial] = []
    if sum(map(len, searched)) != sum(map(len, records)):
        others = [*trials, linear_trial(records, best, inputs, settings)]
    if unexplained(model, records, settings) > settings.min_unexplained:
        others += other_forms(records, best, inputs, settings)
    model, best = over_whole_records(model, best, others, records, settings)
    return AutoFit(model=model, chosen=best, trials=tuple(trials))


def linear_orders(
    records: Sequence[Record],
    stretches: HiddenStretches,
    inputs: Sequence[str],
    limits: tuple[float, float],
    settings: AutoSettings,
) -> tuple[int, ...]:
    """Return the orders for the search of nonlinear terms, preselected with linear models, which are cheap to fit.

    The first order is the smallest one that no larger order beats in free run by `min_order_gain` and in every fold.
    With too few lags, products of signals would fit spurious effects. The last order is the one beyond which the
    one-step error decreases by less than `min_one_step_gain`. The one-step error also reveals dynamics that the free
    run of a linear model misses because of the nonlinear part. It is, however, sensitive to noise of the output, which
    calls for more lags than the process has.
    """
    n = len(settings.orders)
    in_free_run, one_step = np.full((n, stretches.n_folds), np.inf), np.full(n, np.inf)
    for i, order in enumerate(settings.orders):
        terms = dictionary(stretches.output, inputs, order, 1, settings.max_product_lag)
        with suppress(IdentError):  # it diverges, or the records are too short for so many lags
            one_step[i] = _linear_start(records, stretches.output, terms, limits).sigma
            in_free_run[i] = _linear_errors(stretches, terms, limits, settings)
        rmse = np.sqrt(in_free_run[i].mean())
        logger.info("order %d, linear: RMSE %.4g in free run, %.4g one step ahead", order, rmse, one_step[i])
    first = last = 0
    for i in range(n):
        worth = (1.0 - settings.min_order_gain) ** 2 * in_free_run[first].mean()
        if in_free_run[i].mean() < worth and (in_free_run[i] < in_free_run[first]).all():
            first = i
        if one_step[i] < one_step[last] * (1.0 - settings.min_one_step_gain):
            last = i
    return settings.orders[first : max(first, last) + 1]


def _linear_errors(
    stretches: HiddenStretches, terms: Terms, limits: tuple[float, float], settings: AutoSettings
) -> list[float]:
    """Return the mean squared error of a linear model on every held-out block, after fitting the other samples."""
    out = []
    for fold, shown in enumerate(stretches.shown):
        start = _linear_start(shown, stretches.output, terms, limits)
        model = FreeRunTerms(shown, terms, settings.search).started(start).model
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
        best = best if best.rmse < free.rmse * (1.0 - settings.min_limit_gain) else free
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
        edges = np.linspace(0, len(record), settings.n_pieces + 1).round().astype(int)
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
    settings: AutoSettings,
) -> Trial:
    """Cross-validate one dictionary; return the smallest model within one standard error of the best.

    Each fold holds out one block of every record (one-standard-error rule: Breiman et al. 1984, sec. 3.4.3).
    """
    most = settings.search.max_terms
    errors = np.full((settings.n_folds, most + 1), np.inf)
    paths: list[dict[int, Simulated]] = []
    for i, shown in enumerate(stretches.shown):
        try:
            path = _path(shown, stretches.output, terms, limits, settings)
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
    settings: AutoSettings,
) -> dict[int, Simulated]:
    """Search the best models of every size, starting from the linear model."""
    start = _linear_start(records, output, terms, limits)
    return FreeRunTerms(records, terms, settings.search).path(start)


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
    settings: AutoSettings,
) -> Narmax:
    """Estimate on all records the structure with the least error on held-out blocks.

    The candidates are the structure found with all data, and those found in the folds. The result of a search depends
    on the data, and a structure with poorly determined coefficients has a large error in other folds.
    """
    path = _path(stretches.records, stretches.output, terms, best.limits, settings)
    size = min(path, key=lambda k: (abs(k - best.n_terms), k))
    tried = (path[size].model, *best.found)
    errors = [_structure_error(model, stretches, terms, settings) for model in tried]
    model = replace(tried[int(np.argmin(errors))], notes=path[size].model.notes)
    model = refined(model, records, "simulation", "hac")
    note = (
        f"order {best.order}, degree {best.degree} and {len(model.terms)} terms have the least free-run error "
        "on held-out blocks"
    )
    return replace(model, notes=(*model.notes, note), stop="cv")


def _structure_error(
    model: Narmax, stretches: HiddenStretches, terms: Terms, settings: AutoSettings
) -> float:
    """Return the mean squared error of a structure on held-out blocks; inf if it diverges.

    The coefficients are estimated on the other samples of each fold.
    """
    squares = []
    for i, shown in enumerate(stretches.shown):
        try:
            there = FreeRunTerms(shown, terms, settings.search).minimised(model, model.theta, SHORT_DESCENT)
        except IdentError:
            return float("inf")
        squares.append(stretches.mean_square(there.model, i))
    return float(np.mean(squares))
