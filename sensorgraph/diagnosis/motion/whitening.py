"""Whitening: filters that turn correlated noise into white noise of unit variance.

    white_i = (x_i + taps_1 x_(i-1) + ... + taps_order x_(i-order)) / sigma

Least squares on whitened rows is generalised least squares (Aitken 1935; Cochrane and Orcutt 1949). The noise
is estimated from the run, not taken from robot.yaml: an autoregressive filter is fitted to the residual by
the Yule-Walker equations (Box and Jenkins 1970, section 7.3), with Huber's weights against outliers (Huber
1964). Correlated cameras and wrong tolerances therefore change the weights, but not the named effects.

The kernels that whiten series and evaluate noise models are compiled, because they are called thousands of times per run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planners.kernel import inner_kernel, kernel, outer_kernel
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Bools, Floats

HUBER_LIMIT = 3.0
"""Limit of Huber's loss, in standard deviations."""
ROWS_AT_A_TIME = 4096
"""Rows filtered at a time: the data stays in the cache, and a long run needs no further memory."""
ENTRIES_AT_A_TIME = 512
"""Entries to which all lags are added at a time: these fit into the first level of the cache."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WhiteningFilter:
    """Prediction-error filter: the unpredicted part of a series, divided by its standard deviation."""

    taps: Floats
    """(order + 1,) the first is 1."""
    sigma: float
    """Standard deviation of the filtered series."""

    def __call__(self, columns: Floats) -> Floats:
        """Return columns (n, ...) filtered along time and divided by sigma."""
        if columns.ndim == 1 and len(columns):
            return np.convolve(columns, self.taps)[: len(columns)] / self.sigma
        out = np.empty(columns.shape)
        self.write(columns, out)
        return out

    def write(self, columns: Floats, out: Floats) -> None:
        """Write columns (n, ...), filtered along time and divided by sigma, to `out`."""
        for rows in blocks(len(columns)):
            out[rows] = self.block(columns, rows)

    def block(self, columns: Floats, rows: slice) -> Floats:
        """Return some rows of the filtered columns (n, ...)."""
        first = max(rows.start - len(self.taps) + 1, 0)
        some = np.ascontiguousarray(columns[first : rows.stop])
        out = np.zeros_like(some)
        _filter(some.ravel(), math.prod(some.shape[1:]), self.taps, self.sigma, out.ravel())
        return out[rows.start - first :]

    @classmethod
    def white(cls, order: int, sigma: float) -> WhiteningFilter:
        """Return the filter of white noise."""
        return cls(taps=np.eye(1, order + 1)[0], sigma=sigma)


def blocks(n: int) -> Iterator[slice]:
    """Yield slices that divide n rows into blocks."""
    for first in range(0, n, ROWS_AT_A_TIME):
        yield slice(first, min(first + ROWS_AT_A_TIME, n))


def fit_autoregression(series: Floats, valid: Bools, order: int) -> WhiteningFilter:
    """Fit an autoregressive model to the valid part of a series (n,)."""
    n = max(int(valid.sum()), 1)
    x = np.where(valid, series, 0.0)
    autocovariance = np.array([x[: len(x) - k] @ x[k:] for k in range(order + 1)]) / n
    autocovariance[0] = max(autocovariance[0] * (1 + 1e-6), 1e-18)
    return filter_of(autocovariance, min_innovation=1e-3)


def filter_of(autocovariance: Floats, min_innovation: float) -> WhiteningFilter:
    """Return the filter that whitens a process with autocovariance gamma (order + 1,).

        sum over j of  gamma_|i - j| a_j = gamma_i,   taps = [1, -a],   sigma² = gamma_0 - sum over i of a_i gamma_i

    Parameters
    ----------
    autocovariance : (order + 1,) gamma.
    min_innovation : Minimum share of the variance that the past does not predict.
    """
    lag = np.arange(len(autocovariance) - 1)
    covariance = autocovariance[
        np.abs(lag[:, None] - lag)
    ]  # so small that this is faster than Levinson's recursion
    coefficients = np.linalg.solve(covariance, autocovariance[1:])
    variance = max(autocovariance[0] - coefficients @ autocovariance[1:], min_innovation * autocovariance[0])
    return WhiteningFilter(taps=np.concatenate([[1.0], -coefficients]), sigma=float(np.sqrt(variance)))


def clipped(residual: Floats, valid: Bools, limit: float, floor: float) -> Floats:
    """Return a residual (n,), clipped at the larger of `limit` robust standard deviations and `floor`."""
    most = max(limit * robust_sigma(residual[valid]), floor)
    return np.clip(residual, -most, most)


def huber_loss(white: Floats) -> Floats:
    """Return Huber's loss of whitened residuals [nats].

    loss = white² / 2 for |white| < limit, limit |white| - limit² / 2 otherwise
    """
    size = np.abs(white)
    return np.where(size < HUBER_LIMIT, 0.5 * size**2, HUBER_LIMIT * size - 0.5 * HUBER_LIMIT**2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Whitener:
    """Whitens rows of one or several kinds, for instance translation and rotation, kind by kind."""

    filters: tuple[WhiteningFilter, ...]
    """(n_kinds,)"""
    valid: Bools
    """(n,) valid rows of each kind."""
    weights: Floats
    """(n_kinds n,) factors of the whitened rows."""

    @classmethod
    def plain(cls, filters: tuple[WhiteningFilter, ...], valid: Bools) -> Whitener:
        """Return a whitener with equal weights."""
        return cls(filters=filters, valid=valid, weights=np.ones(len(filters) * len(valid)))

    @classmethod
    def robust(cls, filters: tuple[WhiteningFilter, ...], valid: Bools, residual: Floats) -> Whitener:
        """Return a whitener with Huber's weights min(1, limit / |white|), from a residual (n_kinds n,)."""
        white = np.maximum(np.abs(cls.plain(filters, valid)(residual)), 1e-9)
        return cls(filters=filters, valid=valid, weights=np.sqrt(np.minimum(1.0, HUBER_LIMIT / white)))

    def __call__(self, columns: Floats) -> Floats:
        """Return rows (n_kinds n,) or columns (n_kinds n, k), whitened along time and weighted; 0 where not valid."""
        out, n = np.empty(columns.shape), len(self.valid)
        for f, part, white in zip(self.filters, by_kind(columns, n), by_kind(out, n), strict=True):
            f.write(part, white)
        keep = np.where(self.valid_rows, self.weights, 0.0)
        out *= keep if out.ndim == 1 else keep[:, None]
        return out

    def normal_equations(self, parts: Sequence[Floats], y: Floats) -> tuple[Floats, Floats]:
        """Return Z'Z (k, k) and Z'y (k,) of whitened rows, without storing these.

        Parameters
        ----------
        parts : (n_kinds n, .) Columns of Z, side by side, k in total.
        y : (n_kinds n,)
        """
        k, n = sum(part.shape[1] for part in parts), len(self.valid)
        G, b = np.zeros((k, k)), np.zeros(k)
        keep = np.where(self.valid_rows, self.weights, 0.0)
        for i, noise in enumerate(self.filters):
            kind = slice(i * n, (i + 1) * n)
            for rows in blocks(n):
                columns = [noise.block(part[kind], rows) for part in (*parts, y[:, None])]
                Z = np.concatenate(columns, axis=1) * keep[kind][rows, None]
                G += Z[:, :-1].T @ Z[:, :-1]
                b += Z[:, :-1].T @ Z[:, -1]
        return G, b

    def first(self, k: int) -> Whitener:
        """Return the whitener of the first k kinds of rows."""
        n = len(self.valid)
        return Whitener(filters=self.filters[:k], valid=self.valid, weights=self.weights[: k * n])

    @property
    def valid_rows(self) -> Bools:
        """(n_kinds n,)"""
        return np.tile(self.valid, len(self.filters))

    @property
    def sigmas(self) -> Floats:
        """(n_kinds,) of the filtered rows of each kind."""
        return np.array([f.sigma for f in self.filters])

    @property
    def log_likelihood(self) -> float:
        """[nats] log-likelihood of rows with the fitted noise, without constants."""
        return -float(self.valid.sum()) * float(np.log(self.sigmas).sum())

    def nats_and_rms(self, residual: Floats) -> tuple[float, float]:
        """Return mean negative log-likelihood [nats] and RMS of a whitened residual (n_kinds n,), unweighted."""
        some = self.valid_rows
        white = Whitener.plain(self.filters, self.valid)(residual)[some]
        sigma = np.repeat(self.sigmas, len(self.valid))[some]
        nats = float(np.mean(0.5 * white**2 + np.log(sigma * np.sqrt(2 * np.pi))))
        return nats, float(np.sqrt(np.mean(white**2)))


