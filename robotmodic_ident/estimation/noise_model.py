"""Noise models: terms e(k-1), e(k-2), ... estimated together with the process terms, and how many are needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import NonlinearLeastSquares
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import NOISE_NAME
from robotmodic_ident.records import Record, lagged
from robotmodic_ident.selection.criteria import penalties
from robotmodic_ident.selection.process_terms import ProcessTermSelection
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats
from robotmodic_ident.validation.residual_tests import validate


@dataclass(frozen=True, kw_only=True)
class NoiseSearch:
    """How often terms and noise are fitted in turn, and how many noise lags are tried."""

    max_rounds: int = 8
    """Times that terms are chosen anew with the noise found so far; 2 or 3 are usual."""
    max_els_steps: int = 30
    """Of extended least squares; it ends where it gains nothing."""
    els_converged: float = 1e-10
    """Relative gain of such a step below which it ends."""
    max_lags: int = 8
    """[samples] noise lags that `auto` looks at."""
    patience: int = 2
    """Noise lags in a row that may fail to lower EBIC: of e(k-2) alone, the first one does not."""
    max_products: int = 3
    max_product_lag: int = 2
    """[samples] of the noise in products."""
    alarm: float = 0.05
    """p-value of the residual's test below which another lag is tried; the convention."""
    tested_lags: tuple[int, ...] = (10, 5, 2)
    """[samples] of that test; the largest that the data allow is taken."""


NOISE_SEARCH = NoiseSearch()


def noise_terms_of(noise: int | Terms) -> Terms:
    """Return e(k-1), ..., e(k-noise), or the terms given, each of which must hold a past e."""
    if isinstance(noise, int):
        return Terms.parse(*(f"{NOISE_NAME}(k-{lag})" for lag in range(1, noise + 1)))
    for term, name in zip(noise, noise.names, strict=True):
        if not any(f.variable == NOISE_NAME and f.lag for f in term):
            raise IdentError(f"noise term {name} holds no past {NOISE_NAME}, as {NOISE_NAME}(k-1) would be")
    return noise


def with_noise(selection: ProcessTermSelection, noise: Terms) -> Narmax:
    """Choose terms and noise coefficients in turn until the terms stay the same.

    Coloured noise makes terms of past outputs look needed. Once its coefficients are known, the prediction error is
    linear in the others, so terms are chosen anew among all candidates, each passed through the inverse of the noise
    filter. Returns the extended least squares of the last selection.
    """
    model = selection.select()
    for _ in range(NOISE_SEARCH.max_rounds):
        model = _extended_least_squares(model, selection.records, noise)
        chosen = selection.select_beside(_with_least_prediction_error(model, selection.records))
        if set(chosen.terms.names) == set(model.terms.names):
            return model
        model = chosen
    return replace(
        _extended_least_squares(model, selection.records, noise),
        notes=("terms and noise did not settle on each other; the last choice was kept",),
    )


def _with_least_prediction_error(model: Narmax, records: Sequence[Record]) -> Narmax:
    """Return the coefficients of least prediction error."""
    theta = NonlinearLeastSquares(model.recursion(), records).minimise(model.parameters).theta
    n = len(model.terms)
    return replace(model, theta=theta[:n], noise_theta=theta[n:])


def _noise_of(model: Narmax, records: Sequence[Record]) -> list[Floats]:
    """Return what the one-step prediction leaves of every record; 0 where it is not known."""
    return [np.nan_to_num(model.residuals(record), nan=0.0) for record in records]


def _extended_least_squares(model: Narmax, records: Sequence[Record], noise: Terms) -> Narmax:
    """Iterate least squares with the residuals of the last round as regressors; keep the best round."""
    n, size = len(model.terms), len(model.terms) + len(noise)
    terms = model.terms + noise
    best = replace(
        model,
        noise_terms=noise,
        noise_theta=np.zeros(len(noise)),
        covariance=np.zeros((size, size)),
        estimator="els",
    )
    problem = NonlinearLeastSquares(best.recursion(), records)
    least, *_ = problem.evaluate(best.parameters)
    for _ in range(NOISE_SEARCH.max_els_steps):
        rows = lagged(_with_signal(records, _noise_of(best, records)), terms, [model.output])
        known = np.isfinite(rows.targets[:, 0])
        phi = terms.matrix(rows.columns, model.scale, n=len(known))[known]
        theta = np.linalg.lstsq(phi, rows.targets[known, 0], rcond=None)[0]
        cost, *_ = problem.evaluate(theta)
        if not cost < least * (
            1.0 - NOISE_SEARCH.els_converged
        ):  # no better, or the noise model is not invertible
            break
        best, least = replace(best, theta=theta[:n], noise_theta=theta[n:]), cost
    return best


def _with_signal(records: Sequence[Record], noise: Sequence[Floats]) -> list[Record]:
    """Add the noise found so far to the signals of every record."""
    return [
        Record(signals={**r.signals, NOISE_NAME: e}, stamps=r.stamps, max_gap=r.max_gap)
        for r, e in zip(records, noise, strict=True)
    ]


