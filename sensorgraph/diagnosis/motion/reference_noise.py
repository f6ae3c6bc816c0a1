"""How much of a difference between odometry and reference is noise: wheels slip a little, reference poses wander.

The slow part of such noise has limits that robot.yaml gives: the distance and turn of the wheels are a random walk of
known density, and a reference wanders by a few of its standard deviations within a second or so. A free spectrum
would take any effect that is smooth in time for noise; one of limited slow part leaves it to be explained. The
fast part has no limit: a camera that is noisier than said is no effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.noise_kernels import robust_misfit
from sensorgraph.diagnosis.motion.settings import EVIDENCE, ODOMETRY
from sensorgraph.diagnosis.motion.whitening import WhiteningFilter, filter_of, huber_loss
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

MAX_LOGIT = 6.0
"""Bound of the unconstrained parameters of the noise: e⁶ : 1 is as good as a limit."""
FIRST_GUESS = (-0.5, -2.0, 0.0, -0.7)
"""Of log white, and the logits of wander, memory and walk."""
FIRST_SIMPLEX = (0.7, 1.5, 1.5, 1.0)
"""Edges of the first simplex."""
MIN_INNOVATION = 1e-6
"""Least share of the variance that the past does not predict."""


@dataclass(frozen=True, kw_only=True)
class NoiseLimits:
    """What robot.yaml says of one kind of row, distance or turn."""

    walk: float
    """[m/√s or rad/√s] root of the density of the wheels' random walk."""
    wander: float
    """[m or rad] standard deviation of the reference."""
    period: float
    """[s] between two rows."""


def noise_limits(
    robot: Robot, wheels: WheelIncrements, row_stamps: Floats
) -> tuple[NoiseLimits, NoiseLimits]:
    """Return the limits of the noise of distances and of turns."""
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
    return translation, rotation


def difference_autocovariance(
    white: float, wander: float, memory: float, walk: float, period: float
) -> Floats:
    """Return the autocovariance (order + 1,) of differences of an averaged reference minus averaged wheels.

    `white` and `wander` [m or rad] are standard deviations of the averages, `memory` their correlation from one
    average to the next, `walk` the density of the wheels. Averages overlap, so that two neighbours share a sixth.
    """
    lags = np.arange(-1, ODOMETRY.noise.order + 2)
    level = wander**2 * memory ** np.abs(lags) + white**2 * (lags == 0)
    out = 2 * level[1:-1] - level[:-2] - level[2:]
    out[0] += walk**2 * period * 2 / 3
    out[1] += walk**2 * period / 6
    return np.asarray(out)


def fit_limited_noise(
    residual: Floats, valid: Bools, limits: NoiseLimits, start: Floats | None = None
) -> tuple[WhiteningFilter, Floats]:
    """Return the likeliest noise within limits, and its parameters (4,) to start the next fit from."""
    settings = ODOMETRY.noise

    def autocovariance(p: Floats) -> Floats:
        white = limits.wander * np.exp(np.clip(p[0], -MAX_LOGIT, MAX_LOGIT))
        wander = limits.wander * settings.max_wander / (1 + np.exp(-p[1]))
        memory = np.exp(-limits.period / settings.max_memory) / (1 + np.exp(-p[2]))
        walk = limits.walk * settings.max_walk / (1 + np.exp(-p[3]))
        gamma = difference_autocovariance(white, wander, memory, walk, limits.period)
        gamma[0] *= 1 + MIN_INNOVATION
        return gamma

    def misfit(p: Floats) -> float:
        return robust_misfit(autocovariance(p), MIN_INNOVATION, residual, valid, EVIDENCE.huber_limit)

    first: Floats = np.array(FIRST_GUESS) if start is None else start
    options: Any = {
        "initial_simplex": np.concatenate([first[None], first + np.diag(FIRST_SIMPLEX)]),
        "maxfev": 90 if start is None else 60,
        "fatol": 0.3,
        "xatol": 0.05,
    }
    found = minimize(misfit, first, method="Nelder-Mead", options=options)
    p = np.clip(found.x, -MAX_LOGIT, MAX_LOGIT)
    return filter_of(autocovariance(p), MIN_INNOVATION), p


def robust_log_likelihood(noise: WhiteningFilter, residual: Floats, valid: Bools) -> float:
    """Return the log-likelihood of a residual (n,) by Huber's loss, without constants [nats]."""
    loss = huber_loss(noise(residual)[valid], EVIDENCE.huber_limit)
    return -float(loss.sum()) - float(valid.sum()) * float(np.log(noise.sigma))


class LimitedNoiseFitter:
    """Fits noise within limits, each time from where the last fit ended."""

    def __init__(self, limits: tuple[NoiseLimits, NoiseLimits]) -> None:
        self.limits = limits
        self.starts: list[Floats | None] = [None, None]

    def __call__(self, kind: int, residual: Floats, valid: Bools) -> WhiteningFilter:
        """Return the noise of a residual (n,) of translation (kind 0) or rotation (1)."""
        noise, self.starts[kind] = fit_limited_noise(residual, valid, self.limits[kind], self.starts[kind])
        return noise
