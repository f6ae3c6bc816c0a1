"""What the odometry and the drive channel share: increments of odometry, whitening, boxed least squares, verdicts.

Noise is what the run shows, not what robot.yaml says: an autoregressive filter fitted to the residual whitens
it, so that correlated cameras and wrong tolerances change the weights and not the names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from logs.run import Run
from planners.arena import wrap
from sensorgraph.diagnosis.bounded_least_squares import solve_bounded
from sensorgraph.types import Bools, Floats

PENALTY = 4.0
"""[nats] per parameter of an effect."""
THRESHOLD = 12.0
"""[nats] of penalised evidence that a name needs."""
BOX = 2.5
"""Standard deviations of its prior that a nuisance parameter may use."""
TEMPER = 4.0
"""Evidence is divided by this before it becomes a probability: models are wrong in more ways than noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Increments:
    """What the wheels say they did between two stamps."""

    start: Floats
    """(n,) [s]"""
    end: Floats
    """(n,) [s]"""
    way: Floats
    """(n,) [m] along the path, signed."""
    turn: Floats
    """(n,) [rad]"""
    source: str
    """Where from: `poses` or `twists` of the odometry."""

    @property
    def middle(self) -> Floats:
        """(n,) [s]"""
        return (self.start + self.end) / 2

    @property
    def rates(self) -> Floats:
        """(n, 2) [m/s, rad/s]"""
        return np.stack([self.way, self.turn], axis=1) / (self.end - self.start)[:, None]


def increments(run: Run) -> Increments | None:
    """Return what the odometry says between its stamps; None if it says nothing of use.

    Poses come first, as what a stamp means is plain there; twists stand in where the poses do not move.
    """
    new = np.concatenate([[True], np.diff(run.odom_stamps) > 1e-6]) if len(run.odom_stamps) else np.zeros(0)
    keep = np.flatnonzero(new)
    if len(keep) < 20:
        return None
    stamps, poses, twists = run.odom_stamps[keep], run.odometry[keep], run.odom_twists[keep]
    dt = np.diff(stamps)
    moves = np.isfinite(poses).all() and np.ptp(poses, axis=0).max() > 1e-3
    if moves:
        turn = np.asarray(wrap(np.diff(poses[:, 2])))
        step = np.diff(poses[:, :2], axis=0)
        heading = poses[:-1, 2] + turn / 2
        way = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
        way = way / np.sinc(turn / (2 * np.pi))
        source = "poses"
    elif np.isfinite(twists).all() and np.ptp(twists, axis=0).max() > 1e-3:
        way, turn, source = twists[1:, 0] * dt, twists[1:, 1] * dt, "twists"
    else:
        return None
    return Increments(start=stamps[:-1], end=stamps[1:], way=way, turn=turn, source=source)


def own_reference(run: Run) -> str:
    """Return why the odometry has no reference but itself; empty if the poses come from elsewhere."""
    source = run.meta.get("pose_source", "")
    is_said = source.partition(" ")[0].strip("/") in ("odom", "odometry")
    is_same = (
        len(run.pose_stamps) == len(run.odom_stamps) > 0
        and np.array_equal(run.pose_stamps, run.odom_stamps)
        and np.array_equal(run.poses, run.odometry, equal_nan=True)
    )
    if not (is_said or is_same):
        return ""
    named = f" ({source})" if source else ""
    return f"the poses of this run are its odometry{named}: there is no other reference to compare it with"


def autoregression(series: Sequence[Floats], valid: Sequence[Bools], order: int) -> tuple[Floats, float]:
    """Fit one autoregressive model to several series (Yule-Walker); return its filter (order + 1,) and sigma."""
    gamma = np.zeros(order + 1)
    n = max(sum(int(ok.sum()) for ok in valid), 1)
    for values, ok in zip(series, valid, strict=True):
        x = np.where(ok, values, 0.0)
        gamma += np.array([x[: len(x) - k] @ x[k:] for k in range(order + 1)])
    gamma /= n
    gamma[0] = max(gamma[0] * (1 + 1e-6), 1e-18)
    coefficients = solve_toeplitz(gamma[:-1], gamma[1:])
    variance = max(gamma[0] - coefficients @ gamma[1:], 1e-3 * gamma[0])
    return np.concatenate([[1.0], -coefficients]), float(np.sqrt(variance))


