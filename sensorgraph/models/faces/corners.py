"""Corners: ends of faces that are where two lines meet."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from sensorgraph.models.faces.blurred_edges import MIN_ERROR
from sensorgraph.models.faces.change_points import Crossings
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.settings import FACES
from sensorgraph.types import Floats, Ints

EDGES = FACES.edges


def join_corners(faces: FaceSet, crossings: Crossings) -> FaceSet:
    """Move the ends of faces to where their lines meet, if the crossings there allow it.

    An end known to a few millimetres from its crossings becomes a corner known as well as both lines, and no
    ray slips between the two.
    """
    edges, neighbour, blur = faces.edges.copy(), faces.neighbour.copy(), faces.blur.copy()
    neighbour[:] = -1
    ends, owners = _ends(faces)
    places = faces.normals[owners] * faces.offsets[owners, None] + faces.tangents[owners] * edges[ends, None]
    for e, k, p in zip(ends, owners, places, strict=True):
        best = (EDGES.max_loss, -1, 0.0)
        for other, s in _meetings(faces, k, p):
            cost = _loss(faces, e, k, s, *crossings.at(k))
            cost += 0.5 * ((s - edges[e]) / EDGES.corner_distance) ** 2
            if cost < best[0]:
                best = (cost, other, s)
        if best[1] >= 0:
            edges[e], neighbour[e], blur[e] = best[2], best[1], 0.0
    out = faces._replace(edges=edges, neighbour=neighbour, blur=blur)
    return _in_order(out)


def _ends(faces: FaceSet) -> tuple[Ints, Ints]:
    """List edges where a visible stretch begins or ends, and their faces."""
    owner = np.repeat(np.arange(faces.n_faces), np.diff(faces.first))
    after = faces.levels
    before = np.concatenate([[0.0], faces.levels[:-1]])
    before[faces.first[:-1]] = 0.0
    at = np.flatnonzero(
        (np.minimum(before, after) < EDGES.outside_visibility)
        & (np.maximum(before, after) > EDGES.inside_visibility)
    )
    return at, owner[at]


def _meetings(faces: FaceSet, k: int, p: Floats) -> list[tuple[int, float]]:
    """List the faces whose visible stretch line k meets near its point p, and the abscissa on k."""
    cross = faces.normals @ faces.tangents[k]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = (faces.offsets - faces.normals @ p) / cross  # along t_k from p
    near = np.flatnonzero((np.abs(cross) > EDGES.min_sine) & (np.abs(ahead) < EDGES.corner_distance))
    out = []
    for m in near:
        meet = p + ahead[m] * faces.tangents[k]
        s = float(faces.tangents[m] @ meet)
        a, b = int(faces.first[m]), int(faces.first[m + 1]) - 1
        seen = np.flatnonzero(faces.levels[a:b] > EDGES.inside_visibility) + a
        if (
            len(seen)
            and (
                (faces.edges[seen] - EDGES.corner_distance <= s)
                & (s <= faces.edges[seen + 1] + EDGES.corner_distance)
            ).any()
        ):
            out.append((int(m), float(faces.tangents[k] @ meet)))
    return out


def _loss(
    faces: FaceSet, e: int, k: int, s: float, t: Floats, stop: Floats, weight: Floats, error: Floats
) -> float:
    """Return the nats lost by moving edge e of face k to abscissa s, both blurred as the crossings' places are."""
    old = faces.edges[e]
    margin = EDGES.window_errors * _median_error(t, error, old)
    a, b = np.searchsorted(t, [min(old, s) - margin, max(old, s) + margin])
    after = faces.levels[e]
    before = faces.levels[e - 1] if e > faces.first[k] else 0.0
    y, w, tau = stop[a:b], weight[a:b], np.maximum(error[a:b], MIN_ERROR)
    now, then = (
        np.clip(
            before + (after - before) * ndtr((t[a:b] - place) / tau),
            EDGES.min_visibility,
            1 - EDGES.min_visibility,
        )
        for place in (old, s)
    )
    return float((w * (y * np.log(now / then) + (1 - y) * np.log((1 - now) / (1 - then)))).sum())


def _median_error(t: Floats, error: Floats, place: float) -> float:
    """Return the standard error [m] of crossings next to a place, 0 where there is none."""
    middle = int(np.searchsorted(t, place))
    near = error[max(middle - 10, 0) : middle + 10]
    return float(np.median(near)) if len(near) else 0.0


def _in_order(faces: FaceSet) -> FaceSet:
    """Keep the edges of each face increasing after some were moved."""
    edges = faces.edges.copy()
    for k in range(faces.n_faces):
        part = slice(faces.first[k], faces.first[k + 1])
        edges[part] = np.maximum.accumulate(edges[part])
    return faces._replace(edges=edges)


def with_edge_errors(faces: FaceSet, sums: Floats) -> FaceSet:
    """Add to each edge's blur what the lines it lies on are uncertain by; `sums` are `Expectation.line_sums`.

    A corner is as uncertain as both lines, divided by the sine of the angle between them.
    """
    w = np.maximum(sums[:, 0], 1.0)
    c = sums[:, 1] / w
    sway = np.maximum(sums[:, 2] - w * c**2, 0.0) + 1.0 / FACES.splits.slope_prior**2

    def variance_at(k: Ints, s: Floats) -> Floats:
        return np.asarray(1.0 / w[k] + (s - c[k]) ** 2 / sway[k])

    owner = np.repeat(np.arange(faces.n_faces), np.diff(faces.first))
    own = variance_at(owner, faces.edges)
    points = faces.normals[owner] * faces.offsets[owner, None] + faces.tangents[owner] * faces.edges[:, None]
    beside = faces.neighbour
    sine = np.abs((faces.normals[owner] * faces.tangents[beside]).sum(axis=1))
    there = variance_at(beside, (faces.tangents[beside] * points).sum(axis=1))
    corner = (own + there) / np.maximum(sine, EDGES.min_sine) ** 2
    blur = np.sqrt(np.where(beside >= 0, corner, faces.blur**2 + own))
    return faces._replace(blur=np.minimum(blur, EDGES.max_blur))
