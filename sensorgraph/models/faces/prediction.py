"""Prediction of rays from faces: the mixture of all faces that a ray crosses, weighted by the probability of a stop.

Weight of the m-th crossing: w_m = alpha_m prod_{i<m} (1 - alpha_i), with the visibility alpha. Within the standard
error `spread` of an edge, alpha = before + (level - before) Φ(off / spread), at the distance `off` from the edge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import kernel
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.calibration.ray_terms import incidence_bias
from sensorgraph.models.faces.observed_space import is_ray_observed
from sensorgraph.models.faces.ray_march import CANDIDATE_SLOTS, MAX_CANDIDATES, crossed_faces
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import variance
from sensorgraph.models.mixture import SQRT_HALF, summarise

PREDICTION = FACES.prediction
SUPPORT_MARGIN, MIN_SURVIVAL, MIN_SHARE = (
    PREDICTION.support_margin,
    PREDICTION.min_survival,
    PREDICTION.min_share,
)
MAX_OFF_SIGMAS = 4.5
"""Ratio of `OFF_DISTANCE` to a standard deviation above which p_off is 0; the error is below 1e-5."""
EDGE_GATE, MIN_EDGE_VARIANCE = PREDICTION.edge_sigmas**2, PREDICTION.min_edge_variance


@kernel
def predict_rays(
    x: Any,
    y: Any,
    cos: Any,
    sin: Any,
    cos_b: Any,
    sin_b: Any,
    range_max: Any,
    faces: Any,
    buckets: Any,
    noise: Any,
    origin: Any,
    cell: Any,
    clearance: Any,
    returns: Any,
    constant: Any,
    slope: Any,
    incidence: Any,
    is_biased: Any,
    which: Any,
    table: Any,
    supported: Any,
) -> Any:
    """Fill table (n_poses, n_rays, 6) as `mixture.summarise`, and `supported` (n_poses, n_rays): the ray was observed.

    The function is one loop over rays without temporary arrays: march, blur edges, mix, look up the observed space.
    """
    normals, _, first, edges, levels, blur, neighbour = faces
    r, t = np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS)
    k, j = np.empty(CANDIDATE_SLOTS, np.int64), np.empty(CANDIDATE_SLOTS, np.int64)
    rho, w, s = np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS)
    is_moved, sigma = noise[1] > 0 or noise[2] > 0, math.sqrt(noise[0])  # there is noise of poses
    for i in range(len(x)):
        for b in range(len(cos_b)):
            ux, uy = cos[i] * cos_b[b] - sin[i] * sin_b[b], sin[i] * cos_b[b] + cos[i] * sin_b[b]
            n = crossed_faces(x[i], y[i], ux, uy, range_max, MIN_SURVIVAL, faces, buckets, r, k, j, t)
            survival, c = 1.0, 0
            for m in range(n):
                f = k[m]
                den = normals[f, 0] * ux + normals[f, 1] * uy
                across = (noise[1] + r[m] ** 2 * noise[2]) / (den * den) if is_moved else 0.0
                alpha = levels[j[m]] if j[m] >= first[f] else 0.0
                e = j[m]  # index of the nearest edge
                if e < first[f]:
                    e = first[f]
                elif e + 1 < first[f + 1] and edges[e + 1] - t[m] < t[m] - edges[e]:
                    e += 1
                spread = blur[e] ** 2 + across + MIN_EDGE_VARIANCE
                off = t[m] - edges[e]
                if off * off < EDGE_GATE * spread:
                    adjacent = neighbour[e]
                    if adjacent < 0 or normals[adjacent, 0] * ux + normals[adjacent, 1] * uy >= 0:
                        before = levels[e - 1] if e > first[f] else 0.0
                        alpha = before + (levels[e] - before) * 0.5 * math.erfc(
                            -off / math.sqrt(2.0 * spread)
                        )
                if alpha < MIN_SHARE:
                    continue
                rho[c], w[c] = r[m], survival * alpha
                if is_biased:
                    rho[c] += constant[b] + slope[b] * r[m] + incidence_bias(den, r[m], incidence)
                s[c] = sigma
                if is_moved:
                    s[c] = math.sqrt(variance(r[m], -normals[f, 1] * ux + normals[f, 0] * uy, den, noise))
                c += 1
                survival *= 1.0 - alpha
                if survival < MIN_SURVIVAL:
                    break
            row = table[i, b]
            if c == 1:  # most rays have one candidate
                row[0], row[1], row[2], row[3], row[4] = rho[0], rho[0], rho[0], s[0], survival
                row[5] = (
                    math.erfc(OFF_DISTANCE / s[0] * SQRT_HALF)
                    if MAX_OFF_SIGMAS * s[0] > OFF_DISTANCE
                    else 0.0
                )
            else:
                row[0], row[1], row[2], row[3], row[4], row[5] = summarise(
                    rho, w, s, c, survival, range_max, which
                )
            reach = range_max if row[4] > 0.5 else row[1] - SUPPORT_MARGIN
            supported[i, b] = r[MAX_CANDIDATES] > reach and is_ray_observed(
                x[i], y[i], ux, uy, reach, origin, cell, clearance
            )
