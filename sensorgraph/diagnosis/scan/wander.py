"""How far the mean of a reference's error may be off: what wanders slowly looks like a mount or a delay that is wrong.

A fit takes the pose errors of all scans for independent. Where they last, the mean of them in the frame of the robot, or along
its way, has a larger error: that of a mean of correlated values, with autocovariances summed as long as neighbouring pairs
of them are positive (Geyer 1992, Practical Markov chain Monte Carlo, section 3.3).
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats

LEAST_SEEN = 0.1
"""Share of the square of an error that a run shows at least, however long it lasts."""


def wander_widths(fitted: Fitted) -> dict[Nuisance, float]:
    """Return the standard deviation [m, m, rad, s] that wandering pose errors give to what is constant on the robot.

    A delay is told by ways and by turns, each as surely as the reference tells these.
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
    """Return by how much the standard error of the mean of values (n,) exceeds, in squares, that of independent ones.

    Autocovariances about the mean of the values themselves are too small by the square of that error, each of them, which
    is given back. Of what lasts longer than a tenth of the run this tells only a part.
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
