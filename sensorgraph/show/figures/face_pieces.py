"""Pieces of faces with one value each: the visibility of the piece, or its mean residual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY
from sensorgraph.types import Bools, Floats, Ints

PIECE_LENGTH = 0.10
"""[m] Length along a face over which residuals are averaged."""
MAX_END_DISTANCE = 0.06
"""[m] Maximum distance between a predicted end point and its face."""
SIDE_OFFSET = 0.02
"""[m] Offset towards the visible side, which separates faces that are back to back."""
MIN_RAYS = 5
"""Minimum number of rays for a mean residual."""
MAX_RESIDUAL = 0.2
"""[m] Maximum residual of a ray; a larger residual belongs to another surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FacePieces:
    """Pieces of faces with their values."""

    ends: Floats
    """(n, 2, 2) [m] Start and end of each piece."""
    normals: Floats
    """(n, 2) Unit normals towards the visible side."""
    values: Floats
    """(n,) Values; nan where unknown."""


def visible_pieces(model: Faces) -> FacePieces:
    """Return the visible pieces of all faces, with their visibility as value."""
    owner, edge = visible_edges(model)
    return pieces_of(
        model, owner, model.faces.edges[edge], model.faces.edges[edge + 1], model.faces.levels[edge]
    )


def residual_pieces(model: Faces, ends: Floats, directions: Floats, residual: Floats) -> FacePieces:
    """Average residuals over pieces of `PIECE_LENGTH` along the faces.

    Parameters
    ----------
    ends : (n, 2) [m] Predicted end points of rays.
    directions : (n, 2) Unit vectors of the rays.
    residual : (n,) [m]
    """
    owner, edge = visible_edges(model)
    starts, stops = model.faces.edges[edge], model.faces.edges[edge + 1]
    parts = np.maximum(np.ceil((stops - starts) / PIECE_LENGTH - 1e-9).astype(int), 1)
    first = np.cumsum(parts) - parts
    step = np.arange(parts.sum()) - np.repeat(first, parts)
    size = np.repeat((stops - starts) / parts, parts)
    low = np.repeat(starts, parts) + step * size
    pieces = pieces_of(model, np.repeat(owner, parts), low, low + size, np.full(len(low), np.nan))
    if not len(low) or not len(ends):
        return pieces
    middles = pieces.ends.mean(axis=1) + SIDE_OFFSET * pieces.normals
    off, found = cKDTree(middles).query(
        ends - SIDE_OFFSET * directions, distance_upper_bound=MAX_END_DISTANCE + PIECE_LENGTH / 2
    )
    piece = np.asarray(found, dtype=np.intp)
    return FacePieces(
        ends=pieces.ends,
        normals=pieces.normals,
        values=mean_by_index(piece, residual, np.isfinite(off), len(low)),
    )


def mean_by_index(index: Ints, values: Floats, use: Bools, n: int) -> Floats:
    """Average the values (m,) with `use` for each index 0 ... n - 1; nan for fewer than MIN_RAYS values."""
    count = np.bincount(index[use], minlength=n)
    total = np.bincount(index[use], weights=values[use], minlength=n)
    return np.asarray(np.where(count >= MIN_RAYS, total / np.maximum(count, 1), np.nan))


def visible_edges(model: Faces) -> tuple[Ints, Ints]:
    """Return the face (n,) and the first edge (n,) of every visible piece."""
    owner = model.faces.owners
    edge = np.flatnonzero(model.faces.levels > MIN_VISIBILITY)
    return owner[edge], edge


def pieces_of(model: Faces, owner: Ints, low: Floats, high: Floats, values: Floats) -> FacePieces:
    """Return pieces from `low` to `high` (n,) [m] along the faces `owner` (n,)."""
    ends = np.stack([model.faces.points(owner, s) for s in (low, high)], axis=1)
    return FacePieces(ends=ends, normals=model.faces.normals[owner], values=values)
