"""Splits of faces whose hits bend or step; a round column becomes as many faces as the noise allows to resolve."""

from __future__ import annotations

from typing import Any

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.models.faces.forward_selection import Lines
from sensorgraph.models.faces.ray_march import MIN_LENGTH, FaceSet, bucket_grid
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import (
    Rays,
    ReturnNoise,
    hit_of,
    new_stop_work,
    stop_probabilities,
    visible_lines,
)
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats

SLOPE_PRECISION = 1.0 / FACES.slope_prior**2
MIN_HITS = int(FACES.later_lines.min_hits)


def split_bent_faces(rays: Rays, faces: FaceSet, noise: ReturnNoise) -> Lines:
    """Return the lines of all faces; faces whose hits bend or step are divided into two or more lines."""
    face, hits = np.empty(len(rays), np.int32), np.empty((3, len(rays)))
    n = _list_hits(rays.arrays, faces, bucket_grid(faces), noise.array, new_stop_work(), face, hits)
    face, (s, across, weight) = face[:n], hits[:, :n]
    order = np.lexsort((s, face))
    face, s, across, weight = face[order], s[order], across[order], weight[order]
    bounds = np.searchsorted(face, np.arange(faces.n_faces + 1))
    whole = visible_lines(faces)
    normals, offsets, spans = [], [], []
    for k in range(faces.n_faces):
        part = slice(bounds[k], bounds[k + 1])
        pieces = _split(s[part], across[part], weight[part])
        if len(pieces) < 2:
            normals.append(whole.normals[k])
            offsets.append(whole.offsets[k])
            spans.append(whole.spans[k])
            continue
        n, t = faces.normals[k], np.array([-faces.normals[k, 1], faces.normals[k, 0]])
        for first, last, a, b in pieces:  # across = a + b s on s[first] ... s[last - 1]
            low, high = s[part][first], s[part][last - 1]
            ends = [n * (faces.offsets[k] + a + b * x) + t * x for x in (low, high)]
            along = ends[1] - ends[0]
            length = float(np.hypot(*along))
            if length < MIN_LENGTH:
                continue
            along = along / length
            normal = np.array([along[1], -along[0]])
            normals.append(normal)
            offsets.append(float(normal @ ends[0]))
            spans.append(np.array([along @ ends[0], along @ ends[1]]))
    return Lines(
        normals=np.array(normals).reshape(-1, 2),
        offsets=np.array(offsets),
        spans=np.array(spans).reshape(-1, 2),
    )


def _split(s: Floats, across: Floats, weight: Floats) -> list[tuple[int, int, float, float]]:
    """Divide sorted hits recursively where two lines gain more log likelihood over one than the penalty."""
    n = len(s)
    if n < 2 * MIN_HITS:
        return [(0, n, 0.0, 0.0)]
    penalty = FACES.min_split_gain + np.log(n)
    done: list[tuple[int, int, float, float]] = []
    todo = [(0, n)]
    while todo:
        a, b = todo.pop()
        cut, gain = _best_cut(s[a:b], across[a:b], weight[a:b], MIN_HITS)
        if gain > penalty:
            todo += [(a + cut, b), (a, a + cut)]
        else:
            done.append((a, b, *_line_fit(s[a:b], across[a:b], weight[a:b])))
    return done


def _line_fit(s: Floats, e: Floats, w: Floats) -> tuple[float, float]:
    """Fit e = a + b s: minimise sum_i w_i (e_i - a - b s_i)² + (b / slope_prior)²; return a and b."""
    mean_s, mean_e = w @ s / w.sum(), w @ e / w.sum()
    along = w * (s - mean_s)
    slope = along @ (e - mean_e) / (along @ (s - mean_s) + SLOPE_PRECISION)
    return float(mean_e - slope * mean_s), float(slope)


def _best_cut(s: Floats, e: Floats, w: Floats, min_hits: int) -> tuple[int, float]:
    """Find the cut that maximises the gain of two lines over one; return the first index of the second, and the gain.

    Gain [nats]: ½ (explained(first) + explained(second) - explained(all)), by prefix sums of the moments.
    """
    if len(s) < 2 * min_hits:
        return 0, 0.0
    x = s - s[len(s) // 2]
    sums = np.cumsum([w, w * x, w * x * x, w * e, w * x * e], axis=1)
    whole, first = sums[:, -1:], sums[:, min_hits - 1 : len(s) - min_hits]
    gain = 0.5 * (_explained(first) + _explained(whole - first) - _explained(whole))
    best = int(gain.argmax())
    return (best + min_hits, float(gain[best])) if gain[best] > 0 else (0, 0.0)


def _explained(m: Floats) -> Floats:
    """Return (sum w e)² / sum w + sxy² / sxx: the weighted squares that a line explains, from the moments m (5, n)."""
    total = np.maximum(m[0], 1e-300)  # hits without weight explain nothing
    sxx = m[2] - m[1] * m[1] / total + SLOPE_PRECISION
    sxy = m[4] - m[1] * m[3] / total
    return np.asarray(m[3] * m[3] / total + sxy * sxy / sxx)


@outer_kernel
def _list_hits(rays: Any, faces: Any, buckets: Any, noise: Any, work: Any, face: Any, hits: Any) -> Any:
    """List all hits, and return their number.

    Fills `face`, and `hits` (3, n): abscissa of the end point, distance from the face [m], 1 / variance of that distance.
    """
    count = 0
    for i in range(len(rays.ranges)):
        if rays.ranges[i] > 1e300:
            continue
        n, _, _ = stop_probabilities(i, rays, faces, buckets, noise, work)
        for m in range(n):
            if work.gamma[m] < MAJORITY:
                continue
            is_hit, den, t_u, e, var = hit_of(m, i, rays, faces, noise, work)
            if not is_hit:
                continue
            face[count] = work.march.k[m]
            hits[0, count], hits[1, count] = work.march.t[m] + e * t_u, e * den
            hits[2, count] = 1.0 / (var * den * den)
            count += 1
    return count
