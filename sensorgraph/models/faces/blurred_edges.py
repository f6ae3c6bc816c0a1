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
from typing import Any

import numpy as np

from planners.kernel import inner_kernel, kernel, outer_kernel
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY
from sensorgraph.models.faces.visibility import FIT_SIGMAS, PRIOR_CROSSINGS, PRIOR_STOPS
from sensorgraph.types import Floats

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
POOL_WIDTH, POOL_RATIO = 0.25, 1.25
"""Width of a pool, in standard errors, and ratio of the largest to the smallest standard error in it.

Both widen the blur: in terms of its variance by POOL_WIDTH² / 12 = 0.5 %, which no edge resolves."""


@kernel
def blur_edges(
    t: Any, stop: Any, weight: Any, error: Any, pools: Any, edges: Any, levels: Any, errors: Any, penalty: Any
) -> Any:
    """Remove stretches that one blurred edge explains, and move the other edges to the maximum of the likelihood.

    Stretches are tested from narrow to wide. A stretch is removed if the log likelihood of one blurred edge, plus
    `penalty`, is at least that of the two edges of the stretch.

    Parameters
    ----------
    t, stop, weight, error : (n,) Crossings of one face as in `Crossings`, sorted.
    pools : The same four arrays of `pooled` crossings.
    edges, levels, errors : (m + 1,) Edges of its stretches, visibility after each (the last is 0), standard errors [m].
    penalty : [nats] Complexity penalty of a stretch.

    Returns
    -------
    edges, levels, errors (k + 1,), k <= m
    """
    e, level, se = edges.copy(), levels.copy(), errors.copy()
    n = len(e)
    places, spreads, sums = t, error, np.zeros((len(t) + 1, 2))
    for i in range(len(t)):
        sums[i + 1, 0], sums[i + 1, 1] = sums[i, 0] + stop[i] * weight[i], sums[i, 1] + weight[i]
    t, stop, weight, error = pools
    _fit_levels(t, stop, weight, error, e, level, n)
    is_kept = np.zeros(n, np.bool_)
    while True:
        j, width = -1, np.inf
        for k in range(1, n - 2):
            if not is_kept[k] and e[k + 1] - e[k] < width:
                j, width = k, e[k + 1] - e[k]
        if j < 0:
            break
        is_kept[j] = True
        spread = mean_error(places, spreads, 0.5 * (e[j] + e[j + 1]))
        if width > MAX_ERRORS * spread:
            continue
        low, high = max(e[j - 1], e[j] - WINDOW * spread), min(e[j + 2], e[j + 1] + WINDOW * spread)
        a, b = np.searchsorted(t, low), np.searchsorted(t, high)
        before, own, after = level[j - 1], level[j], level[j + 1]
        exact = 0.0
        for k in range(j - 1, j + 2):
            first, last = (
                np.searchsorted(places, max(e[k], low)),
                np.searchsorted(places, min(e[k + 1], high)),
            )
            crossed = sums[last, 1] - sums[first, 1]
            exact += _log_likelihood(
                (sums[last, 0] - sums[first, 0]) / max(crossed, 1e-300), crossed, level[k]
            )
        two_edges = max(exact, _two_edges(t, stop, weight, error, a, b, before, own, after, e[j], e[j + 1]))
        place, one_edge = _best_place(t, stop, weight, error, a, b, before, after, e[j], e[j + 1])
        if one_edge + penalty < two_edges:
            continue
        e[j], se[j] = place, max(se[j], se[j + 1])
        for k in range(j + 1, n - 1):
            e[k], se[k], is_kept[k] = e[k + 1], se[k + 1], is_kept[k + 1]
        for k in range(j, n - 1):
            level[k] = level[k + 1]
        n -= 1
        is_kept[j - 1] = is_kept[j] = False
        _fit_levels(t, stop, weight, error, e, level, n)
    for j in range(1, n - 1):
        spread = mean_error(places, spreads, e[j])
        if spread < MIN_ERROR:
            continue
        low, high = max(e[j - 1], e[j] - WINDOW * spread), min(e[j + 1], e[j] + WINDOW * spread)
        a, b = np.searchsorted(t, low), np.searchsorted(t, high)
        near = 0.5 * WINDOW * spread
        left, right = max(e[j] - near, 0.5 * (e[j] + e[j - 1])), min(e[j] + near, 0.5 * (e[j] + e[j + 1]))
        e[j] = _best_place(t, stop, weight, error, a, b, level[j - 1], level[j], left, right)[0]
        known = _information(t, weight, error, a, b, level[j - 1], level[j], e[j])
        se[j] = min(math.sqrt(se[j] ** 2 + 1.0 / max(known, 1e-12)), spread)
    _fit_levels(t, stop, weight, error, e, level, n)
    return e[:n], level[:n], se[:n]


