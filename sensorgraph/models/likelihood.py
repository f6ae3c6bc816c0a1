"""Log-likelihood of readings, given poses: the beam mixture of a graph, with outliers and all kinds of missing readings.

For a mixture with weights w_i, ranges r_i [m], standard deviations s_i [m] and probability of no return p_0, and outliers
of the density λ [1/m],

    L(z)    = λ + sum_i w_i φ((z - r_i) / s_i) / s_i    [1/m]   a return,
    L(+inf) = p_0                                               no return,
    L(-inf) = sum_i w_i Φ((r_min - r_i) / s_i)                  closer than r_min,
    L(nan)  = 1                                                 a broken reading.

A density below `MIN_DENSITY` counts as `MIN_DENSITY`, so that no single reading excludes a pose (Thrun, Burgard and Fox
2005, section 6.3).

The readings of a scan are not independent: a wall that is 2 cm off moves all rays that end on it. With the correlation ρ_d
of residuals that end at a distance d from each other, n readings carry as much information as
n_e = n² / sum_ij ρ(d_ij) independent ones. The sum of the log-likelihoods is multiplied by n_e / n.
"""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import inner_kernel, kernel
from sensorgraph.models.distribution import Mixture, chance_below, count_of, density_at
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.types import Floats

MIN_DENSITY = 1e-4
"""[1/m] Lower limit of the density of a return, and of the probability of any other reading."""


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


@kernel
def _fill(
    means: Floats,
    weights: Floats,
    widths: Floats,
    none: Floats,
    ranges: Floats,
    range_min: float,
    stray: float,
    out: Floats,
) -> None:
    """Fill out (n_poses, n_rays) with the log-likelihood of ranges (n_poses or 1, n_rays)."""
    for i in range(out.shape[0]):
        k = min(i, len(ranges) - 1)
        for b in range(out.shape[1]):
            n = count_of(weights[i, b])
            out[i, b] = log_density_of(
                ranges[k, b], means[i, b], weights[i, b], widths[i, b], n, none[i, b], range_min, stray
            )


def log_density(mixture: Mixture, ranges: Floats, range_min: float, stray: float) -> Floats:
    """Return the log-likelihood (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m]."""
    out = np.empty(mixture.p_no_return.shape)
    _fill(
        mixture.means, mixture.weights, mixture.widths, mixture.p_no_return,
        np.ascontiguousarray(ranges), range_min, stray, out,
    )  # fmt: skip
    return out


def information_share(memory: ResidualMemory, ends: Floats) -> Floats:
    """Return n_e / n (n_scans,): the share of independent readings in each scan.

    Parameters
    ----------
    ends : (n_scans, n_rays, 2) [m] End points of the readings in any one frame; not finite for a reading that has none.
    """
    out = np.ones(len(ends))
    _fill_shares(np.ascontiguousarray(ends), memory.sizes, memory.noise.sum(axis=1), out)
    return out


@kernel
def _fill_shares(ends: Floats, sizes: Floats, noise: Floats, out: Floats) -> None:
    """Fill out (n_scans,) as `information_share`; `noise` (n_sizes,) is the share of the variance of each size."""
    for i in range(len(ends)):
        n, total = 0, 0.0
        for a in range(ends.shape[1]):
            if not math.isfinite(ends[i, a, 0]):
                continue
            n += 1
            for b in range(a):
                apart = math.hypot(ends[i, a, 0] - ends[i, b, 0], ends[i, a, 1] - ends[i, b, 1])
                if not apart < sizes[-1]:  # also where b has no end point
                    continue
                for k in range(len(sizes)):
                    ratio = apart / sizes[k]
                    if ratio < 1.0:
                        total += 2.0 * noise[k] * (1.0 - (4.0 - ratio) * ratio / math.pi)
        if n > 0:
            out[i] = n / (n + total)
