"""Edges of visible stretches: change points in the outcomes of rays along a face.

Optimal partitioning (Jackson et al. 2005): F(b) = min_{a < b} (F(a) + penalty + C(a, b)), with F(0) = -penalty.
Cost of a stretch: C(a, b) = -s log p - (w - s) log(1 - p), with p = (s + prior_stops) / (w + prior_crossings).
The sums s of the stops and w of the weights run over the crossings between a and b.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from planners.groups import members
from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.models.faces.blurred_edges import Outcomes, blur_edges
from sensorgraph.models.faces.ray_march import MIN_LENGTH, MIN_VISIBILITY, FaceSet, bucket_grid
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import (
    MIN_SQUARED_COSINE,
    PRIOR_CROSSINGS,
    PRIOR_STOPS,
    Rays,
    ReturnNoise,
    new_stop_work,
    stop_probabilities,
)
from sensorgraph.types import Bools, Floats, Ints

MAX_RUNS = 600
"""Maximum number of runs of equal outcome in one stretch."""
MIN_REACHED = 0.2
"""Probability of reaching a crossing below which it is not counted."""
MIN_LEVEL = 5 * MIN_VISIBILITY
"""Visibility below which a stretch is set to 0."""


class Crossings(NamedTuple):
    """Outcomes of rays where they crossed faces, sorted along each face."""

    t: Floats
    """(n_looks,) [m] abscissa of the crossing."""
    stop: Floats
    """(n_looks,) probability that the ray stopped there, given that it came that far."""
    weight: Floats
    """(n_looks,) probability that the ray came that far, times the number of rays it represents."""
    error: Floats
    """(n_looks,) [m] standard error of the abscissa, from the noise of the poses."""
    bounds: Ints
    """(n_faces + 1,) index of each face's first crossing."""

    def at(self, k: int) -> Outcomes:
        """Return the crossings of face k."""
        part = slice(self.bounds[k], self.bounds[k + 1])
        return Outcomes(self.t[part], self.stop[part], self.weight[part], self.error[part])

    def of_faces(self, index: Ints) -> Crossings:
        """Return the crossings of some faces, in the order of `index`."""
        place, bounds = _places(self.bounds, index)
        return Crossings(self.t[place], self.stop[place], self.weight[place], self.error[place], bounds)


def fit_stretches(faces: FaceSet, crossings: Crossings) -> FaceSet:
    """Replace bins by stretches of constant visibility with edges at the change points of the outcomes.

    The crossings of each face, sorted along it, are partitioned by dynamic programming. An edge lies midway between
    the adjacent crossings; if their positions are uncertain, it lies at the maximum of the likelihood
    (`blurred_edges`). Faces that stop no ray remain; see `has_length`.
    """
    first, edges, levels, blur = [0], [], [], []
    for k in range(faces.n_faces):
        cut, level, gap = _stretches(crossings.at(k))
        edges.append(cut)
        levels.append(level)
        blur.append(gap)
        first.append(first[-1] + len(cut))
    n_edges = first[-1]
    return FaceSet(
        normals=faces.normals, offsets=faces.offsets, first=np.array(first, dtype=np.intp),
        edges=np.concatenate(edges) if edges else np.zeros(0),
        levels=np.concatenate(levels) if levels else np.zeros(0),
        blur=np.concatenate(blur) if blur else np.zeros(0), neighbour=np.full(n_edges, -1, dtype=np.intp),
    )  # fmt: skip


def crossings_of(
    rays: Rays, faces: FaceSet, noise: ReturnNoise, pose_errors: tuple[float, float] = (0.0, 0.0)
) -> Crossings:
    """List the crossings of rays with faces; the errors of refined poses `pose_errors` [m, rad] add to the noise."""
    xy, yaw = np.hypot([noise.sigma_xy, noise.sigma_yaw], pose_errors)
    buckets, work, n, size = bucket_grid(faces), new_stop_work(), 3 * len(rays) + 64, 0
    while n > size:  # the first size is rarely too small: a ray crosses fewer than three faces on average
        size = n
        face: Any = np.empty(size, np.int32)
        rows = np.empty((4, size))
        n = _list_crossings(rays.arrays, faces, buckets, noise.array, xy**2, yaw**2, work, face, rows)
    t, stop, weight, error = rows[:, :n]
    return sorted_crossings(face[:n], t, stop, weight, error, faces.n_faces)


