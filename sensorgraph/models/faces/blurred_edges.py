"""Edges among crossings whose positions are uncertain due to the noise of the poses.

P(stop | t) = before + (after - before) Φ((t - s) / τ) for a crossing at t with standard error τ, and a sharp edge at s.

With noisy poses, rays on both sides of a sharp edge stop and pass. A partition that neglects this cuts the edge into
several spurious stretches, and their number grows with the length of the log. Here a stretch is kept only if it gains
more log likelihood over one blurred edge than its complexity penalty.

Crossings with similar standard errors at positions that these cannot distinguish are pooled, so the time depends on the
length of a face in standard errors, not on the length of the log.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, xlog1py, xlogy

from sensorgraph.models.faces.ray_march import MIN_VISIBILITY
from sensorgraph.models.faces.visibility import FIT_SIGMAS, PRIOR_CROSSINGS, PRIOR_STOPS
from sensorgraph.types import Floats, Ints

LEVEL_PASSES = 6
"""EM iterations of the visibility of stretches."""
SEARCH_ROUNDS, SEARCH_HALF = 4, 4
"""Number of searches for an edge's position, each on a finer grid, and positions on each side of the best one."""
WINDOW = FIT_SIGMAS
"""Distance from an edge within which a crossing may belong to either side, in standard errors."""
MAX_ERRORS = 2 * WINDOW
"""Maximum width of a stretch that may be the blur of one edge, in standard errors of a crossing: both its windows."""
MIN_CHANCE = MIN_VISIBILITY
"""Lower limit of probabilities in a log likelihood."""
MIN_ERROR = 1e-7
"""[m] Standard error below which the position of a crossing is exact."""
NEIGHBOURS = 10
"""Crossings on each side of a place that give its standard error."""
POOL_WIDTH, POOL_RATIO = 0.25, 1.25
"""Width of a pool, in standard errors, and ratio of the largest to the smallest standard error in it.

Both widen the blur: in terms of its variance by POOL_WIDTH² / 12 = 0.5 %, which no edge resolves."""


class Outcomes(NamedTuple):
    """Crossings of one face, sorted along it."""

    t: Floats
    """(n,) [m] abscissae."""
    stop: Floats
    """(n,) P(the ray was stopped here)."""
    weight: Floats
    """(n,) expected number of rays that reached the face."""
    error: Floats
    """(n,) [m] standard errors of the abscissae."""

    def between(self, low: float, high: float) -> Outcomes:
        """Return the crossings from one abscissa to another, the second not included."""
        some = slice(*np.searchsorted(self.t, [low, high]).tolist())
        return Outcomes(self.t[some], self.stop[some], self.weight[some], self.error[some])

    @property
    def blur(self) -> Floats:
        """(n,) [m] standard errors, above zero."""
        return np.maximum(self.error, MIN_ERROR)

    def mean_error(self, place: float | np.float64) -> float:
        """Return the mean standard error [m] of the crossings next to a position; 0 without any."""
        middle = int(np.searchsorted(self.t, place))
        near = self.error[max(middle - NEIGHBOURS, 0) : middle + NEIGHBOURS]
        return float(near.mean()) if len(near) else 0.0


