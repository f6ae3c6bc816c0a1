"""Errors that neighbouring returns share, estimated from the correlation of the residuals.

Walls are not straight, and a laser measures them differently at another incidence or height. The mean residual of
cluster c towards the robot, in standard deviations of a point, is modelled as

    z_c = u(x_c, f_c) + w_c / √n_c

with white noise w and n_c points. The shared error u has variance `ratio`; its correlation falls linearly to 0 over
`length` [m] and `frames` [key frames]. A draw has one normal number for each cell of these sides, with a random origin.

The fit of poses and lines absorbs a part of u. Therefore the correlations of the residuals are compared with those
of simulated residuals after the same fit (indirect inference, Gourieroux, Monfort and Renault 1993). The products
z_c z_d of neighbouring clusters contain no white noise but what the fit spreads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from sensorgraph.localization.point_rows import MeanResiduals
from sensorgraph.localization.refinement import ReducedSystem, conjugate_gradients, sums_of
from sensorgraph.types import Floats, Ints

LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""[m] Candidates of the correlation length."""
FRAMES = (2.0, 4.0, 8.0, 16.0, 32.0)
"""[key frames] Candidates of the correlation time."""
DISTANCES = (0.3, 0.5, 0.8, 1.2, 2.0, 3.0)
"""[m] Upper limits of the distances at which residuals of a key frame are compared."""
LAGS = (1, 2, 3, 4, 6, 8, 12, 16)
"""[key frames] Distances at which residuals of a patch are compared."""
PARALLEL = 0.9
"""Minimum cosine between the normals of compared patches."""
MAX_FRAMES = 400
"""Maximum number of key frames whose residuals are compared by distance."""
MIN_PAIRS = 30
"""Minimum number of pairs of clusters at a distance."""
SIMULATED = 400_000
"""Number of simulated residuals of a candidate ..."""
DRAWS = (3, 24)
"""... in a number of draws between these."""
TOLERANCE, MAX_STEPS = 1e-2, 100
"""Relative residual at which conjugate gradients stop, and number of their steps: simulated residuals need little accuracy."""
TABLE = 1 << 16
"""Number of independent normal numbers. Cells that share one are far apart, or of another draw."""


@dataclass(frozen=True, kw_only=True)
class SurfaceErrors:
    """Model of the shared errors."""

    length: float
    """[m] Distance over which the correlation falls to 0."""
    frames: float
    """[key frames] The same in the order of the key frames."""
    ratio: float
    """Variance of the shared error, relative to that of a point."""
    white: float
    """Share of the variance of the residuals that is not shared."""

    def draw(self, middle: Floats, frame: Floats | Ints, rng: np.random.Generator, n: int) -> Floats:
        """Return shared errors (n_clusters, n), in standard deviations of a point.

        Parameters
        ----------
        middle : (n_clusters, 2) [m] Positions of the clusters in map.
        frame : (n_clusters,) Key frames; scans between two of them have fractions.
        """
        return float(np.sqrt(self.ratio)) * _cells(middle, frame, self.length, self.frames, rng, n)


def _cells(
    middle: Floats, frame: Floats | Ints, length: float, frames: float, rng: np.random.Generator, n: int
) -> Floats:
    """Return normal numbers (n_clusters, n) that clusters in the same cell share."""
    out, table = np.empty((len(middle), n)), rng.normal(size=TABLE)
    for k in range(n):
        origin, key = rng.uniform(size=3), rng.integers(TABLE)
        x, y = np.floor(middle.T / length + origin[:2, None]).astype(np.int64)
        t = np.floor(frame / frames + origin[2]).astype(np.int64)
        out[:, k] = table[(key ^ 73856093 * x ^ 19349663 * y ^ 83492791 * t) & (TABLE - 1)]
    return out


def right_hand_sides(system: ReducedSystem, errors: Floats) -> tuple[Floats, Floats]:
    """Return what errors (n_clusters, n) of the mean residuals add to the normal equations.

    Returns
    -------
    Right-hand sides of the reduced system (3 n_frames, n), and of the lines (2 n_patches, n).
    """
    clusters, n, m = system.clusters, system.n_frames, len(system.inverse) // 2
    moved = errors * (clusters.side * clusters.deviation)[:, None]
    pose, line = np.empty((3 * n, errors.shape[1])), np.empty((2 * m, errors.shape[1]))
    for k, column in enumerate(moved.T):
        pose[:, k] = sums_of(clusters.by_pose * column[:, None], clusters.frame, n)
        line[:, k] = sums_of(clusters.by_line * column[:, None], clusters.patch, m)
    return pose - system.coupling @ (system.inverse[:, None] * line), line


