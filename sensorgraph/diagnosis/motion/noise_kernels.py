"""Compiled: series whitened, and how badly a noise fits one, which are asked thousands of times a run."""

from __future__ import annotations

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Bools, Floats


@kernel
def robust_misfit(
    autocovariance: Floats, min_innovation: float, residual: Floats, valid: Bools, limit: float
) -> float:
    """Return minus the log-likelihood of a series by Huber's loss, without constants [nats].

    What `reference_noise.robust_log_likelihood` says of the noise that `whitening.filter_of` makes of the autocovariance.

    Parameters
    ----------
    autocovariance : (order + 1,)
    min_innovation : least share of the variance that the past does not predict
    residual, valid : (n,) the series, and which of its rows count
    limit : [standard deviations] beyond which a row counts by its size, not by its square
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
    """Return the taps (order + 1,) of the filter that predicts best, by Levinson's and Durbin's recursion (Durbin 1960)."""
    n = len(autocovariance)
    taps, before = np.zeros(n), np.zeros(n)
    taps[0] = 1.0
    variance = autocovariance[0]
    for order in range(1, n):
        ahead = 0.0
        for i in range(order):
            ahead += taps[i] * autocovariance[order - i]
        reflection = -ahead / variance
        before[:order] = taps[:order]
        for i in range(1, order + 1):
            taps[i] = before[i] * (i < order) + reflection * before[order - i]
        variance *= 1.0 - reflection * reflection
    return taps


@kernel
def filtered(columns: Floats, taps: Floats, sigma: float) -> Floats:
    """Return columns (n, k) filtered along time by taps (order + 1,), with zeros before the first row, over sigma."""
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