def pooled(t: Floats, stop: Floats, weight: Floats, error: Floats) -> tuple[Floats, ...]:
    """Pool crossings whose positions and standard errors are alike; return the same four arrays, shorter and sorted."""
    t, stop, weight, error = (values[weight > 0] for values in (t, stop, weight, error))
    size = np.floor(np.log(np.maximum(error, MIN_ERROR)) / math.log(POOL_RATIO))
    place = np.floor(t / (POOL_WIDTH * POOL_RATIO**size))
    order = np.lexsort((place, size))
    is_new = [np.diff(values[order], prepend=np.nan) != 0 for values in (size, place)]
    start = np.flatnonzero(is_new[0] | is_new[1])
    total = np.add.reduceat(weight[order], start)
    t, stop, error = (np.add.reduceat((weight * x)[order], start) / total for x in (t, stop, error))
    order = np.argsort(t, kind="stable")
    return t[order], stop[order], total[order], error[order]


@inner_kernel
def _normal_cdf(x: Any) -> Any:
    """Return Φ(x)."""
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@kernel
def mean_error(t: Any, error: Any, place: Any) -> Any:
    """Return the mean standard error [m] of the crossings next to a position."""
    middle: Any = np.searchsorted(t, place)
    total, count = 0.0, 0
    for i in range(max(middle - 10, 0), min(middle + 10, len(t))):
        total += error[i]
        count += 1
    return total / max(count, 1)


@inner_kernel
def _log_likelihood(y: Any, w: Any, p: Any) -> Any:
    p = min(max(p, MIN_CHANCE), 1.0 - MIN_CHANCE)
    return w * (y * math.log(p) + (1.0 - y) * math.log(1.0 - p))


@outer_kernel
def edge_log_likelihood(
    t: Any, stop: Any, weight: Any, error: Any, a: Any, b: Any, before: Any, after: Any, place: Any
) -> Any:
    """Return the log likelihood [nats] of crossings a ... b - 1 for one blurred edge at abscissa `place`."""
    total = 0.0
    for i in range(a, b):
        p = before + (after - before) * _normal_cdf((t[i] - place) / max(error[i], MIN_ERROR))
        total += _log_likelihood(stop[i], weight[i], p)
    return total


@inner_kernel
def _two_edges(
    t: Any, stop: Any, weight: Any, error: Any, a: Any, b: Any, before: Any, own: Any, after: Any,
    first: Any, second: Any,
) -> Any:  # fmt: skip
    """Return the log likelihood of crossings a ... b - 1 for two blurred edges."""
    total = 0.0
    for i in range(a, b):
        tau = max(error[i], MIN_ERROR)
        p = before + (own - before) * _normal_cdf((t[i] - first) / tau)
        p += (after - own) * _normal_cdf((t[i] - second) / tau)
        total += _log_likelihood(stop[i], weight[i], p)
    return total


@inner_kernel
def _best_place(
    t: Any, stop: Any, weight: Any, error: Any, a: Any, b: Any, before: Any, after: Any, low: Any, high: Any
) -> Any:
    """Return the position between low and high at which one blurred edge is most likely, and its log likelihood."""
    best, place = -np.inf, 0.5 * (low + high)
    centre, half = place, 0.5 * (high - low)
    for _ in range(SEARCH_ROUNDS):
        for k in range(-SEARCH_HALF, SEARCH_HALF + 1):
            s = centre + half * k / SEARCH_HALF
            if s < low or s > high:
                continue
            total = edge_log_likelihood(t, stop, weight, error, a, b, before, after, s)
            if total > best:
                best, place = total, s
        centre, half = place, half / SEARCH_HALF
    return place, best