class _Correlations:
    """Mean products of the residuals of neighbouring clusters, by distance and by key frames in between."""

    def __init__(self, clusters: MeanResiduals) -> None:
        frame = clusters.frame
        self.pairs: list[tuple[Ints, Ints]] = []
        step = max(int(frame.max()) // MAX_FRAMES, 1)
        chosen = np.flatnonzero(frame % step == 0)
        middle, facing = clusters.middle[chosen], clusters.facing[chosen]
        apart = frame[chosen] * (2.0 * DISTANCES[-1])  # clusters of other frames are no neighbours
        near = cKDTree(np.column_stack([middle, apart])).query_pairs(DISTANCES[-1], output_type="ndarray")
        near = near[np.einsum("ni,ni->n", facing[near[:, 0]], facing[near[:, 1]]) > PARALLEL]
        way = np.hypot(*(middle[near[:, 0]] - middle[near[:, 1]]).T)
        for low, high in zip((0.0, *DISTANCES[:-1]), DISTANCES, strict=True):
            inside = near[(way >= low) & (way < high)]
            self.pairs.append((chosen[inside[:, 0]], chosen[inside[:, 1]]))
        m = int(clusters.patch.max()) + 1
        keys = frame * m + clusters.patch
        for lag in LAGS:
            other = np.minimum(np.searchsorted(keys, keys + lag * m), len(keys) - 1)
            first = np.flatnonzero(keys[other] == keys + lag * m)
            self.pairs.append((first, other[first]))
        self.pairs = [pair for pair in self.pairs if len(pair[0]) >= MIN_PAIRS]

    def of(self, residuals: Floats) -> Floats:
        """Return the mean products (n_pairs,) of residuals (n_clusters, n)."""
        return np.array([float((residuals[a] * residuals[b]).mean()) for a, b in self.pairs])


def map_surface_errors(
    system: ReducedSystem, preconditioner: sparse.csc_array, rng: np.random.Generator
) -> SurfaceErrors:
    """Estimate the shared errors of the surfaces of a new map, which are fitted together with all poses."""
    clusters = system.clusters

    def fitted(errors: Floats) -> Floats:
        rhs, line = right_hand_sides(system, errors)
        moved = conjugate_gradients(system, rhs, preconditioner, TOLERANCE, MAX_STEPS)
        lines = system.inverse[:, None] * (line - system.transposed_coupling @ moved)
        k, m = errors.shape[1], len(line) // 2
        by_pose = np.einsum("ci,cik->ck", clusters.by_pose, moved.reshape(-1, 3, k)[clusters.frame])
        by_line = np.einsum("ci,cik->ck", clusters.by_line, lines.reshape(m, 2, k)[clusters.patch])
        off = (by_pose + by_line) / clusters.weight[:, None]
        return np.asarray(errors - off * (clusters.side / clusters.deviation)[:, None])

    return surface_errors(clusters, fitted, rng)


def surface_errors(
    clusters: MeanResiduals, fitted: Callable[[Floats], Floats], rng: np.random.Generator
) -> SurfaceErrors:
    """Estimate the shared errors from the residuals.

    Length and frames are found by coordinate search; the ratio is a least-squares fit for each. It is multiplied by
    the explained share of the squared correlations, so that a chance pattern counts little.

    Parameters
    ----------
    fitted : Returns the residuals of errors (n_clusters, n) after the fit, (n_clusters, n).
    """
    none = SurfaceErrors(length=LENGTHS[0], frames=FRAMES[0], ratio=0.0, white=1.0)
    if len(clusters.frame) < MIN_PAIRS:
        return none
    correlations = _Correlations(clusters)
    if not correlations.pairs:
        return none
    n = int(np.clip(SIMULATED // len(clusters.frame), *DRAWS))
    white = rng.normal(size=(len(clusters.frame), 2 * n)) / np.sqrt(clusters.count)[:, None]
    excess = correlations.of(clusters.residual[:, None]) - correlations.of(fitted(white))
    total = float(excess @ excess)
    tried: dict[tuple[int, int], tuple[float, float, float]] = {}

    def cost(at: tuple[int, int]) -> float:
        if at not in tried:
            length, frames = LENGTHS[at[0]], FRAMES[at[1]]
            left = fitted(_cells(clusters.middle, clusters.frame, length, frames, rng, n))
            expected = correlations.of(left)
            ratio = max(float(expected @ excess) / max(float(expected @ expected), 1e-300), 0.0)
            misfit = float(((excess - ratio * expected) ** 2).sum()) / max(total, 1e-300)
            tried[at] = misfit, ratio, float((left**2).mean())
        return tried[at][0]

    best, last = (len(LENGTHS) // 2, len(FRAMES) // 2), (-1, -1)
    while best != last:
        last = best
        i, j = last
        around = [(i + a, j + b) for a, b in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))]
        inside = [at for at in around if 0 <= at[0] < len(LENGTHS) and 0 <= at[1] < len(FRAMES)]
        best = min(inside, key=cost)
    misfit, ratio, kept = tried[best]
    ratio *= max(1.0 - misfit, 0.0)
    square = float((clusters.residual**2).mean())
    return SurfaceErrors(
        length=LENGTHS[best[0]],
        frames=FRAMES[best[1]],
        ratio=ratio,
        white=max(1.0 - ratio * kept / max(square, 1e-300), 0.0),
    )
