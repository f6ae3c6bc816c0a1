"""Noise of the difference between reference poses and odometry, with limits from robot.yaml.

    gamma_k = 2 c_k - c_(k-1) - c_(k+1) + walk² period (2/3 [k = 0] + 1/6 [k = 1])
    c_k     = wander² memory^|k| + white² [k = 0]

The slow part of the noise is limited. The wheels slip a little: their distance and turn are a random walk of
known density (walk). The reference poses drift by a few of their standard deviations within about a second
(wander). A free spectrum would absorb any effect that is smooth in time; with a limited slow part, the effect
remains to be explained. The fast part (white) has no limit: a camera with more noise than specified is not an
effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.whitening import (
    HUBER_LIMIT,
    WhiteningFilter,
    filter_of,
    huber_loss,
    robust_misfit,
)
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

MAX_LOGIT = 6.0
"""Bound of the unconstrained noise parameters: a ratio of e⁶ : 1 is practically a limit."""
MIN_INNOVATION = 1e-6
"""Minimum share of the variance that the past does not predict."""
MAX_WALK = 3.0
"""Maximum density of the wheels' random walk, as a multiple of that in robot.yaml."""
MAX_MEMORY = 1.0
"""[s] maximum memory of the reference noise."""
FILTER_ORDER = 24
"""Order of the whitening filters of the odometry channel."""
MAX_WANDER = 4.0
"""Maximum slow part of the reference noise, as a multiple of the standard deviation in robot.yaml."""


@dataclass(frozen=True, kw_only=True)
class NoiseLimits:
    """Noise that robot.yaml specifies for one kind of row, distance or turn."""

    walk: float
    """[m/√s or rad/√s] square root of the density of the wheels' random walk."""
    wander: float
    """[m or rad] standard deviation of the reference."""
    period: float
    """[s] between two rows."""


def noise_limits(robot: Robot, wheels: WheelIncrements, row_stamps: Floats) -> tuple[NoiseLimits, ...]:
    """Return the noise limits of distances, of turns, and of distances across the heading."""
    step = float(np.median(wheels.end - wheels.start))
    period = float(np.median(np.diff(row_stamps)))
    translation = NoiseLimits(
        walk=robot.wheels.sigma_v * np.sqrt(step),
        wander=max(robot.pose.sigma_xy, robot.tolerances.pose_xy),
        period=period,
    )
    rotation = NoiseLimits(
        walk=robot.wheels.sigma_omega * np.sqrt(step),
        wander=max(robot.pose.sigma_yaw, robot.tolerances.pose_yaw),
        period=period,
    )
    return translation, rotation, translation


def difference_autocovariance(
    white: float, wander: float, memory: float, walk: float, period: float
) -> Floats:
    """Return the autocovariance gamma (order + 1,) of averaged reference steps minus averaged wheel steps.

        gamma_k = 2 c_k - c_(k-1) - c_(k+1) + walk² period (2/3 [k = 0] + 1/6 [k = 1])
        c_k     = wander² memory^|k| + white² [k = 0]

    Averages overlap, so that neighbours share a sixth of the walk.

    Parameters
    ----------
    white, wander : [m or rad] Standard deviations of the fast and the slow part of the averages.
    memory : Correlation of the slow part from one average to the next.
    walk : [m/√s or rad/√s] Square root of the density of the wheels' random walk.
    period : [s] Between two averages.
    """
    lags = np.arange(-1, FILTER_ORDER + 2)
    level = wander**2 * memory ** np.abs(lags) + white**2 * (lags == 0)
    out = 2 * level[1:-1] - level[:-2] - level[2:]
    out[0] += walk**2 * period * 2 / 3
    out[1] += walk**2 * period / 6
    return np.asarray(out)


def fit_limited_noise(
    residual: Floats, valid: Bools, limits: NoiseLimits, start: Floats | None = None
) -> tuple[WhiteningFilter, Floats]:
    """Return the most likely noise within limits, and its parameters (4,), from which the next fit can start.

    The parameters minimise `robust_misfit`, found by the simplex method of Nelder and Mead. They are log white, and the
    logits of wander, memory and walk in units of their limits; the search starts at 0, half of each limit.
    """

    def autocovariance(p: Floats) -> Floats:
        white = limits.wander * np.exp(np.clip(p[0], -MAX_LOGIT, MAX_LOGIT))
        wander = limits.wander * MAX_WANDER / (1 + np.exp(-p[1]))
        memory = np.exp(-limits.period / MAX_MEMORY) / (1 + np.exp(-p[2]))
        walk = limits.walk * MAX_WALK / (1 + np.exp(-p[3]))
        gamma = difference_autocovariance(white, wander, memory, walk, limits.period)
        gamma[0] *= 1 + MIN_INNOVATION
        return gamma

    def misfit(p: Floats) -> float:
        return robust_misfit(autocovariance(p), MIN_INNOVATION, residual, valid, HUBER_LIMIT)

    first: Floats = np.zeros(4) if start is None else start
    options: Any = {
        "initial_simplex": np.concatenate([first[None], first + np.eye(4)]),
        "maxfev": 90 if start is None else 60,
        "fatol": 0.3,
        "xatol": 0.05,
    }
    found = minimize(misfit, first, method="Nelder-Mead", options=options)
    p = np.clip(found.x, -MAX_LOGIT, MAX_LOGIT)
    return filter_of(autocovariance(p), MIN_INNOVATION), p


def robust_log_likelihood(noise: WhiteningFilter, residual: Floats, valid: Bools) -> float:
    """Return the log-likelihood of a residual (n,) with Huber's loss, without constants [nats]."""
    loss = huber_loss(noise(residual)[valid])
    return -float(loss.sum()) - float(valid.sum()) * float(np.log(noise.sigma))


class LimitedNoiseFitter:
    """Fits noise within limits; each fit starts from the result of the previous one."""

    def __init__(self, limits: tuple[NoiseLimits, ...]) -> None:
        self.limits = limits
        self.starts: list[Floats | None] = [None] * len(limits)

    def __call__(self, kind: int, residual: Floats, valid: Bools) -> WhiteningFilter:
        """Return the noise of a residual (n,) of one kind of rows."""
        noise, self.starts[kind] = fit_limited_noise(residual, valid, self.limits[kind], self.starts[kind])
        return noise