def sorted_crossings(
    face: Ints, t: Floats, stop: Floats, weight: Floats, error: Floats, n_faces: int
) -> Crossings:
    """Sort crossings (n,) by face, then by abscissa."""
    order = np.lexsort((t, face.astype(np.min_scalar_type(n_faces))))  # numpy sorts 16 bits by radix
    bounds = np.searchsorted(face[order], np.arange(n_faces + 1))
    return Crossings(t[order], stop[order], weight[order], error[order], bounds)


def has_length(faces: FaceSet) -> Bools:
    """Return a mask (n_faces,) of the faces with a visible stretch of some length; corners may take all of a face."""
    stretches = (faces.levels[:-1] > MIN_VISIBILITY) & (np.diff(faces.edges) > MIN_LENGTH)
    owner = faces.owners[:-1]
    return np.bincount(owner[stretches], minlength=faces.n_faces) > 0


def _places(bounds: Ints, index: Ints) -> tuple[Ints, Ints]:
    """Return the members of some groups, given by the first member of each (n_groups + 1,), and their own bounds."""
    owner, rank = members(np.diff(bounds)[index])
    return bounds[index][owner] + rank, np.append(0, np.cumsum(np.diff(bounds)[index])).astype(np.intp)


def take_faces(faces: FaceSet, index: Ints) -> FaceSet:
    """Return some faces; neighbours that are removed become -1."""
    place, first = _places(faces.first, index)
    renamed = np.full(faces.n_faces + 1, -1, dtype=np.intp)
    renamed[index] = np.arange(len(index))
    return FaceSet(
        normals=faces.normals[index], offsets=faces.offsets[index],
        first=first,
        edges=faces.edges[place], levels=faces.levels[place], blur=faces.blur[place],
        neighbour=renamed[faces.neighbour[place]],
    )  # fmt: skip


def joined_faces(a: FaceSet, b: FaceSet) -> FaceSet:
    """Concatenate faces, those of `a` first; neighbours refer to `a`."""
    return FaceSet(
        normals=np.concatenate([a.normals, b.normals]), offsets=np.concatenate([a.offsets, b.offsets]),
        first=np.concatenate([a.first, a.first[-1] + b.first[1:]]),
        edges=np.concatenate([a.edges, b.edges]), levels=np.concatenate([a.levels, b.levels]),
        blur=np.concatenate([a.blur, b.blur]), neighbour=np.concatenate([a.neighbour, b.neighbour]),
    )  # fmt: skip


@outer_kernel
def _list_crossings(
    rays: Any,
    faces: Any,
    buckets: Any,
    noise: Any,
    var_xy: Any,
    var_yaw: Any,
    work: Any,
    face: Any,
    rows: Any,
) -> Any:
    """List crossings as far as there is memory for them, and return how many there are.

    Fills `face`, and `rows` (4, n): abscissa, P(stop | reached), P(reached) times the ray's weight, standard error.
    """
    normals, weights = faces[0], rays.weights
    march, gamma, survive = work
    r, k, _, t = march
    count = 0
    for i in range(len(rays.ranges)):
        n, _, stray = stop_probabilities(i, rays, faces, buckets, noise, work)
        if stray > 0.5:
            continue
        for m in range(n):
            if survive[m] < MIN_REACHED:
                continue
            count += 1
            if count > len(face):
                continue
            c = count - 1
            face[c], rows[0, c] = k[m], t[m]
            den = normals[k[m], 0] * rays.directions[i, 0] + normals[k[m], 1] * rays.directions[i, 1]
            rows[3, c] = np.sqrt((var_xy + r[m] * r[m] * var_yaw) / max(den * den, MIN_SQUARED_COSINE))
            rows[1, c] = min(gamma[m] / survive[m], 1.0)
            rows[2, c] = survive[m] * (weights[i] if len(weights) else 1.0)
    return count


def _stretches(crossings: Outcomes) -> tuple[Floats, Floats, Floats]:
    """Partition sorted crossings; return edges, visibility after each (the last is 0) and standard errors."""
    t, stop, weight, error = crossings
    if len(t) == 0:
        return np.array([0.0, 1e-9]), np.zeros(2), np.zeros(2)
    penalty = FACES.min_edge_gain + 0.5 * np.log(len(t))
    cuts = _without_weak_cuts(_partition(stop, weight, penalty), stop, weight, penalty)
    stopped, crossed = np.add.reduceat(stop * weight, cuts[:-1]), np.add.reduceat(weight, cuts[:-1])
    level = (stopped + PRIOR_STOPS) / (crossed + PRIOR_CROSSINGS)
    inner = cuts[1:-1]
    edges = np.concatenate([t[:1], (t[inner - 1] + t[inner]) / 2, t[-1:]])
    gap = np.concatenate([[0.0], (t[inner] - t[inner - 1]) / np.sqrt(12), [0.0]])
    level = np.append(level, 0.0)
    if len(inner) and error.any():
        edges, level, gap = blur_edges(crossings, edges, level, gap, penalty)
    level[level < MIN_LEVEL] = 0.0
    return edges + 1e-9 * np.arange(len(edges)), level, gap


