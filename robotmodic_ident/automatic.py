"""`auto_fit`: a model for free run without settings; lags, degree, terms and limits are chosen by cross-validation.

The output of one stretch after another is hidden: terms are searched by the simulation error of the rest, and models of
every size run free through what is hidden, which needs its inputs alone. What does best there decides; then the search
is repeated with nothing hidden.
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
    """The model of `auto_fit`, and what was tried on the way."""

    model: Narmax
    chosen: Trial
    trials: tuple[Trial, ...]

    def __repr__(self) -> str:
        return (
            f"{self.model!r}\n  chosen among {len(self.trials)} dictionaries: order {self.chosen.order}, degree "
            f"{self.chosen.degree}, {self.chosen.n_terms} terms; free run on stretches left out: RMSE {self.chosen.rmse:.4g}"
        )


def auto_fit(
    records: Records, output: str, inputs: Sequence[str] = (), *, settings: AutoSettings = AUTO
) -> AutoFit:
    """Identify one output for free run; no lag, degree or number of terms need be given.

    Parameters
    ----------
    records : training data; nothing else is looked at
    inputs : signals that drive the output, read from lag 0 on

    Raises
    ------
    IdentError
        if the records are too short, a signal is missing, several outputs are given, or no model runs free without
        diverging
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
            f"no model of {output} runs free over the stretches left out without diverging; give longer records, or "
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
    """Return the orders worth a search of products, by what linear models say, which are cheap at all of them.

    The first is the least that none longer beats by far, and everywhere, in free run: at too short lags products fit what is not there.
    The last is the one beyond which the one-step error hardly falls: it feels dynamics that the free run of a linear
    model, blind to the nonlinear part, does not; but noise of the output, too, which asks for more lags than there are.
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
    """Return the mean square on every hidden stretch of the linear model of least simulation error on the rest."""
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
    """Return what does best at one order; also whether the output is held between limits."""
    first, *others = settings.degrees
    best = tried(order, first, limits)
    if limits != UNLIMITED:
        free = tried(order, first, UNLIMITED)
        best = best if best.rmse < free.rmse * (1.0 - settings.min_limit_gain) else free
    for degree in others:
        best = min(best, tried(order, degree, best.limits), key=lambda one: one.rmse)
    return best


def _searched(records: Sequence[Record], settings: AutoSettings) -> list[Record]:
    """Return the records, or pieces spread evenly over each where they are too long to search."""
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
    """Hide one stretch of every record after another; return the least size that does as well there as the best.

    That is within one standard error over the stretches (Breiman et al. 1984, sec. 3.4.3).
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
            elif size > min(path):  # it gained nothing by that many terms
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
    """Search from the linear model on."""
    start = _linear_start(records, output, terms, limits)
    return FreeRunTerms(records, terms, settings.search).path(start)


def _linear_start(
    records: Sequence[Record], output: str, terms: Terms, limits: tuple[float, float]
) -> Narmax:
    """Return the linear model of least one-step error."""
    linear = linear_part(terms)
    return fit(records, output, linear, n_terms=len(linear), search="forward", limits=limits)


def _final(
    stretches: HiddenStretches,
    records: Sequence[Record],
    terms: Terms,
    best: Trial,
    settings: AutoSettings,
) -> Narmax:
    """Estimate on all records the structure that does best on stretches left out.

    Compared are what is found with nothing hidden, and what every fold found: where a search ends hangs on the data,
    and a structure whose coefficients the data do not determine shows in other folds.
    """
    path = _path(stretches.records, stretches.output, terms, best.limits, settings)
    size = min(path, key=lambda k: (abs(k - best.n_terms), k))
    tried = (path[size].model, *best.found)
    errors = [_structure_error(model, stretches, terms, settings) for model in tried]
    model = replace(tried[int(np.argmin(errors))], notes=path[size].model.notes)
    model = refined(model, records, "simulation", "hac")
    note = f"order {best.order}, degree {best.degree} and {len(model.terms)} terms do best in free run on stretches left out"
    return replace(model, notes=(*model.notes, note), stop="cv")


def _structure_error(
    model: Narmax, stretches: HiddenStretches, terms: Terms, settings: AutoSettings
) -> float:
    """Return the mean square on hidden stretches of a model's terms, estimated on the rest; inf where it diverges."""
    squares = []
    for i, shown in enumerate(stretches.shown):
        try:
            there = FreeRunTerms(shown, terms, settings.search).minimised(model, model.theta, SHORT_DESCENT)
        except IdentError:
            return float("inf")
        squares.append(stretches.mean_square(there.model, i))
    return float(np.mean(squares))
