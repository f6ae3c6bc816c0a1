"""Correlation tests of the residuals, of first and higher order, with correct significance levels.

Each test correlates the residual e(k) with a past quantity z(k - lag): e, an input u, u² or e u (Billings and Voon
1986). Z (n, n_lags) contains the lagged z, and M projects onto the complement of the gradients of the model.

* The score is `Z'M e`, with the covariance `V = sigma² Z'M Z`.
* The statistic `score' V⁻¹ score` is chi-squared with n_lags degrees of freedom (Lagrange multiplier test: Breusch
  1978, Godfrey 1978).

The projection accounts for the correlation that the fit has already removed. Without it, bounds of 1.96 / sqrt(n) are
too wide at small lags. For tests of e², M only removes the mean.

On other records, M is the identity, and the residual e - G d contains the errors d of the coefficients, with G the gradients
and C the covariance of d. They widen the bounds: `V = sigma² Z'Z + Z'G C G'Z`. In tests of e², d adds tr(A C) to the score
and 2 tr(A C A C) to its variance, with `A = G' diag(z) G` at each lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import NonlinearLeastSquares
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import Segment
from robotmodic_ident.records import Record, Records, as_records
from robotmodic_ident.scale import size_of
from robotmodic_ident.types import Floats

Z_95 = 1.959964


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTest:
    """One test of the residuals over several lags."""

    test: str
    """`e-e`, `e-u`, `e-u^2`, `e-eu` or `e^2-u^2`, with the name of the input for u."""
    lags: NDArray[np.int64]
    """(n_lags,) [samples]"""
    correlation: Floats
    """(n_lags,)"""
    bound: Floats
    """(n_lags,) 95 % bound of the correlation under the null hypothesis."""
    statistic: float
    """Statistic of all lags together, chi-squared with as many degrees of freedom as independent lags."""
    p_value: float
    n: int
    """Number of residuals."""

    @property
    def alarms(self) -> NDArray[np.int64]:
        """Lags whose correlation exceeds its bound; 5 % of the lags exceed it by chance."""
        return self.lags[np.abs(self.correlation) > self.bound]


def validate(
    model: Narmax,
    records: Records,
    *,
    max_lag: int = 20,
    inputs: Sequence[str] | None = None,
    fitted: bool = True,
) -> list[ResidualTest]:
    """Test the one-step residuals of a model on records.

    Parameters
    ----------
    max_lag : [samples]
    inputs : Signals to test against; None: those of the model.
    fitted : Whether the model was fitted on these records; on others, the errors of its coefficients widen the bounds.

    Raises
    ------
    IdentError
        If a signal is missing, or there are too few residuals for `max_lag` lags.
    """
    records = as_records(records)
    if inputs is None:
        groups = (model.terms, model.denominator, model.noise_terms)
        seen = dict.fromkeys(v for terms in groups for v in terms.variables)
        inputs = [v for v in seen if v not in (model.output, "e")]
    if missing := [v for v in inputs if any(v not in r.signals for r in records)]:
        raise IdentError(
            f"no signal {', '.join(missing)} in every record; the first record has {', '.join(records[0].signals)}"
        )
    past = _ResidualData(model, records, max_lag)
    ahead, from_now = np.arange(1, max_lag + 1), np.arange(max_lag + 1)
    checks = [past.check("e-e", ahead, past.known, fitted)]
    for name in inputs:
        u = past.signal(name)
        squares = [_centred(v**2) for v in u]
        checks += [
            past.check(f"e-{name}", from_now, u, fitted),
            past.check(f"e-{name}^2", from_now, squares, fitted),
            past.check(f"e-e{name}", ahead, [a * b for a, b in zip(past.known, u, strict=True)], fitted),
            past.check(f"e^2-{name}^2", from_now, squares, fitted, of_squares=True),
        ]
    return checks


def false_discoveries(p_values: ArrayLike, rate: float = 0.05) -> NDArray[np.bool_]:
    """Return which of many tests are significant at a false discovery rate of `rate` (Benjamini and Hochberg 1995).

    The result has the shape of p_values; nan is never significant.
    """
    p = np.asarray(p_values, dtype=np.float64)
    flat = np.where(np.isnan(p), np.inf, p).ravel()
    count = int(np.isfinite(flat).sum())
    order = np.argsort(flat)
    below = flat[order] <= rate * np.arange(1, len(flat) + 1) / max(count, 1)
    limit = flat[order][below].max() if below.any() else -1.0
    return np.asarray((flat <= limit).reshape(p.shape), dtype=np.bool_)


class _ResidualData:
    """Residuals, gradients and signals of all segments, row by row."""

    def __init__(self, model: Narmax, records: Sequence[Record], max_lag: int) -> None:
        self.max_lag = max_lag
        self.covariance = model.covariance
        problem = NonlinearLeastSquares(model.recursion(), records)
        _, self.e, self.gradients = problem.evaluate(model.parameters, gradient=True)
        self.rows = problem.rows
        unit = size_of(*self.e)
        self.known = [np.where(rows, e / unit, np.nan) for e, rows in zip(self.e, self.rows, strict=True)]
        self.source = [r for r in records for _ in r.segments()]
        self.segments: list[Segment] = problem.segments
        if problem.count <= len(model.parameters) + 2 * max_lag + 1:
            raise IdentError(
                f"{problem.count} residuals are too few to test {max_lag} lags with {len(model.parameters)} "
                "coefficients; use a smaller max_lag or longer records"
            )

    def signal(self, name: str) -> list[Floats]:
        """Return a signal over every segment, scaled to unit size and without its mean; nan if unknown."""
        parts = [
            np.asarray(record.signals[name], dtype=np.float64)[segment.piece]
            for record, segment in zip(self.source, self.segments, strict=True)
        ]
        whole = np.concatenate(parts)
        unit = size_of(whole[np.isfinite(whole)])
        mean = np.nanmean(whole / unit)
        return [part / unit - mean for part in parts]

    def check(
        self,
        test: str,
        lags: NDArray[np.int64],
        past: Sequence[Floats],
        fitted: bool,
        *,
        of_squares: bool = False,
    ) -> ResidualTest:
        """Test e, or e² minus its mean, against `past` at every lag."""
        targets, regressors, nuisance = [], [], []
        for e, z, g, rows in zip(self.e, past, self.gradients, self.rows, strict=True):
            delayed = np.full((len(e), len(lags)), np.nan)
            for j, lag in enumerate(lags.tolist()):
                delayed[lag:, j] = z[: max(len(z) - lag, 0)] if lag else z
            use = rows & np.isfinite(delayed).all(axis=1)
            targets.append(e[use])
            regressors.append(delayed[use])
            nuisance.append(g[use])
        target, unit = _unit_scaled(np.concatenate(targets))
        Z, _ = _unit_scaled(np.concatenate(regressors))
        G = np.concatenate(nuisance)
        n = len(target)
        if n <= len(lags) + 1:
            raise IdentError(f"test {test}: only {n} rows have {lags[-1]} known lags; use a smaller max_lag")
        if of_squares:
            target = target**2 - np.mean(target**2)
        free = Z - Z.mean(axis=0) if of_squares else Z
        if fitted and not of_squares:
            basis = _orthonormal(G)
            free = Z - basis @ (basis.T @ Z)
        used = self.gradients[0].shape[1] if fitted else 0
        shift, spread = np.zeros(len(lags)), np.zeros((len(lags), len(lags)))
        if not fitted:
            shift, spread = _coefficient_errors(free, unit * G, self.covariance, of_squares)
        return _test_result(test, lags, target, Z, free, used, shift, spread)


def _test_result(
    test: str,
    lags: NDArray[np.int64],
    target: Floats,
    Z: Floats,
    free: Floats,
    used: int,
    shift: Floats,
    spread: Floats,
) -> ResidualTest:
    """Correlate the target with Z (n, n_lags).

    Parameters
    ----------
    free : (n, n_lags) M Z, the part of Z that is orthogonal to the gradients
    used : number of estimated parameters
    shift, spread : mean (n_lags,) and covariance (n_lags, n_lags) of the score due to errors of the coefficients
    """
    n = len(target)
    variance = float(np.sum(target**2)) / max(n - used, 1)
    size = np.sqrt((Z**2).sum(axis=0) * n * variance)
    size[size == 0] = 1.0
    score = free.T @ target - shift
    V = variance * (free.T @ free) + spread
    root = np.sqrt(np.diagonal(V))
    scale = np.where(root > 1e-9 * np.sqrt(variance * (Z**2).sum(axis=0)), root, np.inf)
    values, vectors = np.linalg.eigh(V / np.outer(scale, scale))
    seen = values > 1e-9 * max(values[-1], 1e-300)
    part = vectors[:, seen].T @ (score / scale)
    statistic = float((part**2 / values[seen]).sum())
    return ResidualTest(
        test=test,
        lags=lags,
        correlation=score / size,
        bound=Z_95 * root / size,
        statistic=statistic,
        p_value=float(chdtrc(max(int(seen.sum()), 1), statistic)),
        n=n,
    )


def _coefficient_errors(Z: Floats, G: Floats, C: Floats, of_squares: bool) -> tuple[Floats, Floats]:
    """Return the mean (n_lags,) and the covariance (n_lags, n_lags) of what errors of the coefficients add to the score.

    Parameters
    ----------
    Z : (n, n_lags) regressors
    G : (n, n_parameters) gradients of the prediction
    C : (n_parameters, n_parameters) covariance of the coefficients
    """
    if not of_squares:
        moved = Z.T @ G
        return np.zeros(Z.shape[1]), moved @ C @ moved.T
    AC = np.array([(G.T * z) @ G @ C for z in Z.T])
    return np.trace(AC, axis1=1, axis2=2), 2.0 * np.einsum("lij,mji->lm", AC, AC)


def _unit_scaled(z: Floats) -> tuple[Floats, Floats]:
    """Return each column scaled by a power of two, which is exact and prevents the overflow of squares; and the factors."""
    exponent = -np.frexp(np.abs(z).max(axis=0, initial=0.0))[1]
    return np.asarray(np.ldexp(z, exponent)), np.asarray(np.ldexp(1.0, exponent))


def _orthonormal(G: Floats) -> Floats:
    size = np.sqrt((G**2).sum(axis=0))
    U, s, _ = np.linalg.svd(G / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(U[:, s > 1e-10 * s[0]], dtype=np.float64)


def _centred(values: Floats) -> Floats:
    return np.asarray(values - np.nanmean(values), dtype=np.float64)
