"""Trends of a robot over its logs: constant, steps, or a drift, compared by their evidence.

Each value has a standard error, and logs of one robot scatter further (floor, load, driving) by an unknown τ. With
Student's t errors of scale sqrt(σ² + τ²), the evidence of a model is its likelihood averaged over the prior of its
parameters. A step costs the share of the prior that fits, so that no threshold is needed (the Occam factor; MacKay
2003, chapter 28). After a step, both sides are searched again (Fearnhead 2006 gives the exact recursion).

Robots are compared with the population of their sisters, whose centre and spread are averaged over as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp

from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats

DEGREES = 4.0
"""Degrees of freedom of the errors of a log."""
LEVEL_DEGREES = 30.0
"""The same of the level of a robot, a mean over many logs."""
PRIOR_CHANGE = 0.01
"""Prior probability of a change between two logs of a robot, for each quantity; as often a drift over all logs."""
PRIOR_ODD = 0.05
"""Prior probability that a robot differs from its sisters in a quantity."""
SURE = 0.95
"""Probability from which a change or a difference is stated; less probable ones are listed as possible."""
MIN_LOGS, MIN_SISTERS = 4, 3
"""Number of logs of a trend, and of robots of one kind, below which nothing is compared."""
N_GRID, N_SCATTER, N_SLOPES = 161, 7, 41
"""Numbers of values on which centre, scatter and slope are averaged."""
SPREAD = {
    "way_scale": 0.03, "turn_scale": 0.03, "heading_bias": 0.05, "mount_x": 0.05, "mount_y": 0.05, "mount_phi": 0.05,
    "delay": 0.1, "left_wheel": 0.03, "right_wheel": 0.03, "wheel_difference": 0.03, "range_offset": 0.05,
}  # fmt: skip
"""Quantity -> prior standard deviation of a change: tyres lose a few percent, a knock turns a laser by degrees
[1, 1, rad/m, m, m, rad, s, 1, 1, 1, m]."""


@dataclass(frozen=True, kw_only=True)
class TrendStep:
    """A change between two logs of a robot."""

    quantity: str
    before: int
    """Index of the last log before it."""
    size: float
    sigma: float
    probability: float
    is_drift: bool = False
    """The quantity drifts over all logs from first to last; `size` is the total."""


@dataclass(frozen=True, kw_only=True)
class OddRobot:
    """A robot that differs from its sisters in one quantity."""

    robot: str
    quantity: str
    size: float
    """Difference from the centre of the others."""
    sigma: float
    probability: float


def steps_of(quantity: str, t: Floats, values: Floats, sigmas: Floats) -> list[TrendStep]:
    """Return the changes of one quantity of one robot, most probable first.

    Parameters
    ----------
    t : (n,) [s] Times of the logs, increasing.
    values, sigmas : (n,) Values with standard errors.
    """
    if len(t) < MIN_LOGS:
        return []
    grid = _Grid.of(values, sigmas, SPREAD[quantity])
    found = _split(quantity, grid, 0, len(t), np.asarray(t, dtype=np.float64))
    return sorted(found, key=lambda one: -one.probability)


def change_at(
    quantity: str, t: Floats, values: Floats, sigmas: Floats, at: float, is_drift: bool
) -> tuple[float, float]:
    """Return the change of a quantity at a given time, or its drift, with its standard error.

    Parameters
    ----------
    t : (n,) [s] Times of the logs, increasing.
    at : [s] Time of the last log before the change. Without a log on either side, the standard error is infinite.
    """
    n, before = len(t), int(np.sum(t <= at))
    if n < 2 or not (is_drift or 0 < before < n):
        return 0.0, np.inf
    grid = _Grid.of(values, sigmas, SPREAD[quantity])
    if is_drift:
        return _slope(grid, 0, n, t)
    (one, one_error), (two, two_error) = grid_mean(grid, 0, before), grid_mean(grid, before, n)
    return two - one, float(np.hypot(one_error, two_error))


def profile(t: Floats, at: float, *, is_drift: bool) -> Floats:
    """Return how much of a change each log has (n,): 0 until its time and 1 after it, or the share of a drift."""
    if is_drift:
        return np.asarray((t - t[0]) / max(t[-1] - t[0], 1e-9))
    return np.asarray((t > at).astype(np.float64))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Grid:
    """Likelihoods of values on a grid of centres and scatters."""

    centres: Floats
    """(n_grid,)"""
    scatters: Floats
    """(n_scatter,)"""
    values: Floats
    sigmas: Floats
    width: float
    """Prior standard deviation of a change."""
    log_likelihood: Floats
    """(n, n_grid, n_scatter)"""

    @classmethod
    def of(cls, values: Floats, sigmas: Floats, width: float, v: float = DEGREES) -> _Grid:
        middle = float(np.median(values))
        reach = max(4 * width, float(np.abs(values - middle).max()) + 3 * float(np.median(sigmas)))
        # fine in the middle, where precise logs lie, and coarse outside
        u = np.linspace(-1, 1, N_GRID)
        fine = max(float(np.median(sigmas)) / np.sqrt(len(values)), reach * 1e-4)
        centres = middle + np.sinh(u * np.arcsinh(reach / (4 * fine))) * 4 * fine
        scatters = np.concatenate([[0.0], np.geomspace(float(np.median(sigmas)) / 4, width, N_SCATTER - 1)])
        ll = _student(values[:, None, None] - centres[:, None], sigmas[:, None, None], scatters, v)
        return cls(
            centres=centres, scatters=scatters, values=values, sigmas=sigmas, width=width, log_likelihood=ll
        )

    def prior(self, middle: float) -> Floats:
        """Return the log weights (n_grid,) of the centres under a normal prior around a value."""
        w = -0.5 * ((self.centres - middle) / self.width) ** 2 + np.log(np.gradient(self.centres))
        return np.asarray(w - logsumexp(w))


def _student(off: Floats, sigmas: Floats, scatters: Floats, v: float = DEGREES) -> Floats:
    """Return the log density of Student's t, whose scale is that of the given standard errors."""
    scale = np.sqrt((sigmas**2 + scatters**2) * (v - 2) / v)
    const = gammaln((v + 1) / 2) - gammaln(v / 2) - 0.5 * np.log(v * np.pi)
    return np.asarray(const - np.log(scale) - (v + 1) / 2 * np.log1p((off / scale) ** 2 / v))