def blur_edges(
    crossings: Outcomes, edges: Floats, levels: Floats, errors: Floats, penalty: float
) -> tuple[Floats, Floats, Floats]:
    """Remove stretches that one blurred edge explains, and move the other edges to the maximum of the likelihood.

    Stretches are tested from narrow to wide. A stretch is removed if the log likelihood of one blurred edge, plus
    `penalty`, is at least that of the two edges of the stretch.

    Parameters
    ----------
    edges, levels, errors : (m + 1,) Edges of its stretches, visibility after each (the last is 0), standard errors [m].
    penalty : [nats] Complexity penalty of a stretch.

    Returns
    -------
    edges, levels, errors (k + 1,), k <= m
    """
    e, se, pools = edges.copy(), errors.copy(), pooled(*crossings)
    sums = np.zeros((2, len(crossings.t) + 1))
    np.cumsum([crossings.stop * crossings.weight, crossings.weight], axis=1, out=sums[:, 1:])
    level = _fit_levels(pools, e, levels)
    is_kept = np.zeros(len(e), dtype=np.bool_)
    while True:
        widths = np.where(is_kept, np.inf, np.diff(e, append=np.inf))
        widths[[0, *range(len(e) - 2, len(e))]] = np.inf
        j = int(widths.argmin())
        if is_kept[j] or not 0 < j < len(e) - 2:
            break
        is_kept[j] = True
        spread = crossings.mean_error(0.5 * (e[j] + e[j + 1]))
        if widths[j] > MAX_ERRORS * spread:
            continue
        low, high = max(e[j - 1], e[j] - WINDOW * spread), min(e[j + 2], e[j + 1] + WINDOW * spread)
        around, three = pools.between(low, high), level[j - 1 : j + 2]
        bounds = np.searchsorted(crossings.t, np.clip(e[j - 1 : j + 3], low, high))
        stopped, crossed = np.diff(sums[:, bounds])
        exact = _log_likelihood(stopped / np.maximum(crossed, 1e-300), crossed, three)
        two_edges = max(float(exact), _two_edges(around, three, e[j], e[j + 1]))
        place, one_edge = _best_place(around, three[0], three[2], e[j], e[j + 1])
        if one_edge + penalty < two_edges:
            continue
        e[j], se[j] = place, max(se[j], se[j + 1])
        e, se, level = np.delete(e, j + 1), np.delete(se, j + 1), np.delete(level, j)
        is_kept = np.delete(is_kept, j + 1)
        is_kept[j - 1 : j + 1] = False
        level = _fit_levels(pools, e, level)
    for j in range(1, len(e) - 1):
        spread = crossings.mean_error(e[j])
        if spread < MIN_ERROR:
            continue
        low, high = max(e[j - 1], e[j] - WINDOW * spread), min(e[j + 1], e[j] + WINDOW * spread)
        around, near = pools.between(low, high), 0.5 * WINDOW * spread
        left, right = max(e[j] - near, 0.5 * (e[j] + e[j - 1])), min(e[j] + near, 0.5 * (e[j] + e[j + 1]))
        e[j] = _best_place(around, level[j - 1], level[j], left, right)[0]
        known = _information(around, level[j - 1], level[j], e[j])
        se[j] = min(math.sqrt(se[j] ** 2 + 1.0 / max(known, 1e-12)), spread)
    return e, _fit_levels(pools, e, level), se


def pooled(t: Floats, stop: Floats, weight: Floats, error: Floats) -> Outcomes:
    """Pool crossings whose positions and standard errors are alike; return fewer, sorted along the face."""
    t, stop, weight, error = (values[weight > 0] for values in (t, stop, weight, error))
    size = np.floor(np.log(np.maximum(error, MIN_ERROR)) / math.log(POOL_RATIO))
    place = np.floor(t / (POOL_WIDTH * POOL_RATIO**size))
    order = np.lexsort((place, size))
    is_new = [np.diff(values[order], prepend=np.nan) != 0 for values in (size, place)]
    start = np.flatnonzero(is_new[0] | is_new[1])
    total = np.add.reduceat(weight[order], start)
    t, stop, error = (np.add.reduceat((weight * x)[order], start) / total for x in (t, stop, error))
    order = np.argsort(t, kind="stable")
    return Outcomes(t[order], stop[order], total[order], error[order])


def edge_log_likelihood(crossings: Outcomes, before: float, after: float, place: Floats) -> Floats:
    """Return the log likelihood [nats] of crossings for one blurred edge at each of some abscissae (k,)."""
    x = (crossings.t - place[:, None]) / crossings.blur
    return _log_likelihood(crossings.stop, crossings.weight, before + (after - before) * ndtr(x))


def _log_likelihood(y: Floats, w: Floats, p: Floats) -> Floats:
    """Return the log likelihood [nats] of outcomes y (n,) with weights w (n,) for probabilities p (..., n)."""
    p = np.clip(p, MIN_CHANCE, 1.0 - MIN_CHANCE)
    return np.asarray((w * (xlogy(y, p) + xlog1py(1.0 - y, -p))).sum(axis=-1))


def _two_edges(crossings: Outcomes, levels: Floats, first: float, second: float) -> float:
    """Return the log likelihood of crossings for two blurred edges between three levels (3,)."""
    p = levels[0] + (levels[1] - levels[0]) * ndtr((crossings.t - first) / crossings.blur)
    p += (levels[2] - levels[1]) * ndtr((crossings.t - second) / crossings.blur)
    return float(_log_likelihood(crossings.stop, crossings.weight, p))


