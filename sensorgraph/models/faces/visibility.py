"""Visibility of faces by EM: which crossing stopped each ray.

Likelihood of a return z: p(z) = sum_m S_m alpha_m N(z; r_m, var_m) + before * stray, S_m = prod_{i<m} (1 - alpha_i).
Here alpha_m is the visibility of face k[m] at its crossing at range r_m. The factor `before` is the probability of
passing all faces nearer than z, and `stray` is the density of outliers. Without a return: prod_m (1 - alpha_m).

The E step computes gamma_m = P(stopped at m | z) and the sums that the M step (`maximisation`) needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from planners.kernel import inlined_kernel, inner_kernel, outer_kernel
from sensorgraph.models.distribution import TAIL
from sensorgraph.models.faces.forward_selection import Lines
from sensorgraph.models.faces.ray_march import (
    CANDIDATE_SLOTS,
    END_MARGIN,
    BucketGrid,
    FaceSet,
    March,
    bucket_grid,
    crossed_faces,
    new_march,
)
from sensorgraph.types import Floats, Ints

FIRST_BIN = 0.01
"""[m] Bin size along a face for the first estimate of its visibility."""
FIRST_VISIBILITY, FAINT = 0.8, 0.1
"""Initial visibility within the span of the hits, and in the margin around it; below the second, a face has ended."""
PRIOR_STOPS = 0.02
PRIOR_CROSSINGS = 2 * PRIOR_STOPS
"""Prior numbers of stops on a stretch and of crossings of it: a visibility of one half, with little weight."""
MIN_COSINE = 0.05
"""|n·u| below which a hit does not move its face, since grazing incidence amplifies errors; a variance is limited there."""
MIN_SQUARED_COSINE = MIN_COSINE**2
FIT_SIGMAS = 4.0
"""Standard deviations beyond which a return affects neither line nor noise, and an edge neither stops nor passes."""
GATE, FIT_GATE = TAIL**2, FIT_SIGMAS**2
"""Squared gates, in standard deviations squared; a return beyond the first is not from a face."""
REACH_MARGIN = 0.08
"""[m] Distance behind a return, in addition to `TAIL`, up to which faces may have stopped the ray."""
MIN_FIT_SHARE = 0.01
"""Probability of being from a face below which a return does not move it."""
MIN_VARIANCE = 1e-8
"""[m²] Lower limit of the variance of the range noise and of an edge's position: (0.1 mm)²."""
MIN_PASSED, MIN_LIKELIHOOD = 1e-5, 1e-12
"""Lower limits of logarithms' arguments: probability of passing a stretch, and likelihood of a ray [1/m]."""