def whiten(columns: Floats, taps: Floats, sigma: float) -> Floats:
    """Filter columns (n, ...) along time and divide by sigma."""
    out = np.zeros_like(columns, dtype=np.float64)
    for lag, tap in enumerate(taps.tolist()):
        out[lag:] += tap * columns[: len(columns) - lag]
    return out / sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class Prior:
    """Gaussian with a box for each column; an infinite sigma is a free parameter."""

    mean: Floats
    sigma: Floats
    box: Floats
    """Largest distance from the mean."""

    @classmethod
    def of(cls, sigma: Floats, mean: Floats | None = None) -> Prior:
        """Return the prior whose boxes are `BOX` sigma."""
        sigma = np.asarray(sigma, dtype=np.float64)
        return cls(mean=np.zeros(len(sigma)) if mean is None else mean, sigma=sigma, box=BOX * sigma)

    def freed(self, which: Sequence[int]) -> Prior:
        """Return it with some parameters free."""
        sigma, box = self.sigma.copy(), self.box.copy()
        sigma[list(which)] = box[list(which)] = np.inf
        return Prior(mean=self.mean, sigma=sigma, box=box)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Parameters at the boxed optimum."""

    theta: Floats
    J: float
    """[nats] penalised log-likelihood, without constants."""
    covariance: Floats
    """(k, k); zero where a box holds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """Normal equations of whitened rows: y = A theta + white noise."""

    A: Floats
    y: Floats
    G: Floats
    b: Floats

    @classmethod
    def of(cls, A: Floats, y: Floats) -> Normal:
        """Form them once, to be solved under many priors."""
        return cls(A=A, y=y, G=A.T @ A, b=A.T @ y)

    def solve(self, prior: Prior) -> Solution:
        """Return the penalised optimum within the bounds of the prior."""
        k = len(self.b)
        weight = np.where(np.isinf(prior.sigma), 0.0, 1 / np.maximum(prior.sigma, 1e-12) ** 2)
        H = self.G + np.diag(weight + 1e-12 * np.diag(self.G) + 1e-30)
        c = self.b + weight * prior.mean
        low, high = prior.mean - prior.box, prior.mean + prior.box
        optimum = solve_bounded(H, c, low, high)
        theta, free = optimum.x, optimum.is_free
        off = np.where(weight > 0, theta - prior.mean, 0.0)
        misfit = float(self.y @ self.y - 2 * self.b @ theta + theta @ self.G @ theta)
        covariance = np.zeros((k, k))
        covariance[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)]) if free.any() else 0.0
        return Solution(theta=theta, J=-0.5 * misfit - 0.5 * float(weight @ off**2), covariance=covariance)

    def sandwich(self, solution: Solution, clusters: Floats) -> Floats:
        """Return the covariance (k, k) that rows correlated within a cluster ask for; never below the model's."""
        scores = self.A * (self.y - self.A @ solution.theta)[:, None]
        sums = np.stack([np.bincount(clusters.astype(np.intp), weights=s) for s in scores.T], axis=1)
        robust = solution.covariance @ (sums.T @ sums) @ solution.covariance
        ratio = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(solution.covariance), 1e-300), 1.0))
        out: Floats = solution.covariance * ratio[:, None] * ratio[None, :]
        return out


def huber(residual: Floats, limit: float = 3.0) -> Floats:
    """Return weights in (0, 1] for residuals in standard deviations."""
    return np.minimum(1.0, limit / np.maximum(np.abs(residual), 1e-9))


def probabilities(evidence: Mapping[str, float], *, none: float = 0.0) -> dict[str, float]:
    """Return tempered probabilities of rival explanations; `none` explains with nothing [nats]."""
    values = np.array([*evidence.values(), none]) / TEMPER
    share = np.exp(values - values.max())
    share /= share.sum()
    return dict(zip([*evidence, "none"], share.tolist(), strict=True))
