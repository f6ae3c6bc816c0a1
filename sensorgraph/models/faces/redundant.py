"""Removal of redundant faces: short ones whose returns longer ones nearby explain as well.

Forward selection does not know the faces that it selects later. In a corner, and between the ends of two
faces, it may therefore select a short face across, which hits within the noise of both seem to need.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sensorgraph.models.faces.change_points import joined_faces, take_faces
from sensorgraph.models.faces.forward_selection import Lines
from sensorgraph.models.faces.maximisation import m_step
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import (
    FIRST_BIN,
    FIT_SIGMAS,
    Rays,
    ReturnNoise,
    binned_faces,
    e_step,
    visible_lines,
)
from sensorgraph.types import Bools, Floats

PASSES = 2
"""EM iterations of the visibility of faces without redundant ones."""


def without_redundant_faces(rays: Rays, faces: FaceSet, noise: ReturnNoise) -> FaceSet:
    """Remove each face without which the others, grown to its place, lose less than its complexity penalty [nats].

    Parameters
    ----------
    faces : Faces in bins, as the EM leaves them.

    Returns
    -------
    FaceSet in bins, whose visibility is that of the EM.
    """
    lines = visible_lines(faces)
    expectation = e_step(rays, faces, noise)
    suspect, reach = _covered(lines, expectation.line_sums, noise, noise.typical(rays))
    if not suspect.any():
        return faces
    hosts, suspects = np.flatnonzero(~suspect), np.flatnonzero(suspect)
    others = Lines(normals=lines.normals, offsets=lines.offsets, spans=reach).take(hosts)
    fewer = _grown(take_faces(faces, hosts), others)
    for _ in range(PASSES):
        fewer = _settled(rays, fewer, noise)
    without = e_step(rays, fewer, noise)
    loss = _losses(rays, expectation.nats - without.nats, lines.take(suspects), noise)
    fewer, needed = m_step(fewer, without, noise, refit=False)[0], suspects[loss > 0]
    if len(needed) == 0:
        return fewer
    return _settled(rays, joined_faces(fewer, take_faces(faces, needed)), noise)


def _grown(faces: FaceSet, lines: Lines) -> FaceSet:
    """Return faces in bins over the spans of `lines`, with the visibility that they have so far."""
    grown = binned_faces(lines)
    levels, middles = grown.levels.copy(), grown.edges + FIRST_BIN / 2
    for k in range(faces.n_faces):
        old, new = (slice(one.first[k], one.first[k + 1] - 1) for one in (faces, grown))
        at = np.searchsorted(faces.edges[old], middles[new], side="right") - 1
        known = (at >= 0) & (middles[new] < faces.edges[faces.first[k + 1] - 1])
        levels[new] = np.where(known, faces.levels[old][np.maximum(at, 0)], levels[new])
    return grown._replace(levels=levels)


def _settled(rays: Rays, faces: FaceSet, noise: ReturnNoise) -> FaceSet:
    """Return faces with their visibility after one more EM iteration."""
    return m_step(faces, e_step(rays, faces, noise), noise, refit=False)[0]


def _covered(lines: Lines, sums: Floats, noise: ReturnNoise, sigma: float) -> tuple[Bools, Floats]:
    """Return which lines have their hits within the noise of longer ones with more hits, and the spans grown over them.

    The hits of a line are taken as even over its length; both ends and the middle must be covered, each by any
    line that ends at most this length away.
    """
    hits, weight = sums[:, 5], np.maximum(sums[:, 0], 1e-300)
    middle = sums[:, 1] / weight
    half = np.sqrt(3.0 * np.maximum(sums[:, 2] / weight - middle**2, 0.0))
    near = FIT_SIGMAS * float(np.hypot(sigma, noise.sigma_xy))
    tangents = np.stack([-lines.normals[:, 1], lines.normals[:, 0]], axis=1)
    length = 2 * half
    covered, spans = np.zeros(len(lines), dtype=np.bool_), lines.spans.copy()
    for k in np.argsort(-hits, kind="stable"):
        hosts = np.flatnonzero(~covered & (hits > hits[k]) & (length > length[k]))
        along = middle[k] + half[k] * np.array([-1.0, 0.0, 1.0])
        points = lines.normals[k] * lines.offsets[k] + tangents[k] * along[:, None]
        across = points @ lines.normals[hosts].T - lines.offsets[hosts]  # (3, n_hosts)
        t = points @ tangents[hosts].T
        meets = (
            (np.abs(across) < near) & (t > spans[hosts, 0] - length[k]) & (t < spans[hosts, 1] + length[k])
        )
        if not meets.any(axis=1).all():
            continue
        covered[k] = True
        for at, host in enumerate(hosts):
            if meets[:, at].any():
                reached = t[meets[:, at], at]
                spans[host] = min(spans[host, 0], reached.min()), max(spans[host, 1], reached.max())
    return covered, spans


def _losses(rays: Rays, lost: Floats, lines: Lines, noise: ReturnNoise) -> Floats:
    """Return the log likelihood (n_lines,) [nats] that the rays which end at each line lose without the lines.

    The complexity penalty of a line, as in a split, is subtracted.

    Parameters
    ----------
    lost : (n,) [nats] Log likelihood that each ray loses.
    """
    tangents = np.stack([-lines.normals[:, 1], lines.normals[:, 0]], axis=1)
    middles = lines.normals * lines.offsets[:, None] + tangents * lines.spans.mean(axis=1)[:, None]
    radii = np.diff(lines.spans, axis=1)[:, 0] / 2 + FIT_SIGMAS * noise.typical(rays)
    returned = np.flatnonzero(np.isfinite(rays.ranges))
    found = cKDTree(middles).query(rays.hits[returned], distance_upper_bound=float(radii.max()))
    far, nearest = np.asarray(found[0]), np.asarray(found[1])
    near = far < np.append(radii, 0.0)[nearest]  # a ray without a line nearby has the index n_lines
    count = np.bincount(nearest[near], minlength=len(lines))
    loss = np.bincount(nearest[near], weights=lost[returned[near]], minlength=len(lines))
    return np.asarray(loss - FACES.min_split_gain - np.log(np.maximum(count, 1)))