def by_kind(rows: Floats, n: int) -> list[Floats]:
    """Return rows (n_kinds n, ...) split by kind, (n, ...) each; views."""
    return [rows[first : first + n] for first in range(0, len(rows), n)]


@kernel
def robust_misfit(
    autocovariance: Floats, min_innovation: float, residual: Floats, valid: Bools, limit: float
) -> float:
    """Return the negative log-likelihood of a series with Huber's loss, without constants [nats].

        misfit   = sum over valid i of  rho(white_i / sigma) + log sigma
        white_i  = sum over lag of  taps_lag residual_(i - lag)
        sigma²   = max(taps . autocovariance, min_innovation autocovariance_0)
        rho(u)   = u² / 2 for |u| < limit, limit |u| - limit² / 2 otherwise

    The taps whiten noise with the given autocovariance. The result is minus
    `reference_noise.robust_log_likelihood` of the noise that `whitening.filter_of` returns.

    Parameters
    ----------
    autocovariance : (order + 1,)
    min_innovation : Minimum share of the variance that the past does not predict.
    residual, valid : (n,) The series, and which of its rows count.
    limit : [standard deviations] Limit of Huber's loss.
    """
    taps = _prediction_error_taps(autocovariance)
    variance = 0.0
    for lag in range(len(taps)):
        variance += taps[lag] * autocovariance[lag]
    variance = max(variance, min_innovation * autocovariance[0])
    white = np.zeros(len(residual))
    _add_lagged(residual, 1, taps, white)
    sigma = np.sqrt(variance)
    loss, counted = 0.0, 0
    for i in range(len(residual)):
        if valid[i]:
            size = abs(white[i]) / sigma
            loss += 0.5 * size * size if size < limit else limit * size - 0.5 * limit * limit
            counted += 1
    return float(loss + counted * np.log(sigma))


