"""Distribution of a reading: the mixture of all surfaces that a ray may meet, its density, quantiles and samples.

Given that the ray returns, a reading z [m] has the density and distribution function

    f(z) = sum_i w_i φ((z - r_i) / s_i) / (s_i W),  F(z) = sum_i w_i Φ((z - r_i) / s_i) / W,  W = sum_i w_i.

With probability 1 - W the ray does not return. A `Mixture` holds r, w and s for many rays as padded arrays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.types import Floats, Ints

SQRT_HALF, DENSITY_AT_0 = 0.7071067811865476, 0.3989422804014327
"""sqrt(1/2), and the standard normal density at 0."""
TAIL = 6.0
"""Standard deviations beyond which the tail of a surface is neglected: 1e-9."""
MAX_STEPS, MIN_STEP = 40, 1e-8
"""Maximum number of Newton steps, of which five are usual; step at which they end, in standard deviations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mixture:
    """The surfaces that may stop each ray; arrays (n_poses, n_rays, n_most), sorted by range, unused entries last."""

    means: Floats
    """[m] Range to each surface; +inf in unused entries."""
    weights: Floats
    """Probability that the surface stops the ray and the ray returns; 0 in unused entries."""
    widths: Floats
    """[m] Standard deviation of a reading from the surface."""
    sources: Ints
    """Index of the face or cell of each surface; -1 in unused entries, and without a surface."""
    p_no_return: Floats
    """(n_poses, n_rays) Probability of no return; with the weights it sums to 1."""

    def __post_init__(self) -> None:
        shapes = {name: np.shape(getattr(self, name)) for name in ("means", "weights", "widths", "sources")}
        if len(set(shapes.values())) != 1 or self.p_no_return.shape != self.means.shape[:2]:
            raise ValueError(
                f"a mixture has shapes {shapes} and p_no_return {self.p_no_return.shape}, expected one shape "
                "(n_poses, n_rays, n_most) and (n_poses, n_rays)"
            )

    @classmethod
    def padded(cls, parts: list[Self], axis: int) -> Self:
        """Concatenate mixtures along the poses (`axis` 0) or the rays (`axis` 1)."""
        most = max(part.means.shape[2] for part in parts)
        fill = {"means": np.inf, "weights": 0.0, "widths": 1.0, "sources": -1}

        def joined(name: str) -> Any:
            arrays = [getattr(part, name) for part in parts]
            wide = [
                np.pad(a, ((0, 0), (0, 0), (0, most - a.shape[2])), constant_values=fill[name])
                for a in arrays
            ]
            return np.concatenate(wide, axis)

        none = np.concatenate([part.p_no_return for part in parts], axis)
        return cls(p_no_return=none, **{name: joined(name) for name in fill})

    def pdf(self, z: ArrayLike) -> Floats:
        """Return the density [1/m] (n_poses, n_rays) of a reading z [m], given a return; z is broadcast."""
        x = self._standardised(z)
        return self._given_return(DENSITY_AT_0 * np.exp(-0.5 * x * x) / self.widths)

    def cdf(self, z: ArrayLike) -> Floats:
        """Return the probability (n_poses, n_rays) of a reading below z [m], given a return; z is broadcast."""
        from scipy.special import ndtr  # imported here, since it takes long

        return self._given_return(ndtr(self._standardised(z)))

    def draw(self, uniform: Floats, normal: Floats) -> Floats:
        """Return one reading [m] (n_poses, n_rays) from random numbers (n_poses, n_rays); +inf: no return.

        It is from the first surface m for which uniform >= 1 - sum_{i<=m} w_i: r_m + s_m normal.
        """
        stops = uniform[..., None] >= 1.0 - np.cumsum(self.weights, axis=-1)
        first = stops.argmax(axis=-1)[..., None]
        mean, width = (np.take_along_axis(a, first, axis=-1)[..., 0] for a in (self.means, self.widths))
        return np.where(stops.any(axis=-1), mean + width * normal, np.inf)

    def quantile(self, q: ArrayLike) -> Floats:
        """Return the range [m] (n_poses, n_rays) below which a return lies with probability q; q is broadcast.

        A ray that never returns has the quantile +inf.

        Raises
        ------
        ValueError : q is not between 0 and 1.
        """
        wanted = np.asarray(q, dtype=np.float64)
        if not ((wanted > 0) & (wanted < 1)).all():
            wrong = wanted[~((wanted > 0) & (wanted < 1))].flat[0]
            raise ValueError(f"q is {wrong:g}, expected numbers above 0 and below 1")
        each = np.array(np.broadcast_to(wanted, self.p_no_return.shape), order="C")
        arrays = (self.means, self.weights, self.widths)
        means, weights, widths = map(np.ascontiguousarray, arrays)  # one compilation for all models
        out = np.empty(each.shape)
        _quantile(means, weights, widths, each, out)
        return out

    def _standardised(self, z: ArrayLike) -> Floats:
        """Return (z - r_i) / s_i of every surface, (n_poses, n_rays, n_most)."""
        each = np.broadcast_to(np.asarray(z, dtype=np.float64), self.p_no_return.shape)
        return (each[..., None] - np.where(self.weights > 0, self.means, 0.0)) / self.widths

    def _given_return(self, values: Floats) -> Floats:
        """Return sum_i w_i values_i / W (n_poses, n_rays) for values (n_poses, n_rays, n_most); 0 without a surface."""
        total = self.weights.sum(axis=-1)
        return np.asarray((self.weights * values).sum(axis=-1) / np.where(total > 0, total, 1.0))


