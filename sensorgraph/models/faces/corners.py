"""Corners: ends of faces where two lines meet."""

from __future__ import annotations

import numpy as np

from sensorgraph.models.faces.blurred_edges import WINDOW, Outcomes, edge_log_likelihood
from sensorgraph.models.faces.change_points import Crossings, has_length, take_faces
from sensorgraph.models.faces.ray_march import MIN_LENGTH, FaceSet
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import FAINT, MIN_COSINE
from sensorgraph.types import Floats, Ints

NEAR = FACES.corner_distance
MAX_LOSS = 6.0
"""[nats] Maximum loss of log likelihood for a corner: one or two crossings on the wrong side."""
MIN_SINE = MIN_COSINE
"""Minimum sine of the angle between two lines that meet in a corner."""


def join_corners(faces: FaceSet, crossings: Crossings) -> FaceSet:
    """Move the ends of faces to the intersections of their lines, if the crossings there allow it.

    A corner is as accurate as both lines, while an end is known to a few millimetres. No ray passes between two
    faces that meet in a corner.
    """
    edges, neighbour, blur = faces.edges.copy(), faces.neighbour.copy(), faces.blur.copy()
    neighbour[:] = -1
    ends, owners = _ends(faces)
    places = faces.points(owners, edges[ends])
    for e, k, p in zip(ends, owners, places, strict=True):
        best = (MAX_LOSS, -1, 0.0)
        for other, s in _intersections(faces, k, p):
            cost = _loss(faces, e, k, s, crossings.at(k))
            cost += 0.5 * ((s - edges[e]) / NEAR) ** 2
            if cost < best[0]:
                best = (cost, other, s)
        if best[1] >= 0:
            edges[e], neighbour[e], blur[e] = best[2], best[1], 0.0
    out = faces._replace(edges=edges, neighbour=neighbour, blur=blur)
    return _without_empty_stretches(_with_sorted_edges(out))


def joined_visible(faces: FaceSet, crossings: Crossings) -> tuple[FaceSet, Crossings, Ints]:
    """Join the visible faces in corners; return those that keep some length, their crossings, and their old indices."""
    seen = np.flatnonzero(has_length(faces))
    faces, crossings = take_faces(faces, seen), crossings.of_faces(seen)
    faces = join_corners(faces, crossings)
    kept = np.flatnonzero(has_length(faces))
    return take_faces(faces, kept), crossings.of_faces(kept), seen[kept]


def _ends(faces: FaceSet) -> tuple[Ints, Ints]:
    """Return the edges at which a visible stretch begins or ends, and their faces."""
    owner = faces.owners
    after = faces.levels
    before = np.concatenate([[0.0], faces.levels[:-1]])
    before[faces.first[:-1]] = 0.0
    at = np.flatnonzero((np.minimum(before, after) < FAINT) & (np.maximum(before, after) > 0.5))
    return at, owner[at]


def _intersections(faces: FaceSet, k: int, p: Floats) -> list[tuple[int, float]]:
    """Return the faces whose visible stretch intersects line k near its point p, with the abscissae on line k."""
    cross = faces.normals @ faces.tangents[k]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = (faces.offsets - faces.normals @ p) / cross  # along t_k from p
    near = np.flatnonzero((np.abs(cross) > MIN_SINE) & (np.abs(ahead) < NEAR))
    out = []
    for m in near:
        meet = p + ahead[m] * faces.tangents[k]
        s = float(faces.tangents[m] @ meet)
        a, b = int(faces.first[m]), int(faces.first[m + 1]) - 1
        seen = np.flatnonzero(faces.levels[a:b] > 0.5) + a
        if len(seen) and ((faces.edges[seen] - NEAR <= s) & (s <= faces.edges[seen + 1] + NEAR)).any():
            out.append((int(m), float(faces.tangents[k] @ meet)))
    return out


def _loss(faces: FaceSet, e: int, k: int, s: float, crossings: Outcomes) -> float:
    """Return the log likelihood [nats] lost by moving edge e of face k to abscissa s; pose noise blurs edges."""
    old = float(faces.edges[e])
    margin = WINDOW * crossings.mean_error(old)
    near = crossings.between(min(old, s) - margin, max(old, s) + margin)
    before = faces.levels[e - 1] if e > faces.first[k] else 0.0
    stays, moves = edge_log_likelihood(near, before, faces.levels[e], np.array([old, s]))
    return float(stays - moves)


def _with_sorted_edges(faces: FaceSet) -> FaceSet:
    """Keep the edges of each face in increasing order after moves."""
    edges = faces.edges.copy()
    for k in range(faces.n_faces):
        part = slice(faces.first[k], faces.first[k + 1])
        edges[part] = np.maximum.accumulate(edges[part])
    return faces._replace(edges=edges)


def _without_empty_stretches(faces: FaceSet) -> FaceSet:
    """Merge both edges of each stretch that has no length, in faces that have some."""
    owner = faces.owners
    empty = np.zeros(len(owner), dtype=np.bool_)
    empty[:-1] = (np.diff(faces.edges) <= MIN_LENGTH) & (owner[1:] == owner[:-1])
    empty &= has_length(faces)[owner]
    blur, neighbour = faces.blur.copy(), faces.neighbour.copy()
    for j in np.flatnonzero(empty):  # in order, so that several in a row are merged into the last
        if neighbour[j] >= 0 and neighbour[j + 1] < 0:
            blur[j + 1], neighbour[j + 1] = blur[j], neighbour[j]
    keep = ~empty
    return faces._replace(
        first=np.concatenate([[0], np.cumsum(np.bincount(owner[keep], minlength=faces.n_faces))]),
        edges=faces.edges[keep],
        levels=faces.levels[keep],
        blur=blur[keep],
        neighbour=neighbour[keep],
    )


def with_edge_errors(faces: FaceSet, sums: Floats) -> FaceSet:
    """Add the uncertainty of the lines to each edge's blur; `sums` are `Expectation.line_sums`.

    The variance of line k at abscissa s is 1 / w + (s - c)² / (sum w s² - w c² + prior), with c the mean abscissa.
    The variance of a corner is the sum of both lines' variances over the squared sine of the angle between them.
    """
    w = np.maximum(sums[:, 0], 1.0)
    c = sums[:, 1] / w
    sum_of_squares = np.maximum(sums[:, 2] - w * c**2, 0.0) + 1.0 / FACES.slope_prior**2

    def variance_at(k: Ints, s: Floats) -> Floats:
        return np.asarray(1.0 / w[k] + (s - c[k]) ** 2 / sum_of_squares[k])

    owner = faces.owners
    own_variance = variance_at(owner, faces.edges)
    points = faces.points(owner, faces.edges)
    adjacent = faces.neighbour
    sine = np.abs((faces.normals[owner] * faces.tangents[adjacent]).sum(axis=1))
    adjacent_variance = variance_at(adjacent, (faces.tangents[adjacent] * points).sum(axis=1))
    corner = (own_variance + adjacent_variance) / np.maximum(sine, MIN_SINE) ** 2
    blur = np.sqrt(np.where(adjacent >= 0, corner, faces.blur**2 + own_variance))
    return faces._replace(blur=np.minimum(blur, NEAR))