@kernel
def _prediction_error_taps(autocovariance: Floats) -> Floats:
    """Return the taps (order + 1,) of the best linear predictor, by the Levinson-Durbin recursion (Durbin 1960).

        sum over j of  autocovariance_|i - j| taps_j = 0  for i >= 1,   taps_0 = 1

    These are the Yule-Walker equations of the series.
    """
    n = len(autocovariance)
    taps, before = np.zeros(n), np.zeros(n)
    taps[0] = 1.0
    variance = autocovariance[0]
    for order in range(1, n):
        ahead = 0.0
        for i in range(order):
            ahead += taps[i] * autocovariance[order - i]
        reflection = -ahead / variance
        for i in range(order):  # before[:order] = ... would compile an error message for 4 s
            before[i] = taps[i]
        for i in range(1, order + 1):
            taps[i] = before[i] * (i < order) + reflection * before[order - i]
        variance *= 1.0 - reflection * reflection
    return taps


@outer_kernel
def _filter(rows: Floats, k: int, taps: Floats, sigma: float, out: Floats) -> None:
    """Filter rows of k columns along time and divide them by sigma; rows before the first are zero.

        out_i = sum over lag of  taps_lag rows_(i - lag) / sigma

    Parameters
    ----------
    rows, out : (n k,) Row by row; `out` is zero at first.
    """
    _add_lagged(rows, k, taps, out)
    for i in range(len(out)):
        out[i] /= sigma


@inner_kernel
def _add_lagged(rows: Floats, k: int, taps: Floats, out: Floats) -> None:
    """Add to `out` the sum over lag of taps_lag rows_(i - lag), row by row of k columns; loops over slices become vector code."""
    size = max(k, 1) * max(ENTRIES_AT_A_TIME // max(k, 1), 1)
    for first in range(0, len(out), size):
        last = min(first + size, len(out))
        for lag in range(len(taps)):
            begin = max(first, lag * k)
            some, before = out[begin:last], rows[begin - lag * k :]
            for i in range(len(some)):
                some[i] += taps[lag] * before[i]
