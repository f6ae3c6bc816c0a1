"""Noise models: y = Φ theta + Ψ(e) noise_theta + e, with noise terms Ψ of past residuals e(k-1), e(k-2), ...

Extended least squares (Billings 2013, ch. 3) alternates two steps. The residuals e = y - ŷ of the last round give the
columns Ψ(e), and least squares on [Φ, Ψ(e)] gives new coefficients. The number of noise lags is selected by EBIC and by
correlation tests of the residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import NonlinearLeastSquares
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import NOISE_NAME
from robotmodic_ident.records import Record, lagged
from robotmodic_ident.selection.criteria import CONVERGED, MAX_STEPS, PATIENCE, penalties
from robotmodic_ident.selection.process_terms import ProcessTermSelection
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats
from robotmodic_ident.validation.residual_tests import validate

MAX_ROUNDS = 8
"""Maximum number of alternations between selecting process terms and estimating the noise; 2 or 3 are usual."""
MAX_LAGS = 8
"""[samples] maximum noise lag for `auto`."""
MAX_PRODUCTS = 3
"""Maximum number of products of noise and signals."""
MAX_PRODUCT_LAG = 2
"""[samples] maximum lag of the noise in products."""
ALARM = 0.05
"""p-value of the residual test below which another lag is tried; the usual convention."""
TESTED_LAGS = (10, 5, 2)
"""[samples] maximum lags of that test; the first that the number of samples permits is used."""


def noise_terms_of(noise: int | Terms) -> Terms:
    """Return e(k-1), ..., e(k-noise), or the given terms, each of which must contain a past e."""
    if isinstance(noise, int):
        return Terms.parse(*(f"{NOISE_NAME}(k-{lag})" for lag in range(1, noise + 1)))
    for term, name in zip(noise, noise.names, strict=True):
        if not any(f.variable == NOISE_NAME and f.lag for f in term):
            raise IdentError(
                f"noise term {name} holds no past {NOISE_NAME}; expected a factor like {NOISE_NAME}(k-1)"
            )
    return noise


def with_noise(selection: ProcessTermSelection, noise: Terms) -> Narmax:
    """Alternate between selecting process terms and estimating the noise coefficients until the terms are constant.

    Coloured noise makes unnecessary terms of past outputs appear significant. With known noise coefficients, the
    prediction error is linear in the process coefficients. All candidate terms, filtered by the inverse noise model,
    then enter a new selection. The result is the extended least squares estimate of the last selection.
    """
    model = selection.select()
    for _ in range(MAX_ROUNDS):
        model = _extended_least_squares(model, selection.records, noise)
        chosen = selection.select_with_noise(_with_least_prediction_error(model, selection.records))
        if set(chosen.terms.names) == set(model.terms.names):
            return model
        model = chosen
    return replace(
        _extended_least_squares(model, selection.records, noise),
        notes=(
            "the alternation of term selection and noise estimation did not converge; the last result was kept",
        ),
    )


def _with_least_prediction_error(model: Narmax, records: Sequence[Record]) -> Narmax:
    """Return the model with the coefficients of least prediction error."""
    theta = NonlinearLeastSquares(model.recursion(), records).minimise(model.parameters).theta
    n = len(model.terms)
    return replace(model, theta=theta[:n], noise_theta=theta[n:])


def _noise_of(model: Narmax, records: Sequence[Record]) -> list[Floats]:
    """Return the one-step residuals of every record; 0 if unknown."""
    return [np.nan_to_num(model.residuals(record), nan=0.0) for record in records]


def _extended_least_squares(model: Narmax, records: Sequence[Record], noise: Terms) -> Narmax:
    """Iterate least squares with the residuals of the last step as regressors; return the best step."""
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
    for _ in range(MAX_STEPS):
        rows = lagged(_with_signal(records, _noise_of(best, records)), terms, [model.output])
        known = np.isfinite(rows.targets[:, 0])
        phi = terms.matrix(rows.columns, model.scale, n=len(known))[known]
        theta = np.linalg.lstsq(phi, rows.targets[known, 0], rcond=None)[0]
        cost, *_ = problem.evaluate(theta)
        if not cost < least * (1.0 - CONVERGED):  # no gain, or the noise model is not invertible
            break
        best, least = replace(best, theta=theta[:n], noise_theta=theta[n:]), cost
    return best


def _with_signal(records: Sequence[Record], noise: Sequence[Floats]) -> list[Record]:
    """Add the estimated noise to the signals of every record."""
    return [
        Record(signals={**r.signals, NOISE_NAME: e}, stamps=r.stamps, max_gap=r.max_gap)
        for r, e in zip(records, noise, strict=True)
    ]


def best_order(fitted: Callable[[int], Narmax], records: Sequence[Record], n_candidates: int) -> Narmax:
    """Return the model with the number of noise lags of least EBIC; lags are tried while the residual is not white.

    The notes of the model list the trials.

    Parameters
    ----------
    fitted : function from the number of noise lags to the model
    n_candidates : number of candidate process terms
    """
    best = model = fitted(0)
    order, tried, count = 0, 0, model.n_samples
    least = _cost(model, count, n_candidates)
    for lag in range(1, MAX_LAGS + 1):
        if lag - order > PATIENCE or _is_white(model, records):
            break
        try:
            model = fitted(lag)
        except IdentError:  # records too short for another lag
            break
        tried = lag
        if (cost := _cost(model, count, n_candidates)) < least:
            best, order, least = model, lag, cost
    note = f"noise lags: 0 to {tried} tried, {order} kept" if tried else "noise lags: none needed"
    if not _is_white(best, records):
        note += "; the residual is still correlated, and further lags do not help"
    return replace(best, notes=(*best.notes, note))


def with_products(
    model: Narmax, fitted: Callable[[Terms], Narmax], records: Sequence[Record], n_candidates: int
) -> Narmax:
    """Add products of past noise and signals, such as `e(k-1)*u(k-1)`, while tests require and EBIC accepts them.

    The variance of such noise depends on the signals, which lags of e alone cannot describe.

    Parameters
    ----------
    fitted : function from noise terms to the model
    n_candidates : number of candidate process terms
    """
    least = _cost(model, model.n_samples, n_candidates)
    added: list[str] = []
    while len(added) < MAX_PRODUCTS and not _is_white(model, records, with_inputs=True):
        candidates = _noise_products(model)
        if not len(candidates):
            break
        penalty = 2.0 * (len(added) + 1) * np.log(len(candidates) + len(added))
        name = _most_promising(model, candidates, records)
        try:
            larger = fitted(model.noise_terms + Terms.parse(name))
        except IdentError:
            break
        if not _cost(larger, model.n_samples, n_candidates) + penalty < least:
            break
        model, added, least = larger, [*added, name], _cost(larger, model.n_samples, n_candidates) + penalty
    return replace(model, notes=(*model.notes, f"noise products: {', '.join(added)}")) if added else model


def _noise_products(model: Narmax) -> Terms:
    """Return new products of a past e with a past signal of the model or with another past e."""
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
    past = [f"{NOISE_NAME}(k-{lag})" for lag in range(1, MAX_PRODUCT_LAG + 1)]
    names = [f"{signal}*{e}" for signal in signals for e in past]
    names += [f"{e}*{other}" for i, e in enumerate(past) for other in past[i + 1 :]]
    have = {frozenset(term) for term in model.noise_terms}
    return Terms(tuple(term for term in Terms.parse(*names) if frozenset(term) not in have))


def _most_promising(model: Narmax, candidates: Terms, records: Sequence[Record]) -> str:
    """Return the candidate whose Gauss-Newton step lowers the sum of squares most."""
    noise = model.noise_terms + candidates
    theta = np.r_[model.noise_theta, np.zeros(len(candidates))]
    n = len(model.terms) + len(model.denominator) + len(noise)
    full = replace(model, noise_terms=noise, noise_theta=theta, covariance=np.zeros((n, n)))
    gains = NonlinearLeastSquares(full.recursion(), records).gains(
        full.parameters, np.arange(n)[-len(candidates) :]
    )
    return candidates.names[int(gains.argmax())]


def _cost(model: Narmax, count: int, n_candidates: int) -> float:
    """Return EBIC over `count` rows, the same for all numbers of lags; the penalty of a noise term is log(count)."""
    k = len(model.terms)
    penalty = penalties("ebic", k, n_candidates, np.array([count]))[0, k] + len(model.noise_terms) * np.log(
        count
    )
    free = max(model.n_samples - len(model.parameters), 1)
    variance = model.sigma**2 * free / max(model.n_samples, 1)
    return float(count * np.log(max(variance, np.finfo(np.float64).tiny)) + penalty)


def _is_white(model: Narmax, records: Sequence[Record], *, with_inputs: bool = False) -> bool:
    """Return whether a correlation test finds no structure in the residual.

    `with_inputs` also tests the residual against products of past residuals and past inputs or outputs.
    """
    inputs: tuple[str, ...] = ()
    if with_inputs:
        groups = (model.terms, model.denominator)
        inputs = tuple(dict.fromkeys(v for terms in groups for v in terms.variables))
    for max_lag in TESTED_LAGS:
        try:
            checks = validate(model, records, max_lag=max_lag, inputs=inputs)
        except IdentError:
            continue
        p_values = [c.p_value for c in checks if c.test.startswith("e-e")]
        return min(p_values) >= ALARM / len(p_values)
    return True
