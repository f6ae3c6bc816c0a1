"""Is anything left in the residuals? Correlation tests of first and higher order, with the size that they claim.

Each test asks whether the residual e(k) goes with something of the past, z(k - lag): itself, an input, the square of
an input, their product (Billings and Voon 1986). Fitting has already removed what the model's own gradients explain,
so bounds of 1.96 / sqrt(n) are too wide at small lags; here z is first freed of the gradients (a Lagrange multiplier
test: Breusch 1978, Godfrey 1978), and all lags together give one p-value.
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
    """(n_lags,) that a correlation stays within in 95 of 100 cases if nothing is left."""
    statistic: float
    """Of all lags together, chi-squared with as many degrees of freedom as lags that can be told apart."""
    p_value: float
    n: int
    """Residuals that it rests on."""

    @property
    def alarms(self) -> NDArray[np.int64]:
        """Lags whose correlation is out of its bound; 5 % of them are by chance alone."""
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
    inputs : signals to test against; None: those that the model reads
    fitted : whether the model was fitted on these records; on others nothing was removed beforehand

    Raises
    ------
    IdentError
        if a signal is missing, or the residuals are too few for `max_lag` lags
    """
    records = as_records(records)
    if inputs is None:
        groups = (model.terms, model.denominator, model.noise_terms)
        seen = dict.fromkeys(v for terms in groups for v in terms.variables)
        inputs = [v for v in seen if v not in (model.output, "e")]
    if missing := [v for v in inputs if any(v not in r.signals for r in records)]:
        raise IdentError(
            f"no signal {', '.join(missing)} in every record; they hold {', '.join(records[0].signals)}"
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
    """Tell which of many tests to believe so that at most `rate` of those believed are wrong.

    Benjamini and Hochberg 1995; nan is never believed. Returns an array shaped like p_values.
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
        problem = NonlinearLeastSquares(model.recursion(), records)
        _, self.e, self.gradients = problem.evaluate(model.parameters, gradient=True)
        self.rows = problem.rows
        unit = size_of(*self.e)
        self.known = [np.where(rows, e / unit, np.nan) for e, rows in zip(self.e, self.rows, strict=True)]
        self.source = [r for r in records for _ in r.segments()]
        self.segments: list[Segment] = problem.segments
        if problem.count <= len(model.parameters) + 2 * max_lag + 1:
            raise IdentError(
                f"{problem.count} residuals are too few to test {max_lag} lags beside {len(model.parameters)} "
                "coefficients; give a smaller max_lag or longer records"
            )

    def signal(self, name: str) -> list[Floats]:
        """Return a signal over every segment, its mean removed and of size one; nan where not known."""
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
        """Test e, or e² less its mean, against `past` at every lag."""
        targets, regressors, nuisance = [], [], []
        for e, z, g, rows in zip(self.e, past, self.gradients, self.rows, strict=True):
            delayed = np.full((len(e), len(lags)), np.nan)
            for j, lag in enumerate(lags.tolist()):
                delayed[lag:, j] = z[: max(len(z) - lag, 0)] if lag else z
            use = rows & np.isfinite(delayed).all(axis=1)
            targets.append(e[use])
            regressors.append(delayed[use])
            nuisance.append(g[use])
        target, Z = _of_size_one(np.concatenate(targets)), _of_size_one(np.concatenate(regressors))
        G = np.concatenate(nuisance)
        n = len(target)
        if n <= len(lags) + 1:
            raise IdentError(f"test {test}: only {n} rows know {lags[-1]} lags; give a smaller max_lag")
        if of_squares:
            target = target**2 - np.mean(target**2)
        free = Z - Z.mean(axis=0) if of_squares else Z
        if fitted and not of_squares:
            basis = _orthonormal(G)
            free = Z - basis @ (basis.T @ Z)
        used = self.gradients[0].shape[1] if fitted else 0
        return _judged(test, lags, target, Z, free, used)


def _judged(
    test: str, lags: NDArray[np.int64], target: Floats, Z: Floats, free: Floats, used: int
) -> ResidualTest:
    """Correlate the target with Z (n, n_lags); `free` is what of Z could still vary with it."""
    n = len(target)
    variance = float(np.sum(target**2)) / max(n - used, 1)
    size = np.sqrt((Z**2).sum(axis=0) * n * variance)
    size[size == 0] = 1.0
    score = free.T @ target
    V = variance * (free.T @ free)
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


def _of_size_one(z: Floats) -> Floats:
    """Scale each column by a power of two, which changes no digit: tests do not depend on units, but squares overflow."""
    return np.asarray(np.ldexp(z, -np.frexp(np.abs(z).max(axis=0, initial=0.0))[1]))


def _orthonormal(G: Floats) -> Floats:
    size = np.sqrt((G**2).sum(axis=0))
    U, s, _ = np.linalg.svd(G / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(U[:, s > 1e-10 * s[0]], dtype=np.float64)


def _centred(values: Floats) -> Floats:
    return np.asarray(values - np.nanmean(values), dtype=np.float64)