@inner_kernel
def _information(t: Any, weight: Any, error: Any, a: Any, b: Any, before: Any, after: Any, place: Any) -> Any:
    """Return sum_i w_i (dp_i/ds)² / (p_i (1 - p_i)): the Fisher information [1/m²] of a blurred edge's position."""
    total = 0.0
    for i in range(a, b):
        tau = max(error[i], MIN_ERROR)
        x = (t[i] - place) / tau
        p = min(max(before + (after - before) * _normal_cdf(x), MIN_CHANCE), 1.0 - MIN_CHANCE)
        slope = (after - before) * 0.3989422804014327 * math.exp(-0.5 * x * x) / tau
        total += weight[i] * slope * slope / (p * (1.0 - p))
    return total


@kernel
def _fit_levels(t: Any, stop: Any, weight: Any, error: Any, e: Any, level: Any, n: Any) -> Any:
    """Set the visibility alpha_k of n - 1 stretches by EM; a crossing near an edge may belong to the adjacent stretch.

    A crossing at t with standard error tau lies in its stretch j with the probability q_j = 1 - q_(j-1) - q_(j+1), where
    q_(j-1) = Φ((e_j - t) / tau) and q_(j+1) = Φ((t - e_(j+1)) / tau). With its outcome y, its weight w and p = sum_k q_k alpha_k:

        E step: hit_k = q_k alpha_k / p, miss_k = q_k (1 - alpha_k) / (1 - p).
        M step: alpha_k = (sum w y hit_k + PRIOR_STOPS) / (sum w (y hit_k + (1 - y) miss_k) + PRIOR_CROSSINGS).
    """
    stopped, crossed = np.zeros(n), np.zeros(n)
    near, shares, count = np.empty(len(t), np.int64), np.empty((len(t), 2)), 0
    j = 0
    for i in range(len(t)):
        while j < n - 2 and t[i] >= e[j + 1]:
            j += 1
        reach = WINDOW * error[i]
        if (j > 0 and t[i] - e[j] < reach) or (j < n - 2 and e[j + 1] - t[i] < reach):
            tau = max(error[i], MIN_ERROR)
            near[count] = i
            shares[count, 0] = _normal_cdf((e[j] - t[i]) / tau) if j > 0 else 0.0
            shares[count, 1] = _normal_cdf((t[i] - e[j + 1]) / tau) if j < n - 2 else 0.0
            count += 1
        else:
            stopped[j] += stop[i] * weight[i]
            crossed[j] += weight[i]
    if count == 0:
        return
    now, all_ = np.empty(n), np.empty(n)
    for _ in range(LEVEL_PASSES):
        for k in range(n):
            now[k], all_[k] = stopped[k], crossed[k]
        j = 0
        for m in range(count):
            i = near[m]
            while j < n - 2 and t[i] >= e[j + 1]:
                j += 1
            left, right = shares[m]
            share = max(1.0 - left - right, 0.0)
            p = share * level[j]
            if j > 0:
                p += left * level[j - 1]
            if j < n - 2:
                p += right * level[j + 1]
            p = min(max(p, MIN_CHANCE), 1.0 - MIN_CHANCE)
            y, w = stop[i], weight[i]
            for k in range(max(j - 1, 0), min(j + 2, n - 1)):
                chance = share if k == j else (left if k < j else right)
                hit = chance * level[k] / p
                miss = chance * (1.0 - level[k]) / (1.0 - p)
                now[k] += w * y * hit
                all_[k] += w * (y * hit + (1.0 - y) * miss)
        for k in range(n - 1):
            level[k] = min(max((now[k] + PRIOR_STOPS) / (all_[k] + PRIOR_CROSSINGS), 0.0), 1.0)
    level[n - 1] = 0.0