def single_mixture(mean: Floats, sigma: Floats, p_no_return: Floats) -> Mixture:
    """Return mixtures of one Gaussian each; all arrays (n_poses, n_rays)."""
    return Mixture(
        means=mean[..., None].copy(),
        weights=1.0 - p_no_return[..., None],
        widths=np.maximum(sigma, 1e-9)[..., None],
        sources=np.full((*mean.shape, 1), -1),
        p_no_return=p_no_return,
    )


@inner_kernel
def chance_below(x: float, r: Floats, w: Floats, s: Floats, first: int, last: int) -> float:
    """Return sum_i w_i Φ((x - r_i) / s_i) over candidates first ... last - 1: their weight below x [m]."""
    total = 0.0
    for i in range(first, last):
        z = (x - r[i]) / s[i]
        if z > TAIL:
            total += w[i]
        elif z > -TAIL:
            total += 0.5 * w[i] * math.erfc(-z * SQRT_HALF)
    return total


@inner_kernel
def quantile_of(r: Floats, w: Floats, s: Floats, first: int, last: int, weight: float) -> float:
    """Solve sum_i w_i Φ((x - r_i) / s_i) = weight for the range x [m], over candidates first ... last - 1.

    Newton's method, with bisection of a bracket where a step leaves it.
    """
    below, k, widest = 0.0, last - 1, 0.0
    for i in range(first, last):
        below += w[i]
        widest = max(widest, s[i])
        if below >= weight:
            k = i
            break
    for i in range(k + 1, last):
        widest = max(widest, s[i])
    low, high, x = r[k] - TAIL * widest, r[k] + TAIL * widest, r[k]
    for _ in range(MAX_STEPS):
        over, slope = -weight, 0.0
        for i in range(first, last):
            z = (x - r[i]) / s[i]
            if z > TAIL:
                over += w[i]
            elif z > -TAIL:
                over += 0.5 * w[i] * math.erfc(-z * SQRT_HALF)
                slope += w[i] / s[i] * math.exp(-0.5 * z * z)
        if over < 0.0:
            low = x
        else:
            high = x
        slope *= DENSITY_AT_0
        after = x - over / slope if slope > 0.0 else low
        if not low < after < high:
            after = 0.5 * (low + high)
        if abs(after - x) < MIN_STEP * widest:
            return float(after)
        x = after
    return float(x)


@inner_kernel
def density_at(z: float, r: Floats, w: Floats, s: Floats, n: int) -> float:
    """Return sum_i w_i φ((z - r_i) / s_i) / s_i [1/m] over n candidates."""
    total = 0.0
    for i in range(n):
        x = (z - r[i]) / s[i]
        if abs(x) < TAIL:
            total += w[i] / s[i] * math.exp(-0.5 * x * x)
    return total * DENSITY_AT_0


@inner_kernel
def count_of(w: Floats) -> int:
    """Return the number of candidates: entries before the first weight of 0 at the end."""
    n = len(w)
    while n > 0 and w[n - 1] == 0.0:
        n -= 1
    return n


@inner_kernel
def total_of(w: Floats, n: int) -> float:
    """Return the weight of n candidates."""
    total = 0.0
    for m in range(n):
        total += w[m]
    return total


@outer_kernel
def _quantile(means: Floats, weights: Floats, widths: Floats, q: Floats, out: Floats) -> None:
    """Fill out (n_poses, n_rays) with the quantiles q (n_poses, n_rays)."""
    for i in range(out.shape[0]):
        for b in range(out.shape[1]):
            n = count_of(weights[i, b])
            total = total_of(weights[i, b], n)
            out[i, b] = math.inf
            if total > 0.0:
                out[i, b] = quantile_of(means[i, b], weights[i, b], widths[i, b], 0, n, q[i, b] * total)
