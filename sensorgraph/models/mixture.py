"""Mixture model of one ray: p(z) = sum_i w_i N(z; r_i, s_i²), and no return with probability 1 - sum_i w_i.

A model supplies n candidates sorted by range r [m], with weights w and standard deviations s [m]. `leftover` is the
probability that none of them stops the ray: sum(w) + leftover = 1. `summarise` computes the fields of `Prediction`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.models.base import OFF_DISTANCE, POINTS, Point, Prediction
from sensorgraph.models.distribution import TAIL, chance_below, quantile_of
from sensorgraph.types import Bools, Floats

CLEAR_SHARE = 0.999
"""Share of one candidate above which the median is its range; the error is below 0.003 standard deviations."""
MIN_WEIGHT = 1e-12
"""Total weight of the candidates below which a return is not predicted."""
MEDIAN, MODE, MEAN, SIGMA, NO_RETURN, P_OFF = range(6)
"""Columns of the table that `summarise` fills."""


@inner_kernel
def median_of(r: Floats, w: Floats, s: Floats, first: int, last: int) -> float:
    """Solve sum_i w_i Φ((x - r_i) / s_i) = ½ sum_i w_i for the median x [m] of candidates first ... last - 1."""
    total = 0.0
    heaviest = first
    for i in range(first, last):
        total += w[i]
        if w[i] > w[heaviest]:
            heaviest = i
    if w[heaviest] >= CLEAR_SHARE * total:
        return float(r[heaviest])
    return quantile_of(r, w, s, first, last, 0.5 * total)


@inner_kernel
def densest(r: Floats, w: Floats, s: Floats, n: int) -> tuple[int, int]:
    """Return first and last (excluded) of the heaviest group of candidates within `TAIL` sigma of its first.

    This window holds all of one surface and little of the next; it was set by the median error of the mode
    (`python -m benchmarks.office_graph`, `python -m benchmarks.real_logs LOG`).
    """
    best, first, last = -1.0, 0, n
    for i in range(n):
        total = 0.0
        j = i
        while j < n and r[j] <= r[i] + TAIL * s[i]:
            total += w[j]
            j += 1
        if total > best:
            best, first, last = total, i, j
    return first, last


@outer_kernel
def summarise(
    r: Floats, w: Floats, s: Floats, n: int, leftover: float, farthest: float, which: int
) -> tuple[float, float, float, float, float, float]:
    """Summarise the mixture of one ray, with W = sum_i w_i and F(x) = sum_i w_i Φ((x - r_i) / s_i).

    Mean: mean = sum_i w_i r_i / W.
    Variance: sigma² = sum_i w_i ((r_i - mean)² + s_i²) / W.
    Median: F(median) = W / 2. Mode: the median of the heaviest group of candidates (`densest`).
    Probability of being off: p_off = 1 - (F(point + d) - F(point - d)) / W with d = `OFF_DISTANCE`.

    Parameters
    ----------
    r, w, s : (n or more,) Range [m], weight and standard deviation [m] > 0 of the candidates, sorted by r.
    n : Number of candidates; later entries are ignored.
    leftover : Probability of no return up to range_max.
    farthest : [m] Point value of a ray whose candidates have no weight.
    which : Index in `POINTS` of the point value that p_off refers to.

    Returns
    -------
    median, mode, mean, sigma [m] given a return, probability of no return, p_off
    """
    total = 0.0
    mean = 0.0
    for i in range(n):
        total += w[i]
        mean += w[i] * r[i]
    if total <= MIN_WEIGHT:
        return farthest, farthest, farthest, farthest, leftover, 1.0
    mean /= total
    variance = 0.0
    for i in range(n):
        variance += w[i] * ((r[i] - mean) ** 2 + s[i] ** 2)
    median = median_of(r, w, s, 0, n)
    first, last = densest(r, w, s, n)
    mode = median_of(r, w, s, first, last)
    point = mode if which == 0 else (median if which == 1 else mean)
    near = chance_below(point + OFF_DISTANCE, r, w, s, 0, n) - chance_below(
        point - OFF_DISTANCE, r, w, s, 0, n
    )
    off = min(max(1.0 - near / total, 0.0), 1.0)
    return median, mode, mean, math.sqrt(variance / total), leftover, off


def to_prediction(table: NDArray[np.float64], point: Point, answered: Bools) -> Prediction:
    """Convert summaries (n_poses, n_rays, 6) to a prediction; `table` was made with `which_of(point)`."""
    values = {"median": table[..., MEDIAN], "mode": table[..., MODE], "mean": table[..., MEAN]}
    none = table[..., NO_RETURN]
    return Prediction(
        ranges=np.where(none > 0.5, np.inf, values[point]), sigma=table[..., SIGMA], p_no_return=none,
        p_off=table[..., P_OFF], answered=answered, median=values["median"], mode=values["mode"],
        mean=values["mean"],
    )  # fmt: skip


def gaussian_prediction(
    value: Floats, sigma: Floats, p_no_return: Floats, p_off: Floats, answered: Bools
) -> Prediction:
    """Return the prediction of one Gaussian for each ray, whose median, mode and mean are equal; all (n_poses, n_rays)."""
    return Prediction(
        ranges=np.where(p_no_return > 0.5, np.inf, value), median=value, mode=value, mean=value, sigma=sigma,
        p_no_return=p_no_return, p_off=p_off, answered=answered,
    )  # fmt: skip


def which_of(point: Point) -> int:
    """Return the index of a point value, as `summarise` takes it."""
    return POINTS.index(point)
