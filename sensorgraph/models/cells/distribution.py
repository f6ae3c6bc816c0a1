"""Distribution of a reading among cells: the candidates of a ray, weighted so that the chance of being off is right.

The march gives candidates with weights w_i about ranges r_i. The scans set aside tell how often a reading is further than
d = `OFF_DISTANCE` from the mode m (`probability_calibration`): the chance p, where the weights say another one. Candidates
with |r_i - m| <= d are multiplied by a and the others by b, such that

    a A + b B = A + B,  a A' + b B' = p (A + B).

A and B are the weights of both groups, A' and B' the parts of them that lie further than d from the mode.

Errors of a reading about its face are a scale mixture of normals (Andrews and Mallows 1974), because some places and
poses are worse than others. A candidate of standard deviation s_i has the errors

    (1 - q) N(0, u² s_i²) + q N(0, v² s_i²),  (1 - q) u² + q v² = 1,

so that s_i remains the standard deviation. `fit_tails` estimates q, u and v from the scans set aside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from planners.kernel import inner_kernel, kernel, outer_kernel
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.cells.evidence import MIN_RANGE
from sensorgraph.models.cells.grid import per_ray
from sensorgraph.models.cells.learning import SetAside
from sensorgraph.models.cells.ray_march import MAX_MERGED, CellTable, RayWork, candidates_of, new_work
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.distribution import DENSITY_AT_0, SQRT_HALF, TAIL, count_of, density_at, total_of
from sensorgraph.models.likelihood import MIN_DENSITY, log_density_of
from sensorgraph.models.mixture import MIN_WEIGHT, densest, median_of
from sensorgraph.types import Bools, Floats

KNOTS = np.array([0.0, 0.03, 0.07, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95, 1.0])
"""Predicted probabilities of being off between which the correction is linear."""
KNOT_WEIGHT = 20.0
"""Weight of the prediction at each knot, and of the initial spread and tails, in returns."""
FIRST_TAILS, TAIL_STEPS = (0.2, 0.7, 1.7), 12
"""Initial share of wide errors, and factors of the standard deviation of narrow and wide ones; number of EM steps."""
NORMAL_TAILS = np.array([0.0, 1.0, 1.0])
"""Tails of normal errors: share of wide ones, and factors of the standard deviation."""
OUTLIER_DENSITY = 1e-3
"""[1/m] Density of outliers: returns that no face explains."""
MAX_UNSEEN_LENGTH = CELLS.max_unseen_length


@inner_kernel
def calibrated(p: float, reliability: Floats) -> float:
    """Return the observed chance of being off at the predicted chance p, linear between `KNOTS`."""
    k = 1
    while k < len(KNOTS) - 1 and p > KNOTS[k]:
        k += 1
    share = float((p - KNOTS[k - 1]) / (KNOTS[k] - KNOTS[k - 1]))
    low, high = float(reliability[k - 1]), float(reliability[k])
    return low + min(max(share, 0.0), 1.0) * (high - low)


@inner_kernel
def chance_off(x: float, s: float) -> float:
    """Return the chance that a reading about a candidate at a distance x [m] from the mode is off; s [m] is its spread."""
    below, above = (OFF_DISTANCE - x) / s, (OFF_DISTANCE + x) / s
    if below < -TAIL:
        return 1.0
    if below >= TAIL:
        return 0.0
    off = 0.5 * math.erfc(below * SQRT_HALF)
    return off + 0.5 * math.erfc(above * SQRT_HALF) if above < TAIL else off


@inner_kernel
def shape_mixture(
    r: Floats, w: Floats, s: Floats, n: int, farthest: float, reliability: Floats, tails: Floats
) -> tuple[float, int]:
    """Split candidates and scale their weights in place so that a return is off the mode with the observed chance.

    A candidate becomes a narrow one, and a wide one after all others; merged ones stay as they are.

    Parameters
    ----------
    r, w, s : (2 n or more,) Range [m], weight and standard deviation [m] of the candidates.
    farthest : [m] Mode if nothing has weight.
    reliability : (n_knots,) Observed chances at `KNOTS`.
    tails : (3,) Share q of wide candidates, and factors u and v of the standard deviations.

    Returns
    -------
    mode [m], number of candidates
    """
    total = total_of(w, n)
    if total <= MIN_WEIGHT:
        return farthest, n
    share, narrow, wide = tails
    first, last = densest(r, w, s, n)
    mode = median_of(r, w, s, first, last)
    near, near_off, far_off, predicted = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        x = abs(r[i] - mode)
        off = chance_off(x, s[i])
        predicted += w[i] * off
        if 0.0 < off < 1.0 and share > 0.0 and w[i] >= MAX_MERGED:
            off = (1.0 - share) * chance_off(x, narrow * s[i]) + share * chance_off(x, wide * s[i])
        if x <= OFF_DISTANCE:
            near += w[i]
            near_off += w[i] * off
        else:
            far_off += w[i] * off
    far = total - near
    p_off = calibrated(predicted / total, reliability)
    determinant = near_off * far - far_off * near
    a, b = 1.0, 1.0
    if near > 0.0 and far > 0.0 and determinant < 0.0:  # one group alone cannot be shifted
        b = min(max((near_off - p_off * near) * total / determinant, 0.0), total / far)
        a = (total - b * far) / near
    end = n
    for i in range(n):
        is_split = share > 0.0 and w[i] >= MAX_MERGED
        w[i] *= a if abs(r[i] - mode) <= OFF_DISTANCE else b
        if is_split:
            r[end], w[end], s[end] = r[i], w[i] * share, s[i] * wide
            w[i], s[i] = w[i] * (1.0 - share), s[i] * narrow
            end += 1
    return mode, end


@outer_kernel
def shape_mixtures(
    r: Floats, w: Floats, sigma: Floats, reach: float, reliability: Floats, tails: Floats
) -> None:
    """Shape candidates (n_poses, n_rays, n_most) in place as `shape_mixture` does, and sort them by range again.

    Half of the entries are unused, so that all can be split.
    """
    for p in range(r.shape[0]):
        for q in range(r.shape[1]):
            n = count_of(w[p, q])
            _, n = shape_mixture(r[p, q], w[p, q], sigma[p, q], n, reach, reliability, tails)
            for at in range(1, n):  # by insertion, because only the split ones are out of order
                z, weight, s, to = r[p, q, at], w[p, q, at], sigma[p, q, at], at
                while to > 0 and r[p, q, to - 1] > z:
                    r[p, q, to], w[p, q, to] = r[p, q, to - 1], w[p, q, to - 1]
                    sigma[p, q, to] = sigma[p, q, to - 1]
                    to -= 1
                r[p, q, to], w[p, q, to], sigma[p, q, to] = z, weight, s


@outer_kernel
def fill_log_likelihoods(
    poses: Floats, bearings: Floats, table: CellTable, work: RayWork, reliability: Floats, tails: Floats,
    beyond: Any, ranges: Floats, range_min: float, out: Floats, supported: Bools,
) -> None:  # fmt: skip
    """Fill out (n_poses, n_rays, n_readings) with log-likelihoods, and whether rays crossed the space before the mode.

    Parameters
    ----------
    beyond : Share of missing returns among the readings beyond reach, and density [1/m] of the others.
    ranges : (1 or n_poses, n_rays, n_readings) [m] Readings of each ray, in the convention of REP-117.
    supported : (n_poses, n_rays) Filled.
    """
    _, _, r, w, s, unseen = work
    nothing, density_beyond = beyond
    nearest = max(range_min, MIN_RANGE)
    for p in range(len(poses)):
        for q in range(len(bearings)):
            n, survival = candidates_of(p, q, poses, bearings, table, work)
            length = 0.0
            mode, n_parts = shape_mixture(r, w, s, n, table.reach, reliability, tails)
            for k in range(n):
                if r[k] <= mode:
                    length = unseen[k]
            supported[p, q] = length <= MAX_UNSEEN_LENGTH
            for m in range(ranges.shape[2]):
                z = ranges[min(p, len(ranges) - 1), q, m]
                if table.reach < z < math.inf:
                    value = survival * (1.0 - nothing) * density_beyond
                    out[p, q, m] = math.log(max(value, MIN_DENSITY))
                else:
                    out[p, q, m] = log_density_of(
                        z, r, w, s, n_parts, survival * nothing, nearest, OUTLIER_DENSITY
                    )


@kernel
def _add_parts(
    poses: Floats, ranges: Floats, bearings: Floats, table: CellTable, work: RayWork, reliability: Floats,
    tails: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Add to sums (2, 2) the responsibilities of narrow and wide candidates, and their squared residuals in units of s_i².

    Poses (n, n_rays or 1, 3) are those of the laser. Merged candidates and outliers count nothing.
    """
    _, _, r, w, s, _ = work
    is_split = np.empty(len(r) // 2, dtype=np.bool_)
    for p in range(len(poses)):
        for q in range(len(bearings)):
            z = ranges[p, q]
            if not (z > MIN_RANGE and z < table.reach):
                continue
            n, _ = candidates_of(p, q, poses, bearings, table, work)
            for i in range(n):
                is_split[i] = w[i] >= MAX_MERGED
            _, n_parts = shape_mixture(r, w, s, n, table.reach, reliability, tails)
            total = density_at(z, r, w, s, n_parts) + OUTLIER_DENSITY
            for i in range(n_parts):
                e = (z - r[i]) / s[i]
                if abs(e) < TAIL and (i >= n or is_split[i]):
                    k = 1 if i >= n else 0
                    share = w[i] * DENSITY_AT_0 * math.exp(-0.5 * e * e) / s[i] / total
                    sums[k, 0] += share
                    sums[k, 1] += share * (e * tails[1 + k]) ** 2


def fit_tails(set_aside: Sequence[SetAside], tables: Sequence[CellTable], reliability: Floats) -> Floats:
    """Return q, u and v (3,) from set-aside returns, by EM; each step scales u and v to (1 - q) u² + q v² = 1.

    Each fold of set-aside scans has a table of the other scans. The prior is `KNOT_WEIGHT` returns of normal errors.
    """
    tails = np.array(FIRST_TAILS)
    for _ in range(TAIL_STEPS):
        sums = np.zeros((2, 2))
        for (poses, ranges, bearings), table in zip(set_aside, tables, strict=True):
            _add_parts(per_ray(poses), ranges, bearings, table, new_work(table, 2), reliability, tails, sums)
        counts, squares = sums.T + 0.5 * KNOT_WEIGHT
        variances = squares / counts * counts.sum() / squares.sum()
        tails = np.array([counts[1] / counts.sum(), *np.sqrt(variances)])
    return tails