def _without_weak_cuts(cuts: Ints, stop: Floats, weight: Floats, penalty: float) -> Ints:
    """Remove cuts whose gain is below the penalty; they occur in stretches with more runs than the partition allows."""

    def cost(first: int, last: int) -> float:
        return float(_cost(*(sums[last] - sums[first])))

    sums = np.zeros((len(stop) + 1, 2))
    np.cumsum(np.column_stack([stop * weight, weight]), axis=0, out=sums[1:])
    kept = cuts.tolist()
    k = 1
    while k < len(kept) - 1:
        a, b, c = kept[k - 1 : k + 2]
        if cost(a, c) - cost(a, b) - cost(b, c) < penalty:
            del kept[k]
            k = max(k - 1, 1)
        else:
            k += 1
    return np.array(kept, dtype=np.intp)


@inner_kernel
def _cost(s: Any, w: Any) -> Any:
    """Return the cost C [nats] of a stretch with the sums s of stops and w of weights."""
    p = (s + PRIOR_STOPS) / (w + PRIOR_CROSSINGS)
    return -s * np.log(p) - (w - s) * np.log(1 - p)


def _partition(stop: Floats, weight: Floats, penalty: float) -> Ints:
    """Partition outcomes; return the first crossing of every stretch and the number of crossings."""
    whole, real = np.zeros((4, len(stop) + 1), np.int64), np.zeros((4, len(stop) + 1))
    n = _cut(stop, weight, penalty, whole, real)
    return whole[0, :n][::-1]


@outer_kernel
def _cut(stop: Any, weight: Any, penalty: Any, whole: Any, real: Any) -> Any:
    """Partition n outcomes by dynamic programming; return the number of cuts, which whole[0] holds from n down to 0.

    F(a) + C(a, b) never falls with b, so its last value is a bound that excludes most starts a. A start is dropped where
    this exceeds F(b): to start at b is then better for every later end (PELT, Killick et al. 2012). Both hold up to the
    effect of the priors on C, which is below `PRIOR_CROSSINGS`. `whole` and `real` (4, n + 1) are memory of zeros.
    """
    cuts, starts, since, open_ = whole  # starts: of runs of equal outcome; edges lie between runs
    ones, all_, best, so_far = real
    n, n_runs = len(stop), 0
    for i in range(n):
        if i == 0 or (stop[i] > 0.5) != (stop[i - 1] > 0.5):
            starts[n_runs] = i
            n_runs += 1
    starts[n_runs] = n
    for a in range(n_runs):
        s, w = 0.0, 0.0
        for i in range(starts[a], starts[a + 1]):
            s += stop[i] * weight[i]
            w += weight[i]
        ones[a + 1], all_[a + 1] = ones[a] + s, all_[a] + w
    best[0], open_[0], so_far[0], n_open = -penalty, 0, -penalty, 1
    for b in range(1, n_runs + 1):
        first = since[b - 1]  # likely the best start again
        best[b] = np.inf
        if first >= b - MAX_RUNS:
            best[b] = best[first] + penalty + _cost(ones[b] - ones[first], all_[b] - all_[first])
            since[b] = first
        n_kept = 0
        for m in range(n_open):
            a = open_[m]
            if a < b - MAX_RUNS:
                continue
            if so_far[m] + penalty < best[b] + PRIOR_CROSSINGS:
                so_far[m] = best[a] + _cost(ones[b] - ones[a], all_[b] - all_[a])
                if so_far[m] + penalty < best[b]:
                    best[b], since[b] = so_far[m] + penalty, a
            open_[n_kept], so_far[n_kept] = a, so_far[m]
            n_kept += so_far[m] < best[b] + PRIOR_CROSSINGS
        open_[n_kept], so_far[n_kept] = b, best[b]
        n_open = n_kept + 1
    m, b = 0, n_runs
    while b > 0:
        cuts[m] = starts[b]
        m += 1
        b = since[b]
    cuts[m] = 0
    return m + 1
