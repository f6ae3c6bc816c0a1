"""Removal of redundant faces: short ones whose returns the longer faces beside them explain as well.

Forward selection cannot know yet how far the faces reach that it selects later. In a corner, and between the ends of two
faces, it may therefore select a short face across, which hits within the noise of both seem to need.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sensorgraph.models.faces.change_points import joined_faces, take_faces
from sensorgraph.models.faces.forward_selection import Lines
from sensorgraph.models.faces.ray_march import FaceSet, bucket_grid
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import (
    Rays,
    ReturnNoise,
    binned_faces,
    e_step,
    m_step,
    visible_lines,
)
from sensorgraph.types import Bools, Floats


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
    suspect, reach = _covered(lines, e_step(rays, faces, noise).line_sums, noise)
    if not suspect.any():
        return faces
    others = Lines(normals=lines.normals, offsets=lines.offsets, spans=reach).take(np.flatnonzero(~suspect))
    fewer = binned_faces(others)
    for _ in range(FACES.fit.redundancy_passes):
        fewer = _settled(rays, fewer, noise)
    suspects = np.flatnonzero(suspect)
    loss = _losses(rays, lines.take(suspects), faces, fewer, noise)
    needed = suspects[loss > 0]
    return (
        fewer if len(needed) == 0 else _settled(rays, joined_faces(fewer, take_faces(faces, needed)), noise)
    )


def _settled(rays: Rays, faces: FaceSet, noise: ReturnNoise) -> FaceSet:
    """Return faces with their visibility after one more EM iteration."""
    return m_step(faces, e_step(rays, faces, noise), noise, refit=False)[0]


def _covered(lines: Lines, sums: Floats, noise: ReturnNoise) -> tuple[Bools, Floats]:
    """Return which lines have their hits within the noise of longer ones with more hits, and the spans grown over them.

    The hits of a line are taken as even over its length; both ends and the middle must be covered, each by any
    line that ends at most this length away.
    """
    hits, weight = sums[:, 5], np.maximum(sums[:, 0], 1e-300)
    middle = sums[:, 1] / weight
    half = np.sqrt(3.0 * np.maximum(sums[:, 2] / weight - middle**2, 0.0))
    near = FACES.expectation.fit_sigmas * float(np.hypot(noise.sigma, noise.sigma_xy))
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


def _losses(rays: Rays, lines: Lines, faces: FaceSet, fewer: FaceSet, noise: ReturnNoise) -> Floats:
    """Return the log likelihood (n_lines,) [nats] that the rays which end at each line lose with fewer faces.

    The complexity penalty of a line, as in a split, is subtracted.
    """
    tangents = np.stack([-lines.normals[:, 1], lines.normals[:, 0]], axis=1)
    middles = lines.normals * lines.offsets[:, None] + tangents * lines.spans.mean(axis=1)[:, None]
    radii = np.diff(lines.spans, axis=1)[:, 0] / 2 + FACES.expectation.fit_sigmas * noise.sigma
    returned = np.flatnonzero(np.isfinite(rays.ranges))
    found = cKDTree(middles).query(rays.hits[returned], distance_upper_bound=float(radii.max()))
    far, nearest = np.asarray(found[0]), np.asarray(found[1])
    grids = bucket_grid(faces), bucket_grid(fewer)
    loss = np.zeros(len(lines))
    for k in range(len(lines)):
        own = rays.take(returned[np.flatnonzero((nearest == k) & (far < radii[k]))])
        loss[k] = (
            e_step(own, faces, noise, grids[0]).log_likelihood
            - e_step(own, fewer, noise, grids[1]).log_likelihood
            - FACES.splits.min_gain
            - np.log(max(len(own), 1))
        )
    return loss
