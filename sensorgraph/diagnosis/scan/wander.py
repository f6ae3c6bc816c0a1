"""Estimate the error of the mean of slow reference errors, which look like a wrong mount or delay.

    square = (2 Σ_k<m (c_2k + c_2k+1) - c_0) / n / max(1 - (4 m - 1) / n, LEAST_SEEN)
    width² = square - (c_0 + square) / n

Here c_k is the autocovariance of the n pose errors at lag k. The sum ends at the first pair of neighbours that is
not positive (Geyer 1992, Practical Markov chain Monte Carlo, section 3.3). A fit treats the pose errors of all
scans as independent. If they are correlated in time, their mean in the robot frame or along its path has a
larger error.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats

LEAST_SEEN = 0.1
"""Minimum share of the squared error that a run shows, for any correlation time."""


def wander_widths(fitted: Fitted) -> dict[Nuisance, float]:
    """Return the standard deviations [m, m, rad, s] of mount and delay from slow pose errors.

    A delay is estimated from translation and turning, each weighted by the tolerance of the reference.
    """
    data, delta = fitted.solver.data, fitted.state.delta
    c, s = np.cos(data.poses[:, 2]), np.sin(data.poses[:, 2])
    ahead, aside = c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0]
    t, turning = data.tolerances, data.twists[:, 2]
    by_delay = ahead * data.speed / t.pose_xy**2 + delta[:, 2] * turning / t.pose_yaw**2
    square = float(np.mean((data.speed / t.pose_xy) ** 2 + (turning / t.pose_yaw) ** 2))
    return {
        Nuisance.MOUNT_X: error_of_mean(ahead),
        Nuisance.MOUNT_Y: error_of_mean(aside),
        Nuisance.MOUNT_YAW: error_of_mean(delta[:, 2]),
        Nuisance.DELAY: error_of_mean(by_delay) / square if square > 0 else 0.0,
    }


def error_of_mean(values: Floats) -> float:
    """Return `width`, the standard error of the mean of values (n,) in excess of that of independent values.

    Autocovariances about the sample mean are each too small by the squared error of that mean. The divisor of
    `square` corrects this. If the correlation time exceeds a tenth of the run, the correction is partial.
    """
    n, off = len(values), values - values.mean()
    spectrum = np.abs(np.fft.rfft(off, 2 * n)) ** 2
    covariance = np.fft.irfft(spectrum)[:n] / n
    pairs = covariance[0 : n - 1 : 2] + covariance[1:n:2]
    positive = pairs > 0
    kept = int(positive.argmin()) if not positive.all() else len(pairs)
    summed = 2 * float(pairs[:kept].sum()) - float(covariance[0])
    square = summed / n / max(1 - (4 * kept - 1) / n, LEAST_SEEN)
    return float(np.sqrt(max(square - (float(covariance[0]) + square) / n, 0.0)))
