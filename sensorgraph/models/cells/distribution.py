"""Distribution of a reading among cells: the candidates of a ray, weighted so that the chance of being off is right.

The march gives candidates with weights w_i about ranges r_i. The scans set aside tell how often a reading is further than
d = `OFF_DISTANCE` from the mode m (`probability_calibration`): the chance p, where the weights say another one. Candidates
with |r_i - m| <= d are multiplied by a and the others by b, such that

    a A + b B = A + B,  a A' + b B' = p (A + B).

A and B are the weights of both groups, A' and B' the parts of them that lie further than d from the mode.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import inner_kernel, kernel
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.cells.evidence import MIN_RANGE
from sensorgraph.models.cells.grid import max_cells_met
from sensorgraph.models.cells.ray_march import CellTable, stop_candidates
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.distribution import SQRT_HALF, TAIL, count_of, total_of
from sensorgraph.models.likelihood import MIN_DENSITY, log_density_of
from sensorgraph.models.mixture import MIN_WEIGHT, densest, median_of
from sensorgraph.types import Bools, Floats

KNOTS = np.array(CELLS.answers.knots)
OUTLIER_DENSITY, MAX_UNSEEN_LENGTH = CELLS.answers.outlier_density, CELLS.answers.max_unseen_length


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
def scale_weights(r: Floats, w: Floats, s: Floats, n: int, farthest: float, reliability: Floats) -> float:
    """Scale the weights w (n or more,) in place so that a return is off the mode with the observed chance.

    `reliability` (n_knots,) holds the observed chances at `KNOTS`. Return the mode [m], `farthest` if nothing has weight.
    """
    if total_of(w, n) <= MIN_WEIGHT:
        return farthest
    first, last = densest(r, w, s, n)
    mode = median_of(r, w, s, first, last)
    near, far, near_off, far_off = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        x = abs(r[i] - mode)
        below, above = (OFF_DISTANCE - x) / s[i], (OFF_DISTANCE + x) / s[i]
        off = 0.0
        if below < -TAIL:
            off = 1.0
        elif below < TAIL:
            off = 0.5 * math.erfc(below * SQRT_HALF)
            off += 0.5 * math.erfc(above * SQRT_HALF) if above < TAIL else 0.0
        if x <= OFF_DISTANCE:
            near += w[i]
            near_off += w[i] * off
        else:
            far += w[i]
            far_off += w[i] * off
    total = near + far
    p_off = calibrated((near_off + far_off) / total, reliability)
    determinant = near_off * far - far_off * near
    if near <= 0.0 or far <= 0.0 or determinant >= 0.0:  # one group alone cannot be shifted
        return mode
    b = (near_off - p_off * near) * total / determinant
    b = min(max(b, 0.0), total / far)
    a = (total - b * far) / near
    for i in range(n):
        w[i] *= a if abs(r[i] - mode) <= OFF_DISTANCE else b
    return mode


@kernel
def scale_all_weights(r: Floats, w: Floats, sigma: Floats, reach: float, reliability: Floats) -> None:
    """Scale the weights of candidates as `list_candidates` returns them, in place, as `scale_weights` does."""
    for p in range(r.shape[0]):
        for q in range(r.shape[1]):
            scale_weights(r[p, q], w[p, q], sigma[p, q], count_of(w[p, q]), reach, reliability)


@kernel
def fill_log_likelihoods(
    poses: Floats, bearings: Floats, table: CellTable, reliability: Floats, beyond: Any,
    ranges: Floats, range_min: float, out: Floats, supported: Bools,
) -> None:  # fmt: skip
    """Fill out (n_poses, n_rays, n_readings) with log-likelihoods, and whether rays crossed the space before the mode.

    Parameters
    ----------
    beyond : Share of missing returns among the readings beyond reach, and density [1/m] of the others.
    ranges : (1 or n_poses, n_rays, n_readings) [m] Readings of each ray, in the convention of REP-117.
    supported : (n_poses, n_rays) Filled.
    """
    size = max_cells_met(table.reach, table.cell)
    at = np.empty((size, 2), dtype=np.int64)
    ends, r, w, s, unseen = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    nothing, density_beyond = beyond
    nearest = max(range_min, MIN_RANGE)
    for p in range(len(poses)):
        for q in range(len(bearings)):
            angle = poses[p, 2] + bearings[q]
            n, survival = stop_candidates(
                poses[p, 0], poses[p, 1], math.cos(angle), math.sin(angle), table, at, ends, r, w, s, unseen
            )
            mode = scale_weights(r, w, s, n, table.reach, reliability)
            length = 0.0
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
                    out[p, q, m] = log_density_of(z, r, w, s, n, survival * nothing, nearest, OUTLIER_DENSITY)
