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

from robotmodic_ident.bases import polynomial
from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import LevenbergMarquardt
from robotmodic_ident.fitting import fit, refined
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import Record, Records, as_records, cut, lags
from robotmodic_ident.selection.free_run_terms import (
    FREE_RUN_SEARCH,
    SHORT_DESCENT,
    FreeRunSearch,
    FreeRunTerms,
    Simulated,
)
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class AutoSettings:
    """What `auto_fit` looks at."""

    orders: tuple[int, ...] = (2, 3, 4, 6)
    """[samples] lags of output and inputs; after the first, until `patience` of them in a row do no better."""
    patience: int = 2
    min_order_gain: float = 0.2
    """Relative fall of the error that longer lags must bring: the spread over folds of sets of some 1,000 samples."""
    degrees: tuple[int, ...] = (2, 3, 1)
    """All are tried at the first order, the best one at the others."""
    max_product_lag: int = 3
    """[samples] of signals in terms of degree 2 and more; longer lags are linear."""
    n_folds: int = 5
    min_whole_gain: float = 0.2
    """Relative fall of the error over whole records that speaks for another model than the one that pieces chose."""
    max_rows: int = 3_000
    """Samples among which terms are searched, in pieces spread over the records; all are fitted in the end."""
    n_pieces: int = 4
    warm_up: int = 50
    """[samples] at the start of a record that are never hidden: from there a free run starts."""
    max_warm_up_share: float = 0.25
    """Of a record, where it is short."""
    min_limit_gain: float = 0.02
    """Relative fall of the error that holding the output between limits must bring to be kept."""
    search: FreeRunSearch = FREE_RUN_SEARCH


AUTO = AutoSettings()
MIN_AT_LIMIT = 5
"""Samples that lie exactly at a limit at least."""
NEAR_VALUES = 10
"""Distinct values next to a limit that it is compared with."""
LIMIT_RATIO = 5
"""Times that a limit comes more often than any value near it: levels of a quantised output come about equally often."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One dictionary, cross-validated."""

    order: int
    """[samples]"""
    degree: int
    limits: tuple[float, float]
    """[units of the output]"""
    n_candidates: int
    n_terms: int
    """Least size that does as well as the best on stretches left out."""
    rmse: float
    """[units of the output] of the free run there; inf where no size ran to the end on all of them."""
    found: tuple[Narmax, ...] = ()
    """The model of that size of every fold."""


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
        if the records are too short, a signal is missing, or no model runs free without diverging
    """
    records = as_records(records)
    searched = _searched(records, settings)
    trials: list[Trial] = []

    def tried(order: int, degree: int, limits: tuple[float, float]) -> Trial:
        terms = dictionary(output, inputs, order, degree, settings)
        trial = _cross_validated(searched, output, terms, order, degree, limits, settings)
        logger.info("order %d, degree %d: %d terms, RMSE %.4g", order, degree, trial.n_terms, trial.rmse)
        trials.append(trial)
        return trial

    best = _best_degree(tried, output_limits(records, output), settings)
    idle = 0
    for order in settings.orders[1:]:
        if idle == settings.patience:
            break
        now = tried(order, best.degree, best.limits)
        is_better = now.rmse < best.rmse * (1.0 - settings.min_order_gain)
        best, idle = (now, 0) if is_better else (best, idle + 1)
    if not np.isfinite(best.rmse):
        raise IdentError(
            f"no model of {output} runs free over the stretches left out without diverging; give longer records, or "
            "fit one step ahead"
        )
    terms = dictionary(output, inputs, best.order, best.degree, settings)
    model = _final(searched, records, output, terms, best, settings)
    if len(searched) != len(records) or sum(map(len, searched)) != sum(map(len, records)):
        model, best = _over_whole_records(
            model, best, [*trials, _linear(records, best, inputs, settings)], records, settings
        )
    return AutoFit(model=model, chosen=best, trials=tuple(trials))


def dictionary(output: str, inputs: Sequence[str], order: int, degree: int, settings: AutoSettings) -> Terms:
    """Return the candidates: all signals up to lag `order`, and products of those up to `max_product_lag`."""
    near = min(order, settings.max_product_lag)
    products = lags(output, 1, near)
    linear = lags(output, 1, order)
    for name in inputs:
        products += lags(name, 0, near)
        linear += lags(name, 0, order)
    return polynomial(linear, 1) + polynomial(products, degree)


def output_limits(records: Records, output: str) -> tuple[float, float]:
    """Return the values between which an output seems to be held; infinite where there is no such limit.

    A limit shows as one value, the largest or least of all, that comes far more often than any near it: a full tank,
    the end of a travel, the range of a converter.
    """
    parts = [np.asarray(record.signals[output], dtype=np.float64) for record in as_records(records)]
    known = np.concatenate([part[np.isfinite(part)] for part in parts])
    if len(known) == 0 or np.ptp(known) == 0:
        return UNLIMITED
    return -_upper_limit(-known), _upper_limit(known)


def _upper_limit(values: Floats) -> float:
    distinct, counts = np.unique(values, return_counts=True)
    near = int(counts[-1 - NEAR_VALUES : -1].max(initial=1))
    return float(distinct[-1]) if counts[-1] >= max(MIN_AT_LIMIT, LIMIT_RATIO * near) else float("inf")


def _best_degree(
    tried: Callable[[int, int, tuple[float, float]], Trial],
    limits: tuple[float, float],
    settings: AutoSettings,
) -> Trial:
    """Return what does best at the first order; also whether the output is held between limits."""
    order, (first, *others) = settings.orders[0], settings.degrees
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
    records: Sequence[Record],
    output: str,
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
    for i in range(settings.n_folds):
        hidden = [_stretch(len(record), i, settings) for record in records]
        shown = [_hidden(record, output, rows) for record, rows in zip(records, hidden, strict=True)]
        try:
            path = _path(shown, output, terms, limits, settings)
        except IdentError:
            continue
        paths.append(path)
        for size in range(1, most + 1):
            if size in path:
                errors[i, size] = _mean_square(path[size].model, records, shown, hidden, settings)
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
        found=tuple(path[size].model for path in paths if size in path),
    )


def _warm_up(n: int, settings: AutoSettings) -> int:
    return min(settings.warm_up, int(settings.max_warm_up_share * n))


def _stretch(n: int, fold: int, settings: AutoSettings) -> slice:
    """Return the samples of a record of n that one fold hides."""
    edges = np.linspace(_warm_up(n, settings), n, settings.n_folds + 1).round().astype(int)
    return slice(int(edges[fold]), int(edges[fold + 1]))


def _hidden(record: Record, output: str, rows: slice) -> Record:
    values = np.array(record.signals[output], dtype=np.float64)
    values[rows] = np.nan
    return replace(record, signals={**record.signals, output: values})


def _path(
    records: Sequence[Record],
    output: str,
    terms: Terms,
    limits: tuple[float, float],
    settings: AutoSettings,
) -> dict[int, Simulated]:
    """Search from the linear model on."""
    linear = Terms(tuple(term for term in terms if sum(f.power for f in term) <= 1))
    start = fit(records, output, linear, n_terms=len(linear), search="forward", limits=limits)
    return FreeRunTerms(records, terms, settings.search).path(start)


def _mean_square(
    model: Narmax,
    records: Sequence[Record],
    shown: Sequence[Record],
    hidden: Sequence[slice],
    settings: AutoSettings,
) -> float:
    """Return the mean square of the free run's residual over what is hidden; inf where it ends early."""
    squares: list[Floats] = []
    for record, part, rows in zip(records, shown, hidden, strict=True):
        measured = np.asarray(record.signals[model.output], dtype=np.float64)[rows]
        predicted = model.predict_mpo(part, warm_up=_warm_up(len(record), settings))[rows]
        with np.errstate(over="ignore"):
            squares.append(np.nan_to_num((measured - predicted)[np.isfinite(measured)] ** 2, nan=np.inf))
    whole = np.concatenate(squares)
    return float(whole.mean()) if len(whole) else float("inf")


