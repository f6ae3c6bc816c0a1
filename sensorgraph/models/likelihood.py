"""Log-likelihood of readings, given poses: the beam mixture of a graph, with outliers and all kinds of missing readings.

For a mixture with weights w_i, ranges r_i [m], standard deviations s_i [m] and probability of no return p_0, and outliers
of the density λ [1/m],

    L(z)    = λ + sum_i w_i φ((z - r_i) / s_i) / s_i    [1/m]   a return,
    L(+inf) = p_0                                               no return,
    L(-inf) = sum_i w_i Φ((r_min - r_i) / s_i)                  closer than r_min,
    L(nan)  = 1                                                 a broken reading.

A density below `MIN_DENSITY` counts as `MIN_DENSITY`, so that no single reading excludes a pose (Thrun, Burgard and Fox
2005, section 6.3).

The readings of a scan are not independent: a wall that is 2 cm off moves all rays that end on it. Let ρ_ij be the correlation
of residuals that end at a distance d_ij from each other. A reading that ends at p_i on a surface with the unit normal n_i
depends on the pose (x, y, φ) in proportion to w_i = (n_i, p_i × n_i), in units of its spread: both grow as 1 / cos(incidence).
With the information H = sum_i w_i w_i' of independent readings, and J = sum_ij ρ_ij w_i w_j', the sum of the log-likelihoods is
multiplied by 3 / trace(H^-1 J) (Pauli, Racugno and Ventura 2011: magnitude adjustment of a composite likelihood).
"""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import inner_kernel, kernel
from sensorgraph.models.distribution import Mixture, chance_below, density_at
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.types import Floats

MIN_DENSITY = 1e-4
"""[1/m] Lower limit of the density of a return, and of the probability of any other reading."""
LINE_RADIUS = 0.2
"""[m] Radius of the line whose normal a reading has: ten times the noise of a range."""
MIN_INFORMATION = 1e-9
"""Ratio of the smallest to the largest eigenvalue of the information below which a direction is unknown."""


@inner_kernel
def log_density_of(
    z: float, r: Floats, w: Floats, s: Floats, n: int, none: float, range_min: float, stray: float
) -> float:
    """Return the log-likelihood of a reading z [m] from n candidates.

    Parameters
    ----------
    none : Probability of no return.
    range_min : [m] Closer surfaces give the reading -inf.
    stray : [1/m] Density of outliers per metre of ray.
    """
    if math.isnan(z):
        return 0.0
    if math.isinf(z):
        value = none if z > 0 else chance_below(range_min, r, w, s, 0, n)
    else:
        value = density_at(z, r, w, s, n) + stray
    return math.log(max(value, MIN_DENSITY))


def log_density(mixture: Mixture, ranges: Floats, range_min: float, stray: float) -> Floats:
    """Return the log-likelihood (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m], as `log_density_of` does."""
    total = mixture.weights.sum(axis=-1)
    none = np.where(ranges > 0, mixture.p_no_return, total * mixture.cdf(range_min))
    value = np.where(np.isinf(ranges), none, total * mixture.pdf(ranges) + stray)
    return np.where(np.isnan(ranges), 0.0, np.log(np.maximum(value, MIN_DENSITY)))


def information_share(memory: ResidualMemory, ends: Floats) -> Floats:
    """Return the share (n_scans,) by which the information of each scan about its pose is smaller than of independent readings.

    Parameters
    ----------
    ends : (n_scans, n_rays, 2) [m] End points of the readings in the frame of the laser; not finite for a reading that has
        none. A direction about which no reading says anything counts nothing.
    """
    angle = np.arctan2(ends[..., 1], ends[..., 0])
    order = np.argsort(np.where(np.isfinite(angle), angle, np.inf), axis=1)
    ends = np.ascontiguousarray(np.take_along_axis(ends, order[..., None], axis=1))
    information, variability = np.zeros((2, len(ends), 3, 3))
    _add_information(ends, memory.sizes, memory.noise.sum(axis=1), information, variability)
    inverse = np.linalg.pinv(information, rcond=MIN_INFORMATION, hermitian=True)
    known = np.trace(inverse @ information, axis1=1, axis2=2)  # number of directions
    spread = np.trace(inverse @ variability, axis1=1, axis2=2)
    return np.where(spread > known, known / np.maximum(spread, 1e-9), 1.0)


@kernel
def _add_information(
    ends: Floats, sizes: Floats, noise: Floats, information: Floats, variability: Floats
) -> None:
    """Add H and J (n_scans, 3, 3) of end points in the order of their bearings; `noise` (n_sizes,) are shares of variance."""
    w = np.empty((ends.shape[1], 3))
    for i in range(len(ends)):
        n = 0
        while n < ends.shape[1] and math.isfinite(ends[i, n, 0]):
            n += 1
        p = ends[i, :n]
        for a in range(n):
            x, y = _normal(p, a)
            w[a, 0], w[a, 1], w[a, 2] = x, y, p[a, 0] * y - p[a, 1] * x
        for a in range(n):
            for b in range(a + 1):
                correlation = 1.0
                if b < a:
                    apart, correlation = math.hypot(p[a, 0] - p[b, 0], p[a, 1] - p[b, 1]), 0.0
                    if not apart < sizes[-1]:
                        continue
                    for k in range(len(sizes)):
                        ratio = apart / sizes[k]
                        if ratio < 1.0:
                            correlation += noise[k] * (1.0 - (4.0 - ratio) * ratio / math.pi)
                for c in range(3):
                    for d in range(3):
                        if b == a:
                            information[i, c, d] += w[a, c] * w[a, d]
                            variability[i, c, d] += w[a, c] * w[a, d]
                        else:
                            variability[i, c, d] += correlation * (w[a, c] * w[b, d] + w[b, c] * w[a, d])


@inner_kernel
def _normal(p: Floats, a: int) -> tuple[float, float]:
    """Return the unit normal to the laser of the line through the points p (n, 2) within `LINE_RADIUS` of point a.

    Without any, the line leads to the nearer neighbour; a point that is alone faces the laser.
    """
    sxx, sxy, syy, nearest, neighbour = 0.0, 0.0, 0.0, math.inf, -1
    for step in (-1, 1):
        b = a + step
        while 0 <= b < len(p):
            x, y = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]
            apart = math.hypot(x, y)
            if apart < nearest:
                nearest, neighbour = apart, b
            if apart > LINE_RADIUS:
                break
            sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
            b += step
    if neighbour >= 0 and nearest > LINE_RADIUS:
        along = math.atan2(p[neighbour, 1] - p[a, 1], p[neighbour, 0] - p[a, 0])
    elif neighbour >= 0:
        along = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
    else:
        along = math.atan2(p[a, 0], -p[a, 1])
    x, y = -math.sin(along), math.cos(along)
    return (-x, -y) if x * p[a, 0] + y * p[a, 1] > 0.0 else (x, y)