def _best_place(
    crossings: Outcomes, before: float, after: float, low: float, high: float
) -> tuple[float, float]:
    """Return the position between low and high at which one blurred edge is most likely, and its log likelihood."""
    best, centre, half = -np.inf, 0.5 * (low + high), 0.5 * (high - low)
    place = centre
    for _ in range(SEARCH_ROUNDS):
        tried = centre + half * np.arange(-SEARCH_HALF, SEARCH_HALF + 1) / SEARCH_HALF
        tried = tried[(tried >= low) & (tried <= high)]
        nats = edge_log_likelihood(crossings, before, after, tried)
        k = int(nats.argmax())
        if nats[k] > best:
            best, place = float(nats[k]), float(tried[k])
        centre, half = place, half / SEARCH_HALF
    return place, best


def _information(crossings: Outcomes, before: float, after: float, place: float) -> float:
    """Return sum_i w_i (dp_i/ds)² / (p_i (1 - p_i)): the Fisher information [1/m²] of a blurred edge's position."""
    x = (crossings.t - place) / crossings.blur
    p = np.clip(before + (after - before) * ndtr(x), MIN_CHANCE, 1.0 - MIN_CHANCE)
    slope = (after - before) * np.exp(-0.5 * x * x) / (math.sqrt(2 * math.pi) * crossings.blur)
    return float((crossings.weight * slope**2 / (p * (1.0 - p))).sum())


def _fit_levels(crossings: Outcomes, e: Floats, levels: Floats) -> Floats:
    """Estimate the visibility alpha_k of n - 1 stretches by EM; a crossing near an edge may belong to the adjacent stretch.

    A crossing at t with standard error tau lies in its stretch j with the probability q_j = 1 - q_(j-1) - q_(j+1), where
    q_(j-1) = Φ((e_j - t) / tau) and q_(j+1) = Φ((t - e_(j+1)) / tau). With its outcome y, its weight w and p = sum_k q_k alpha_k:

        E step: hit_k = q_k alpha_k / p, miss_k = q_k (1 - alpha_k) / (1 - p).
        M step: alpha_k = (sum w y hit_k + PRIOR_STOPS) / (sum w (y hit_k + (1 - y) miss_k) + PRIOR_CROSSINGS).

    Parameters
    ----------
    e, levels : (n,) edges, and visibility after each (the last is 0).
    """
    n, level = len(e), levels.copy()
    t, stop, weight, _ = crossings
    j = np.searchsorted(e[1:-1], t, side="right")
    has_left, has_right = j > 0, j < n - 2
    reach = WINDOW * crossings.error
    is_near = (has_left & (t - e[j] < reach)) | (has_right & (e[j + 1] - t < reach))
    if not is_near.any():
        return level
    stopped, crossed = _totals(j[~is_near], n, (stop * weight)[~is_near], weight[~is_near])
    t, j, y, w, tau = t[is_near], j[is_near], stop[is_near], weight[is_near], crossings.blur[is_near]
    left = np.where(j > 0, ndtr((e[j] - t) / tau), 0.0)
    right = np.where(j < n - 2, ndtr((t - e[j + 1]) / tau), 0.0)
    q = np.array([left, np.maximum(1.0 - left - right, 0.0), right])
    k = np.clip([j - 1, j, j + 1], 0, n - 2)
    for _ in range(LEVEL_PASSES):
        alpha = level[k]
        p = np.clip((q * alpha).sum(axis=0), MIN_CHANCE, 1.0 - MIN_CHANCE)
        hit, miss = w * y * q * alpha / p, w * (1.0 - y) * q * (1.0 - alpha) / (1.0 - p)
        now, all_ = _totals(k.ravel(), n, hit.ravel(), (hit + miss).ravel())
        level[:-1] = np.clip((stopped + now + PRIOR_STOPS) / (crossed + all_ + PRIOR_CROSSINGS), 0.0, 1.0)
    level[-1] = 0.0
    return level


def _totals(k: Ints, n: int, *values: Floats) -> list[Floats]:
    """Return the sums (n - 1,) of values over each stretch."""
    return [np.bincount(k, weights=x, minlength=n - 1).astype(np.float64) for x in values]
