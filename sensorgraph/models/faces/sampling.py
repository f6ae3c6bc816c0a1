"""Draws of readings from faces: one outcome of the mixture for each ray, from given random numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import kernel
from sensorgraph.models.calibration.ray_terms import incidence_bias
from sensorgraph.models.faces.prediction import EDGE_GATE, MIN_EDGE_VARIANCE, MIN_SURVIVAL
from sensorgraph.models.faces.ray_march import CANDIDATE_SLOTS, crossed_faces


@kernel
def draw_rays(
    x: Any,
    y: Any,
    cos: Any,
    sin: Any,
    cos_b: Any,
    sin_b: Any,
    range_max: Any,
    faces: Any,
    buckets: Any,
    sigma: Any,
    constant: Any,
    slope: Any,
    incidence: Any,
    uniform: Any,
    normal: Any,
    out: Any,
) -> Any:
    """Fill out (n_poses, n_rays) [m] with the first crossing m for which uniform >= prod_{i<=m} (1 - alpha_i), or +inf.

    The reading is r_m plus the ray terms of the laser (`constant`, `slope`, `incidence`) and `sigma` [m] times `normal`.
    Edges are blurred by their standard errors, as in a prediction.
    """
    normals, _, first, edges, levels, blur, neighbour = faces
    r, t = np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS)
    k, j = np.empty(CANDIDATE_SLOTS, np.int64), np.empty(CANDIDATE_SLOTS, np.int64)
    for i in range(len(x)):
        for b in range(len(cos_b)):
            ux, uy = cos[i] * cos_b[b] - sin[i] * sin_b[b], sin[i] * cos_b[b] + cos[i] * sin_b[b]
            n = crossed_faces(x[i], y[i], ux, uy, range_max, MIN_SURVIVAL, faces, buckets, r, k, j, t)
            survival = 1.0
            out[i, b] = np.inf
            for m in range(n):
                f = k[m]
                alpha = levels[j[m]] if j[m] >= first[f] else 0.0
                e = max(j[m], first[f])
                if e + 1 < first[f + 1] and edges[e + 1] - t[m] < t[m] - edges[e]:
                    e += 1
                off = t[m] - edges[e]
                adjacent = neighbour[e]
                is_end = adjacent < 0 or normals[adjacent, 0] * ux + normals[adjacent, 1] * uy >= 0
                if is_end and off * off < EDGE_GATE * (blur[e] ** 2 + MIN_EDGE_VARIANCE):
                    before = levels[e - 1] if e > first[f] else 0.0
                    share = 0.5 * math.erfc(-off / math.sqrt(2.0 * (blur[e] ** 2 + MIN_EDGE_VARIANCE)))
                    alpha = before + (levels[e] - before) * share
                survival *= 1.0 - alpha
                if uniform[i, b] >= survival:
                    den = normals[f, 0] * ux + normals[f, 1] * uy
                    shown = constant[b] + slope[b] * r[m] + incidence_bias(den, r[m], incidence)
                    out[i, b] = r[m] + shown + sigma * normal[i, b]
                    break
