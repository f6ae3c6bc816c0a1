"""How much of a difference between odometry and reference is noise: wheels that slip a little, poses that wander.

The slow part of such noise has limits that robot.yaml gives: the way and turn of the wheels are a random walk of
known density, and a reference wanders by a few of its standard deviations within a second or so. A free spectrum
would take any effect that is smooth in time for noise; one of limited slow part leaves it to be explained. The
fast part has no limit: a camera that is noisier than said is no effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import minimize

from sensorgraph.diagnosis.motion.whitened_regression import whiten
from sensorgraph.types import Bools, Floats

ORDER = 24
"""Of the whitening filter."""
LOUDER = 3.0
"""Times what robot.yaml says that wheels may be noisy."""
WANDER = 4.0
"""Times what robot.yaml says that the slow part of the reference's noise may be."""
LONGEST = 1.0
"""[s] of memory of the reference's noise."""
HUBER = 3.0
"""Standard deviations beyond which a row counts by its size, not by its square."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What robot.yaml says of one kind of row, way or turn."""

    walk: float
    """[m/√s or rad/√s] root of the density of the wheels' random walk."""
    wander: float
    """[m or rad] standard deviation of the reference."""
    period: float
    """[s] between two rows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Whitening filter of one kind of row."""

    taps: Floats
    """(ORDER + 1,)"""
    sigma: float
    """Of the whitened row."""

    def white(self, columns: Floats) -> Floats:
        """Return columns (n, ...) whitened along time."""
        return whiten(columns, self.taps, self.sigma)

    def loglik(self, residual: Floats, ok: Bools) -> float:
        """Return the robust log-likelihood of a residual (n,), without constants [nats]."""
        return -float(losses(self.white(residual)[ok]).sum()) - float(ok.sum()) * float(np.log(self.sigma))


def losses(white: Floats) -> Floats:
    """Return Huber's loss of whitened residuals [nats]."""
    size = np.abs(white)
    return np.where(size < HUBER, 0.5 * size**2, HUBER * size - 0.5 * HUBER**2)


def covariance_of(white: float, wander: float, memory: float, walk: float, period: float) -> Floats:
    """Return the autocovariance (ORDER + 1,) of differences of an averaged reference minus averaged wheels.

    `white` and `wander` [m or rad] are standard deviations of the averages, `memory` their correlation from one
    average to the next, `walk` the density of the wheels; averages overlap, so that two neighbours share a sixth.
    """
    lags = np.arange(-1, ORDER + 2)
    level = wander**2 * memory ** np.abs(lags) + white**2 * (lags == 0)
    out = 2 * level[1:-1] - level[:-2] - level[2:]
    out[0] += walk**2 * period * 2 / 3
    out[1] += walk**2 * period / 6
    return np.asarray(out)


def predictor(gamma: Floats) -> Noise:
    """Return the filter that whitens a process of autocovariance gamma (ORDER + 1,)."""
    gamma = gamma + np.eye(1, len(gamma))[0] * 1e-6 * gamma[0]
    coefficients = solve_toeplitz(gamma[:-1], gamma[1:])
    variance = max(float(gamma[0] - coefficients @ gamma[1:]), 1e-6 * float(gamma[0]))
    return Noise(taps=np.concatenate([[1.0], -coefficients]), sigma=float(np.sqrt(variance)))


def fit_noise(
    residual: Floats, ok: Bools, limits: Limits, start: Floats | None = None
) -> tuple[Noise, Floats]:
    """Return the likeliest noise within limits, and its parameters (4,) to start the next fit from."""

    def noise(p: Floats) -> Noise:
        white = limits.wander * np.exp(np.clip(p[0], -6.0, 6.0))
        wander = limits.wander * WANDER / (1 + np.exp(-p[1]))
        memory = np.exp(-limits.period / LONGEST) / (1 + np.exp(-p[2]))
        walk = limits.walk * LOUDER / (1 + np.exp(-p[3]))
        return predictor(covariance_of(white, wander, memory, walk, limits.period))

    def misfit(p: Floats) -> float:
        return -noise(p).loglik(residual, ok)

    first: Floats = np.array([-0.5, -2.0, 0.0, -0.7]) if start is None else start
    simplex = np.concatenate([first[None], first + np.diag([0.7, 1.5, 1.5, 1.0])])
    options: Any = {
        "initial_simplex": simplex,
        "maxfev": 90 if start is None else 60,
        "fatol": 0.3,
        "xatol": 0.05,
    }
    found = minimize(
        misfit,
        first,
        method="Nelder-Mead",
        options=options,
    )
    p = np.clip(found.x, -6.0, 6.0)
    return noise(p), p
