"""Prediction of rays from faces: the mixture of all faces that a ray crosses, weighted by the probability of a stop.

Weight of the m-th crossing: w_m = alpha_m prod_{i<m} (1 - alpha_i), with the visibility alpha. Within the standard
error `spread` of an edge, alpha = before + (level - before) Φ(off / spread), at the distance `off` from the edge.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from planners.kernel import inlined_kernel, outer_kernel
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.calibration.ray_terms import incidence_bias
from sensorgraph.models.distribution import SQRT_HALF
from sensorgraph.models.faces.observed_space import is_ray_observed
from sensorgraph.models.faces.ray_march import (
    CANDIDATE_SLOTS,
    MAX_CANDIDATES,
    BucketGrid,
    FaceSet,
    March,
    crossed_faces,
    new_march,
)
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import FIT_GATE, MIN_VARIANCE, variance
from sensorgraph.models.likelihood import log_density_of
from sensorgraph.models.mixture import summarise
from sensorgraph.types import Floats

SUPPORT_MARGIN = FACES.observed_cell
"""[m] Distance before the predicted range from which a ray needs no support, since the surface was observed."""
MIN_SURVIVAL, MIN_SHARE = 1e-3, 1e-4
"""Survival probability below which a ray is not followed further, and probability of a stop below which a face is no candidate."""


class LaserBeams(NamedTuple):
    """What the kernels of thin rays share: lasers, rays, faces, noise and calibration."""

    x: Floats
    """(n_poses,) [m] place of the laser in map; `y` likewise."""
    y: Floats
    cos: Floats
    """(n_poses,) direction of the laser; `sin` likewise."""
    sin: Floats
    ray_cos: Floats
    """(n_rays,) direction of each ray from the laser; `ray_sin` likewise."""
    ray_sin: Floats
    range_max: float
    """[m]"""
    faces: FaceSet
    buckets: BucketGrid
    noise: Floats
    """(5,) `ReturnNoise.array`."""
    constant: Floats
    """(n_rays,) [m] ray terms; `slope` (n_rays,) and `incidence` likewise."""
    slope: Floats
    incidence: Floats
    is_biased: bool
    """Whether there are ray terms."""


def new_candidates() -> tuple[March, tuple[Any, ...]]:
    """Return memory for one ray: what `crossed_faces` fills, and what `ray_mixture` fills."""
    rho, w, s = np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS)
    return new_march(), (rho, w, s, np.empty(CANDIDATE_SLOTS, np.int64))


@inlined_kernel
def direction(i: Any, b: Any, beams: Any) -> Any:
    """Return the direction of ray b from pose i in map."""
    cos, sin, ray_cos, ray_sin = beams.cos[i], beams.sin[i], beams.ray_cos[b], beams.ray_sin[b]
    return cos * ray_cos - sin * ray_sin, sin * ray_cos + cos * ray_sin


@inlined_kernel
def ray_mixture(i: Any, b: Any, beams: Any, work: Any, mixture: Any) -> Any:
    """List the candidates of ray b from pose i; return their number and the probability that none stops it.

    Parameters
    ----------
    work : `March`, filled.
    mixture : Arrays of length `CANDIDATE_SLOTS`, filled: range [m], weight, standard deviation [m], face.
    """
    normals, _, first, edges, levels, blur, neighbour = beams.faces
    noise, constant, slope = beams.noise, beams.constant[b], beams.slope[b]
    r, k, j, t = work
    rho, w, s, source = mixture
    is_moved, sigma = noise[1] > 0 or noise[2] > 0, math.sqrt(noise[0])  # there is noise of poses
    varies = is_moved or noise[4] > 0
    ux, uy = direction(i, b, beams)
    n = crossed_faces(
        beams.x[i], beams.y[i], ux, uy, beams.range_max, MIN_SURVIVAL, beams.faces, beams.buckets, work
    )
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
        spread = blur[e] ** 2 + across + MIN_VARIANCE
        off = t[m] - edges[e]
        if off * off < FIT_GATE * spread:
            adjacent = neighbour[e]
            if adjacent < 0 or normals[adjacent, 0] * ux + normals[adjacent, 1] * uy >= 0:
                before = levels[e - 1] if e > first[f] else 0.0
                alpha = before + (levels[e] - before) * 0.5 * math.erfc(-off / math.sqrt(2.0 * spread))
        if alpha < MIN_SHARE:
            continue
        rho[c], w[c], source[c] = r[m], survival * alpha, f
        if beams.is_biased:
            rho[c] += constant + slope * r[m] + incidence_bias(den, r[m], beams.incidence)
        s[c] = sigma
        if varies:
            s[c] = math.sqrt(variance(r[m], -normals[f, 1] * ux + normals[f, 0] * uy, den, noise))
        c += 1
        survival *= 1.0 - alpha
        if survival < MIN_SURVIVAL:
            break
    return c, survival


@inlined_kernel
def is_supported(i: Any, b: Any, reach: Any, beams: Any, work: Any, observed: Any) -> Any:
    """Return whether ray b from pose i was observed up to a range [m], and meets no face from behind before it."""
    ux, uy = direction(i, b, beams)
    origin, cell, clearance = observed
    return work[0][MAX_CANDIDATES] > reach and is_ray_observed(
        beams.x[i], beams.y[i], ux, uy, reach, origin, cell, clearance
    )


@outer_kernel
def predict_rays(beams: Any, candidates: Any, observed: Any, which: Any, table: Any, supported: Any) -> Any:
    """Fill table (n_poses, n_rays, 6) as `mixture.summarise`, and `supported` (n_poses, n_rays): the ray was observed.

    Parameters
    ----------
    observed : Origin [m], cell [m] and clearance of the observed space.
    """
    work, mixture = candidates
    rho, w, s, _ = mixture
    for i in range(len(beams.x)):
        for b in range(len(beams.ray_cos)):
            c, survival = ray_mixture(i, b, beams, work, mixture)
            row = table[i, b]
            if c == 1:  # most rays have one candidate
                row[0], row[1], row[2], row[3], row[4] = rho[0], rho[0], rho[0], s[0], survival
                row[5] = math.erfc(OFF_DISTANCE / s[0] * SQRT_HALF)
            else:
                row[0], row[1], row[2], row[3], row[4], row[5] = summarise(
                    rho, w, s, c, survival, beams.range_max, which
                )
            reach = beams.range_max if row[4] > 0.5 else row[1] - SUPPORT_MARGIN
            supported[i, b] = is_supported(i, b, reach, beams, work, observed)


@outer_kernel
def list_rays(beams: Any, work: Any, rho: Any, w: Any, s: Any, source: Any, survival: Any) -> Any:
    """Fill the mixtures of all rays; return the largest number of candidates.

    Parameters
    ----------
    rho, w, s, source : (n_poses, n_rays, `CANDIDATE_SLOTS`) As `ray_mixture` fills them; unused entries stay.
    survival : (n_poses, n_rays) Probability that no candidate stops the ray.
    """
    most = 0
    for i in range(len(beams.x)):
        for b in range(len(beams.ray_cos)):
            mixture = rho[i, b], w[i, b], s[i, b], source[i, b]
            c, survival[i, b] = ray_mixture(i, b, beams, work, mixture)
            most = max(most, c)
    return most


@outer_kernel
def log_likelihood_rays(
    beams: Any, candidates: Any, observed: Any, ranges: Any, range_min: Any, out: Any, supported: Any
) -> Any:
    """Fill out (n_poses, n_rays) with the log-likelihood of readings, as `likelihood.log_density` defines it.

    Parameters
    ----------
    observed : Origin [m], cell [m] and clearance of the observed space.
    ranges : (1 or n_poses, n_rays) [m] Readings in the convention of REP-117.
    range_min : [m] Closer surfaces give the reading -inf.
    supported : (n_poses, n_rays) Filled: the ray was observed up to the most probable surface.
    """
    work, mixture = candidates
    rho, w, s, _ = mixture
    for i in range(len(beams.x)):
        for b in range(len(beams.ray_cos)):
            c, survival = ray_mixture(i, b, beams, work, mixture)
            z = ranges[min(i, len(ranges) - 1), b]
            out[i, b] = log_density_of(z, rho, w, s, c, survival, range_min, beams.noise[3])
            heaviest = 0
            for m in range(1, c):
                if w[m] > w[heaviest]:
                    heaviest = m
            reach = beams.range_max if survival > 0.5 or c == 0 else rho[heaviest] - SUPPORT_MARGIN
            supported[i, b] = is_supported(i, b, reach, beams, work, observed)


@outer_kernel
def draw_rays(beams: Any, candidates: Any, uniform: Any, normal: Any, out: Any) -> Any:
    """Fill out (n_poses, n_rays) [m] with one outcome of each ray's mixture, or +inf.

    It is the first candidate m for which uniform >= 1 - sum_{i<=m} w_i; the reading is rho_m + s_m normal. What is left behind the
    last one, if it is below `MIN_SURVIVAL`, counts to that.
    """
    work, mixture = candidates
    rho, w, s, _ = mixture
    for i in range(len(beams.x)):
        for b in range(len(beams.ray_cos)):
            c, left = ray_mixture(i, b, beams, work, mixture)
            survival = 1.0
            out[i, b] = np.inf
            for m in range(c):
                survival -= w[m]
                if uniform[i, b] >= survival or (m == c - 1 and left < MIN_SURVIVAL):
                    out[i, b] = rho[m] + s[m] * normal[i, b]
                    break