class RayArrays(NamedTuple):
    """`Rays` for kernels."""

    origins: Floats
    directions: Floats
    ranges: Floats
    range_max: float
    weights: Floats
    """(n,), or (0,) if all are 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rays:
    """Rays as measured by the laser."""

    origins: Floats
    """(n, 2) [m] positions of the laser in map."""
    directions: Floats
    """(n, 2) unit vectors."""
    ranges: Floats
    """(n,) [m] ranges; +inf: no return up to `range_max`. Neither nan nor -inf occurs."""
    range_max: float
    weights: Floats | None = None
    """(n,) number of rays of the log that each ray represents; None: 1."""

    def __len__(self) -> int:
        return len(self.ranges)

    def take(self, index: Ints | slice) -> Rays:
        """Return some of the rays."""
        return Rays(
            origins=np.ascontiguousarray(self.origins[index]),  # kernels are compiled for this layout
            directions=np.ascontiguousarray(self.directions[index]),
            ranges=np.ascontiguousarray(self.ranges[index]),
            range_max=self.range_max,
            weights=None if self.weights is None else self.weights[index],
        )

    @property
    def arrays(self) -> RayArrays:
        """The rays for kernels."""
        weights = np.zeros(0) if self.weights is None else self.weights
        return RayArrays(self.origins, self.directions, self.ranges, self.range_max, weights)

    @property
    def hits(self) -> Floats:
        """(n, 2) [m] end points; not finite without a return."""
        with np.errstate(invalid="ignore"):
            return self.origins + self.ranges[:, None] * self.directions


@dataclass(frozen=True, kw_only=True)
class ReturnNoise:
    """Variance of a return from a face: var = sigma² + (growth r)² + (sigma_xy² + (r u·t sigma_yaw)²) / (n·u)²."""

    sigma: float
    """[m] Noise of the range."""
    sigma_xy: float = 0.0
    """[m] Noise of the pose, across the face."""
    sigma_yaw: float = 0.0
    """[rad] Noise of the heading."""
    stray: float = 1e-3
    """[1/m] Density of outliers: returns that no face explains."""
    growth: float = 0.0
    """[m/m] Noise of the range that grows with it, as that of lasers that triangulate."""

    @property
    def array(self) -> Floats:
        """(5,) variances of range, position and heading, the density of outliers and the square of the growth, for kernels."""
        return np.array([self.sigma**2, self.sigma_xy**2, self.sigma_yaw**2, self.stray, self.growth**2])

    def at(self, ranges: Floats) -> Floats:
        """Return the standard deviations [m] of ranges (n,) [m] from exact poses."""
        return np.hypot(self.sigma, self.growth * ranges)

    def typical(self, rays: Rays) -> float:
        """Return the standard deviation [m] of the median range among rays."""
        returned = rays.ranges[np.isfinite(rays.ranges)]
        return float(self.at(np.median(returned, keepdims=True))[0]) if len(returned) else self.sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class Expectation:
    """Sums of one E step over the rays."""

    stops: Floats
    """(n_edges,) expected number of stops on each stretch."""
    reached: Floats
    """(n_edges,) expected number of rays that reached each stretch."""
    line_sums: Floats
    """(n_faces, 8) sums of w, w s, w s², w e', w s e', gamma, w e'², nats; e' = e·(n·u) [m], s abscissa.

    The last column is the log likelihood [nats] lost without the face.
    """
    noise_sums: Floats
    """(4, 5) normal equations of e² on 1, 1/(n·u)², (r u·t / n·u)², r²."""
    unexplained: Floats
    """(n,) probability that the ray returned without a face stopping it."""
    nats: Floats
    """(n,) log likelihood of each ray, without its weight."""
    log_likelihood: float
    """Log likelihood of all rays."""
    distance: float
    """[m] Total length of all rays."""


def binned_faces(lines: Lines) -> FaceSet:
    """Divide lines into bins, visible within their spans and faintly visible in a margin around them."""
    first, edges, levels = [0], [], []
    for low, high in lines.spans:
        n = int(np.ceil((high - low + 4 * END_MARGIN) / FIRST_BIN))
        here = low - 2 * END_MARGIN + FIRST_BIN * np.arange(n + 1)
        middle = here + FIRST_BIN / 2
        edges.append(here)
        is_inside = (middle > low) & (middle < high)
        levels.append(np.where(is_inside, FIRST_VISIBILITY, FAINT))
        levels[-1][-1] = 0.0
        first.append(first[-1] + n + 1)
    n_edges = first[-1]
    return FaceSet(
        normals=lines.normals.copy(), offsets=lines.offsets.copy(), first=np.array(first, dtype=np.intp),
        edges=np.concatenate(edges) if edges else np.zeros(0),
        levels=np.concatenate(levels) if levels else np.zeros(0), blur=np.zeros(n_edges),
        neighbour=np.full(n_edges, -1, dtype=np.intp),
    )  # fmt: skip


def visible_lines(faces: FaceSet) -> Lines:
    """Return the lines with the spans of their stretches that are not far below the initial visibility of a margin."""
    spans = np.zeros((faces.n_faces, 2))
    for k in range(faces.n_faces):
        j = np.arange(faces.first[k], faces.first[k + 1] - 1)
        visible = j[faces.levels[j] > 0.5 * FAINT]
        spans[k] = (faces.edges[visible[0]], faces.edges[visible[-1] + 1]) if len(visible) else (0.0, 0.0)
    return Lines(normals=faces.normals, offsets=faces.offsets, spans=spans)


def e_step(rays: Rays, faces: FaceSet, noise: ReturnNoise, buckets: BucketGrid | None = None) -> Expectation:
    """Compute the expected stops, crossings and sums of every face (E step); rays count by their weights."""
    buckets = bucket_grid(faces) if buckets is None else buckets
    stops, reached = np.zeros(len(faces.edges)), np.zeros(len(faces.edges))
    lines, spread = np.zeros((faces.n_faces, 8)), np.zeros((4, 5))
    unexplained, nats, total = np.zeros(len(rays)), np.zeros(len(rays)), np.zeros(2)
    work, passed = new_stop_work(), (np.empty(len(faces.levels)), np.empty(5))
    sums = stops, reached, lines, spread, unexplained, nats, total
    _e_step(rays.arrays, faces, buckets, noise.array, work, passed, sums)
    return Expectation(
        stops=stops, reached=reached, line_sums=lines, noise_sums=spread, unexplained=unexplained,
        nats=nats, log_likelihood=float(total[0]), distance=float(total[1]),
    )  # fmt: skip


@inner_kernel
def variance(rho: Any, t_u: Any, den: Any, noise: Any) -> Any:
    """Return the variance [m²] of a return from a face at range rho, with t_u = t·u and den = n·u."""
    return (
        noise[0]
        + rho * rho * noise[4]
        + (noise[1] + (rho * t_u) ** 2 * noise[2]) / max(den * den, MIN_SQUARED_COSINE)
    )


class StopWork(NamedTuple):
    """What `stop_probabilities` fills for one ray."""

    march: March
    gamma: Floats
    """(CANDIDATE_SLOTS,) P(stopped at m | z)."""
    survive: Floats
    """(CANDIDATE_SLOTS,) P(reached m | z)."""


def new_stop_work() -> StopWork:
    """Return memory for one ray."""
    return StopWork(new_march(), np.empty(CANDIDATE_SLOTS), np.empty(CANDIDATE_SLOTS))


@inlined_kernel
def stop_probabilities(i: Any, rays: Any, faces: Any, buckets: Any, noise: Any, work: Any) -> Any:
    """List the faces that ray i crosses up to its range, and the probabilities that they stopped it, in `work`.

    Returns the number of crossings, the likelihood p(z) [1/m] of the measured range, and the probability that it is an
    outlier.
    """
    normals, _, first, _, levels, _, _ = faces
    march, gamma, survive = work
    r, k, j, _ = march
    ux, uy, z = rays.directions[i, 0], rays.directions[i, 1], rays.ranges[i]
    reach = rays.range_max if z > 1e300 else z + REACH_MARGIN + TAIL * np.sqrt(noise[0] + z * z * noise[4])
    n = crossed_faces(rays.origins[i, 0], rays.origins[i, 1], ux, uy, reach, 0.0, faces, buckets, march)
    survival, total, before = 1.0, 0.0, 1.0
    for m in range(n):
        f = k[m]
        gamma[m] = 0.0
        alpha = levels[j[m]] if j[m] >= first[f] else 0.0
        if z < 1e300:
            den = normals[f, 0] * ux + normals[f, 1] * uy
            var = variance(r[m], -normals[f, 1] * ux + normals[f, 0] * uy, den, noise)
            e = z - r[m]
            if e * e < GATE * var:
                gamma[m] = survival * alpha * np.exp(-0.5 * e * e / var) / np.sqrt(2 * np.pi * var)
                total += gamma[m]
            if r[m] < z:
                before = survival * (1 - alpha)
        survival *= 1 - alpha
    if z > 1e300:
        for m in range(n):
            survive[m] = 1.0
        return n, survival, 0.0
    stray = before * noise[3]
    total += stray
    left = 1.0
    for m in range(n):
        gamma[m] /= total
        survive[m] = left if (r[m] < z or gamma[m] > 0) else 0.0
        left = max(left - gamma[m], 0.0)
    # a crossing behind the measured range was not reached, unless noise explains the order
    for m in range(n):
        if r[m] > z:
            survive[m] = min(survive[m], gamma[m])
    return n, total, stray / total


@inlined_kernel
def hit_of(m: Any, i: Any, rays: Any, faces: Any, noise: Any, work: Any) -> Any:
    """Compare the return of ray i with crossing m, unless it is grazing or too far from the face.

    Returns whether it is neither; n·u, t·u, the residual e [m] and its variance [m²].
    """
    f, rho = work.march.k[m], work.march.r[m]
    ux, uy, normals = rays.directions[i, 0], rays.directions[i, 1], faces[0]
    den = normals[f, 0] * ux + normals[f, 1] * uy
    t_u = -normals[f, 1] * ux + normals[f, 0] * uy
    var, e = variance(rho, t_u, den, noise), rays.ranges[i] - rho
    return den <= -MIN_COSINE and e * e <= FIT_GATE * var, den, t_u, e, var


@outer_kernel
def _e_step(rays: Any, faces: Any, buckets: Any, noise: Any, work: Any, passed: Any, sums: Any) -> Any:
    """Add up the `sums` of an `Expectation`: the first six fields, and log likelihood and distance (2,).

    `work` and `passed`, arrays of n_edges and of 5 numbers, are memory.
    """
    first, levels = faces[2], faces[4]
    stops, reached, lines, spread, unexplained, nats, total = sums
    march, gamma, survive = work
    r, k, j, t = march
    range_max, weights = rays.range_max, rays.weights
    passed, terms = passed
    for m in range(len(levels)):
        passed[m] = np.log(max(1.0 - levels[m], MIN_PASSED))
    for i in range(len(rays.ranges)):
        n, value, stray = stop_probabilities(i, rays, faces, buckets, noise, work)
        count = weights[i] if len(weights) else 1.0
        nats[i] = np.log(max(value, MIN_LIKELIHOOD))
        total[0] += count * nats[i]
        total[1] += count * min(rays.ranges[i], range_max)
        unexplained[i] = stray
        for m in range(n):
            f = k[m]
            if j[m] < first[f]:
                continue
            reached[j[m]] += count * survive[m]
            stops[j[m]] += count * gamma[m]
            g = gamma[m]
            if g > 0:
                lines[f, 7] -= count * np.log(max(1.0 - g, MIN_PASSED))
            if survive[m] > 0 and g < 0.5:
                lines[f, 7] += count * survive[m] * passed[j[m]]
            if g < MIN_FIT_SHARE:
                continue
            is_hit, den, t_u, e, var = hit_of(m, i, rays, faces, noise, work)
            if not is_hit:
                continue
            across = e * den  # signed distance of the end point from the face
            w = count * g / (var * den * den)
            s = t[m] + e * t_u
            line = lines[f]
            line[0] += w
            line[1] += w * s
            line[2] += w * s * s
            line[3] += w * across
            line[4] += w * s * across
            line[5] += count * g
            line[6] += w * across * across
            if g > 0.5:
                x1, x2 = 1.0 / (den * den), (r[m] * t_u / den) ** 2
                terms[0], terms[1], terms[2], terms[3], terms[4] = 1.0, x1, x2, r[m] * r[m], e * e
                v = count / (var * var)
                for a in range(4):
                    for b in range(5):
                        spread[a, b] += v * terms[a] * terms[b]