def _final(
    searched: Sequence[Record],
    records: Sequence[Record],
    output: str,
    terms: Terms,
    best: Trial,
    settings: AutoSettings,
) -> Narmax:
    """Estimate on all records the structure that does best on stretches left out.

    Compared are what is found with nothing hidden, and what every fold found: where a search ends hangs on the data,
    and a structure whose coefficients the data do not determine shows in other folds.
    """
    path = _path(searched, output, terms, best.limits, settings)
    size = min(path, key=lambda k: (abs(k - best.n_terms), k))
    tried = (path[size].model, *best.found)
    errors = [_structure_error(model, searched, terms, settings) for model in tried]
    model = replace(tried[int(np.argmin(errors))], notes=path[size].model.notes)
    model = refined(model, records, "simulation", "hac")
    note = f"order {best.order}, degree {best.degree} and {len(model.terms)} terms do best in free run on stretches left out"
    return replace(model, notes=(*model.notes, note), stop="cv")


def _linear(records: Sequence[Record], best: Trial, inputs: Sequence[str], settings: AutoSettings) -> Trial:
    """Return linear models estimated in free run over one long stretch at the start of every record."""
    share = 2 * settings.max_rows / sum(map(len, records))
    heads = [cut(record, slice(0, int(share * len(record)) + 1)) for record in records]
    output = best.found[0].output
    found = []
    for order in dict.fromkeys((settings.orders[0], best.order)):
        terms = dictionary(output, inputs, order, 1, settings)
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


def _over_whole_records(
    model: Narmax, best: Trial, trials: Sequence[Trial], records: Sequence[Record], settings: AutoSettings
) -> tuple[Narmax, Trial]:
    """Return the model, or one found on the way that runs free over whole records far better.

    What is searched in pieces of a long record says nothing of how far a free run drifts over all of it, as that of
    an integrating output does.
    """

    def error(one: Narmax) -> float:
        whole = [slice(_warm_up(len(record), settings), None) for record in records]
        return _mean_square(one, records, records, whole, settings)

    others = [(error(one), one, trial) for trial in trials for one in trial.found]
    least, other, trial = min(others, key=lambda found: found[0], default=(np.inf, model, best))
    if not least < (1.0 - settings.min_whole_gain) ** 2 * error(model):
        return model, best
    descended = refined(other, records, "simulation", "hac")
    stay = LevenbergMarquardt(max_steps=0)
    kept = descended if error(descended) < least else refined(other, records, "simulation", "hac", stay)
    note = f"of the models found it drifts least in free run over whole records: order {trial.order}, degree {trial.degree}"
    return replace(kept, notes=(*kept.notes, note), stop="cv"), replace(trial, rmse=float(np.sqrt(least)))


def _structure_error(model: Narmax, records: Sequence[Record], terms: Terms, settings: AutoSettings) -> float:
    """Return the mean square on hidden stretches of a model's terms, estimated on the rest; inf where it diverges."""
    squares = []
    for i in range(settings.n_folds):
        hidden = [_stretch(len(record), i, settings) for record in records]
        shown = [_hidden(record, model.output, rows) for record, rows in zip(records, hidden, strict=True)]
        try:
            there = FreeRunTerms(shown, terms, settings.search).minimised(model, model.theta, SHORT_DESCENT)
        except IdentError:
            return float("inf")
        squares.append(_mean_square(there.model, records, shown, hidden, settings))
    return float(np.mean(squares))