def _split(
    quantity: str, grid: _Grid, a: int, b: int, t: Floats, *, is_whole: bool = True
) -> list[TrendStep]:
    """Return the steps among logs a to b, by comparing one step at each place, a drift, and none."""
    n = b - a
    if n < MIN_LOGS:
        return []
    ll = grid.log_likelihood[a:b]
    prior = grid.prior(float(np.median(grid.values)))[:, None]
    ahead = np.cumsum(ll, axis=0)  # (n, n_grid, n_scatter)
    total = ahead[-1]
    constant = _over_scatter(logsumexp(total + prior, axis=0))
    left, right = ahead[:-1], total - ahead[:-1]
    # the centre before is free; the one after it is the one before plus a normal change of the prior width
    change = -0.5 * ((grid.centres[:, None] - grid.centres) / grid.width) ** 2 + np.log(
        np.gradient(grid.centres)
    )
    change -= logsumexp(change, axis=1, keepdims=True)
    after = np.stack(
        [_matrix(change, right[k] + 0.0) for k in range(n - 1)]
    )  # (n - 1, n_grid, n_scatter): evidence of the rest, given the centre before
    places = logsumexp(left + prior + after, axis=1)  # (n - 1, n_scatter)
    by_place = np.array([_over_scatter(one) for one in places])
    log_odds_step = np.log(PRIOR_CHANGE) + by_place - constant
    drift = _drift(grid, a, b, t, prior) if is_whole else -np.inf
    log_odds_drift = np.log(PRIOR_CHANGE) + drift - constant
    step, none = float(logsumexp(log_odds_step)), 0.0
    weight = logsumexp([step, log_odds_drift, none])
    p_change = float(np.exp(logsumexp([step, log_odds_drift]) - weight))
    if p_change < MAJORITY:
        return []
    if log_odds_drift > step:
        slope, error = _slope(grid, a, b, t)
        return [
            TrendStep(
                quantity=quantity, before=a, size=slope, sigma=error, probability=p_change, is_drift=True
            )
        ]
    k = int(np.argmax(by_place))
    sides = (a, a + k + 1), (a + k + 1, b)
    (one, one_error), (two, two_error) = (grid_mean(grid, *side) for side in sides)
    found = TrendStep(
        quantity=quantity,
        before=a + k,
        size=two - one,
        sigma=float(np.hypot(one_error, two_error)),
        probability=p_change,
    )
    return [found, *(one for side in sides for one in _split(quantity, grid, *side, t, is_whole=False))]


