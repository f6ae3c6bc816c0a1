"""Compiled kernels that whiten series and evaluate noise models; called thousands of times per run."""

from __future__ import annotations

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Bools, Floats


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
    variance = max((taps * autocovariance).sum(), min_innovation * autocovariance[0])
    white = np.zeros(len(residual))
    for lag in range(len(taps)):
        tap = taps[lag]
        for i in range(lag, len(residual)):
            white[i] += tap * residual[i - lag]
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


@kernel
def filtered(columns: Floats, taps: Floats, sigma: float) -> Floats:
    """Return columns (n, k), filtered along time and divided by sigma.

        out_i = sum over lag of  taps_lag columns_(i - lag) / sigma

    Rows before the first are zero.
    """
    n, k = columns.shape
    out = np.zeros((n, k))
    for i in range(n):
        for lag in range(min(len(taps), i + 1)):
            tap = taps[lag]
            for j in range(k):
                out[i, j] += tap * columns[i - lag, j]
        for j in range(k):
            out[i, j] /= sigma
    return out