def best_order(fitted: Callable[[int], Narmax], records: Sequence[Record], n_candidates: int) -> Narmax:
    """Return the model with as many noise lags as are needed: EBIC decides, as long as the residual is not white.

    What was tried stands in the notes of the model.

    Parameters
    ----------
    fitted : number of noise lags -> model
    n_candidates : process terms that were looked at
    """
    best = model = fitted(0)
    order, tried, count = 0, 0, model.n_samples
    least = _cost(model, count, n_candidates)
    for lag in range(1, NOISE_SEARCH.max_lags + 1):
        if lag - order > NOISE_SEARCH.patience or _is_white(model, records):
            break
        try:
            model = fitted(lag)
        except IdentError:  # records too short for one lag more
            break
        tried = lag
        if (cost := _cost(model, count, n_candidates)) < least:
            best, order, least = model, lag, cost
    note = f"noise lags: 0 to {tried} tried, {order} kept" if tried else "noise lags: none needed"
    if not _is_white(best, records):
        note += "; what is left is still correlated, and the next lags do not help"
    return replace(best, notes=(*best.notes, note))


def with_products(
    model: Narmax, fitted: Callable[[Terms], Narmax], records: Sequence[Record], n_candidates: int
) -> Narmax:
    """Add products of past noise and signals, `e(k-1)*u(k-1)`, while the tests ask for them and EBIC agrees.

    The variance of such noise changes with the signals, which no number of lags says.

    Parameters
    ----------
    fitted : noise terms -> model
    n_candidates : process terms that were looked at
    """
    least = _cost(model, model.n_samples, n_candidates)
    added: list[str] = []
    while len(added) < NOISE_SEARCH.max_products and not _is_white(model, records, with_inputs=True):
        candidates = _noise_products(model)
        if not len(candidates):
            break
        price = 2.0 * (len(added) + 1) * np.log(len(candidates) + len(added))
        name = _most_promising(model, candidates, records)
        try:
            larger = fitted(model.noise_terms + Terms.parse(name))
        except IdentError:
            break
        if not _cost(larger, model.n_samples, n_candidates) + price < least:
            break
        model, added, least = larger, [*added, name], _cost(larger, model.n_samples, n_candidates) + price
    return replace(model, notes=(*model.notes, f"noise products: {', '.join(added)}")) if added else model


def _noise_products(model: Narmax) -> Terms:
    """Return products of a past e with a past signal that the model reads, or with a past e, that it has not yet."""
    groups = (model.terms, model.denominator)
    read = [
        f.signal
        for terms in groups
        for term in terms
        for f in term
        if f.lag and not f.function and f.lag <= 2
    ]
    inputs = {v for terms in groups for v in terms.variables if v != model.output}
    signals = dict.fromkeys([*read, f"{model.output}(k-1)", *(f"{name}(k-1)" for name in sorted(inputs))])
    past = [f"{NOISE_NAME}(k-{lag})" for lag in range(1, NOISE_SEARCH.max_product_lag + 1)]
    names = [f"{signal}*{e}" for signal in signals for e in past]
    names += [f"{e}*{other}" for i, e in enumerate(past) for other in past[i + 1 :]]
    have = {frozenset(term) for term in model.noise_terms}
    return Terms(tuple(term for term in Terms.parse(*names) if frozenset(term) not in have))


def _most_promising(model: Narmax, candidates: Terms, records: Sequence[Record]) -> str:
    """Return the candidate that a Gauss-Newton step would take most off the residual with."""
    noise = model.noise_terms + candidates
    theta = np.r_[model.noise_theta, np.zeros(len(candidates))]
    n = len(model.terms) + len(model.denominator) + len(noise)
    full = replace(model, noise_terms=noise, noise_theta=theta, covariance=np.zeros((n, n)))
    gains = NonlinearLeastSquares(full.recursion(), records).gains(
        full.parameters, np.arange(n)[-len(candidates) :]
    )
    return candidates.names[int(gains.argmax())]


def _cost(model: Narmax, count: int, n_candidates: int) -> float:
    """Return EBIC over `count` rows, the same for all numbers of lags; a noise lag costs log(count)."""
    k = len(model.terms)
    price = penalties("ebic", k, n_candidates, np.array([count]))[0, k] + len(model.noise_terms) * np.log(
        count
    )
    free = max(model.n_samples - len(model.parameters), 1)
    variance = model.sigma**2 * free / max(model.n_samples, 1)
    return float(count * np.log(max(variance, np.finfo(np.float64).tiny)) + price)


def _is_white(model: Narmax, records: Sequence[Record], *, with_inputs: bool = False) -> bool:
    """Tell whether the correlation test finds nothing in the residual; also none in it times past inputs or outputs."""
    inputs: tuple[str, ...] = ()
    if with_inputs:
        groups = (model.terms, model.denominator)
        inputs = tuple(dict.fromkeys(v for terms in groups for v in terms.variables))
    for max_lag in NOISE_SEARCH.tested_lags:
        try:
            checks = validate(model, records, max_lag=max_lag, inputs=inputs)
        except IdentError:
            continue
        asked = [c.p_value for c in checks if c.test.startswith("e-e")]
        return min(asked) >= NOISE_SEARCH.alarm / len(asked)
    return True