def _matrix(log_a: Floats, log_b: Floats) -> Floats:
    """Return log(exp(log_a) @ exp(log_b)) for (m, m) and (m, s)."""
    top = log_b.max(axis=0, keepdims=True)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.exp(log_a) @ np.exp(log_b - top)) + top)


def _over_scatter(log_evidence: Floats) -> float:
    return float(logsumexp(log_evidence) - np.log(len(log_evidence)))


def _drift(grid: _Grid, a: int, b: int, t: Floats, prior: Floats) -> float:
    """Return the log evidence of a drift in time."""
    share = (t[a:b] - t[a]) / max(t[b - 1] - t[a], 1e-9) - 0.5
    slopes = np.linspace(-3, 3, N_SLOPES) * grid.width  # per whole time
    weights = -0.5 * (slopes / grid.width) ** 2
    weights -= logsumexp(weights)
    out = []
    for slope, weight in zip(slopes, weights, strict=True):
        off = (grid.values[a:b] - slope * share)[:, None, None] - grid.centres[:, None]
        ll = _student(off, grid.sigmas[a:b, None, None], grid.scatters).sum(axis=0)
        out.append(weight + logsumexp(ll + prior, axis=0))
    return _over_scatter(logsumexp(np.array(out), axis=0))


def _slope(grid: _Grid, a: int, b: int, t: Floats) -> tuple[float, float]:
    """Return the total change of a drift by weighted least squares, with its standard error."""
    share = (t[a:b] - t[a]) / max(t[b - 1] - t[a], 1e-9)
    rows = np.column_stack([np.ones(b - a), share]) / grid.sigmas[a:b, None]
    fit, *_ = np.linalg.lstsq(rows, grid.values[a:b] / grid.sigmas[a:b], rcond=None)
    covariance = np.linalg.pinv(rows.T @ rows)
    scatter = max(1.0, float(np.mean((rows @ fit - grid.values[a:b] / grid.sigmas[a:b]) ** 2)))
    return float(fit[1]), float(np.sqrt(covariance[1, 1] * scatter))


def grid_mean(grid: _Grid, a: int, b: int) -> tuple[float, float]:
    """Return the mean and the standard deviation of the centre of logs a to b."""
    w = grid.log_likelihood[a:b].sum(axis=0) + grid.prior(float(np.median(grid.values)))[:, None]
    p = np.exp(w - logsumexp(w)).sum(axis=1)
    mean = float(p @ grid.centres)
    return mean, float(np.sqrt(max(p @ (grid.centres - mean) ** 2, 0.0)))


def level(quantity: str, values: Floats, sigmas: Floats) -> tuple[float, float]:
    """Return the level of logs without a change, with its standard error."""
    grid = _Grid.of(values, sigmas, SPREAD[quantity])
    return grid_mean(grid, 0, len(values))


def odd_robots(quantity: str, levels: Mapping[str, tuple[float, float]]) -> list[OddRobot]:
    """Return the robots that differ from their sisters in a quantity.

    Parameters
    ----------
    levels : Robot -> level and standard error, of robots of one kind.
    """
    if len(levels) < MIN_SISTERS:
        return []
    width, out = SPREAD[quantity], []
    for robot, (value, sigma) in levels.items():
        others = np.array([one for name, one in levels.items() if name != robot])
        grid = _Grid.of(others[:, 0], others[:, 1], width, LEVEL_DEGREES)
        weight = grid.log_likelihood.sum(axis=0) + grid.prior(float(np.median(others[:, 0])))[:, None]
        weight = weight - logsumexp(weight)  # (n_grid, n_scatter): centre and spread of the others
        off = value - grid.centres[:, None]
        same, own = (
            logsumexp(weight + _student(off, np.array(error), grid.scatters, LEVEL_DEGREES))
            for error in (sigma, np.hypot(sigma, width))
        )
        odds = np.log(PRIOR_ODD / (1 - PRIOR_ODD)) + own - same
        probability = float(1 / (1 + np.exp(-odds)))
        if probability >= MAJORITY:
            p = np.exp(weight).sum(axis=1)
            centre = float(p @ grid.centres)
            error = float(np.sqrt(p @ (grid.centres - centre) ** 2 + sigma**2))
            out.append(
                OddRobot(
                    robot=robot, quantity=quantity, size=value - centre, sigma=error, probability=probability
                )
            )
    return out
