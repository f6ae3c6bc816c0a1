"""Where a ray stops: the share of poses at which each visible stretch stops it, over the observed free space."""

from __future__ import annotations

import numpy as np

from planners.arena import wrap
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY, FaceSet
from sensorgraph.types import Floats

N_POSES = 4096
"""Number of poses for the shares of poses in printed equations; each is known to 0.5 % or better."""
GOLDEN = (np.sqrt(5.0) - 1.0) / 2
"""Share of a turn between the headings of successive poses, which spreads them evenly."""


def stop_shares(
    faces: FaceSet, observed: ObservedSpace, start: Floats, bearing: float, range_max: float
) -> Floats:
    """Return the share (n_edges,) of poses at which the stretch after each edge stops a ray.

    The poses are spread evenly over the observed free space and all headings; the ray starts in this space.

    Parameters
    ----------
    start : (3,) [m, m, rad] Start of the ray in the frame of the poses.
    bearing : [rad] Bearing of the ray in the frame of `start`.
    """
    origins, headings = _poses(observed, start)
    directions = np.column_stack([np.cos(headings + bearing), np.sin(headings + bearing)])
    pose, rho, stretch = [], [], []
    for k in range(faces.n_faces):
        normal, part = faces.normals[k], slice(faces.first[k], faces.first[k + 1])
        den, above = directions @ normal, faces.offsets[k] - origins @ normal
        meets = np.flatnonzero((den < 0) & (above < 0) & (above > range_max * den))
        r = above[meets] / den[meets]
        hits = origins[meets] + r[:, None] * directions[meets]
        at = np.searchsorted(faces.edges[part], hits @ np.array([-normal[1], normal[0]]), side="right") - 1
        seen = (at >= 0) & (faces.levels[part][np.maximum(at, 0)] > MIN_VISIBILITY)
        pose.append(meets[seen])
        rho.append(r[seen])
        stretch.append(at[seen] + faces.first[k])
    shares = np.zeros(len(faces.edges))
    if not pose or len(origins) == 0:
        return shares
    order = np.lexsort((np.concatenate(rho), np.concatenate(pose)))  # each ray's crossings, nearest first
    ray, j = np.concatenate(pose)[order], np.concatenate(stretch)[order]
    chance = np.minimum(faces.levels[j], 1 - 1e-12)
    passed = np.cumsum(np.log1p(-chance)) - np.log1p(-chance)
    begins = np.searchsorted(ray, ray)
    np.add.at(shares, j, chance * np.exp(passed - passed[begins]))
    return np.asarray(shares / len(origins))


def _poses(observed: ObservedSpace, start: Floats) -> tuple[Floats, Floats]:
    """Return starts (n, 2) [m] of a ray in free cells, and the headings (n,) [rad] of the ray's frame."""
    i, j = np.nonzero(
        observed.free & (observed.distance_to_unobserved > 1)
    )  # noise reaches one cell into walls
    turns = max(1, N_POSES // max(len(i), 1))
    take = np.unique(np.linspace(0, max(len(i) - 1, 0), min(len(i), N_POSES)).astype(np.intp))
    cells = np.repeat(np.column_stack([i[take], j[take]]), turns, axis=0)
    heading = wrap(2 * np.pi * GOLDEN * np.arange(len(cells)))
    cos, sin = np.cos(heading), np.sin(heading)
    place = observed.origin + (cells + 0.5) * observed.cell
    origins = place + np.column_stack([cos * start[0] - sin * start[1], sin * start[0] + cos * start[1]])
    cell = np.floor((origins - observed.origin) / observed.cell).astype(np.intp)
    inside = ((cell >= 0) & (cell < observed.free.shape)).all(axis=1)
    inside[inside] = observed.free[tuple(cell[inside].T)]
    return origins[inside], heading[inside] + start[2]
