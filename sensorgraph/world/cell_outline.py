"""Outline of the set cells of a raster as polygons, with a cost that depends on its edges rather than its cells."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import MultiPolygon

from sensorgraph.types import Bools, Floats


def outline(cells: Bools, origin: Floats, cell: float) -> MultiPolygon:
    """Return the union of the set cells.

    Parameters
    ----------
    cells : (n, m) Along x, along y.
    origin : (2,) [m] Lower left corner of the first cell.
    cell : [m] Side of a cell.
    """
    edges = origin + cell * _straight_edges(cells)
    lines = np.atleast_1d(np.asarray(shapely.linestrings(edges), dtype=np.object_))
    faces = shapely.get_parts(shapely.polygonize(lines))
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    i, j = np.floor((inside - origin) / cell).astype(np.intp).T
    return MultiPolygon(list(faces[cells[i, j]]))


def widened_outline(cells: Bools, origin: Floats, cell: float) -> MultiPolygon:
    """Return the union of the set cells, widened by half a cell on every side: a mitred buffer, computed in the raster.

    Gaps of one cell close. Parameters are those of `outline`.
    """
    n, m = cells.shape
    wide = np.zeros((2 * n + 2, 2 * m + 2), dtype=np.bool_)
    for i in range(4):
        for j in range(4):
            wide[i : i + 2 * n : 2, j : j + 2 * m : 2] |= cells
    return outline(wide, origin - cell / 2, cell / 2)


def _straight_edges(cells: Bools) -> Floats:
    """Return the boundary as straight segments (k, 2, 2) [cells] that end wherever another one may start."""
    padded = np.pad(cells, 1)
    upright = padded[1:, 1:-1] != padded[:-1, 1:-1]  # (n + 1, m)
    level = (padded[1:-1, 1:] != padded[1:-1, :-1]).T  # (m + 1, n)
    touched = [
        np.pad(edges, ((0, 0), (1, 0))) | np.pad(edges, ((0, 0), (0, 1))) for edges in (upright, level)
    ]
    corner = touched[0] & touched[1].T
    first, last = _pieces(upright, corner)
    x_first, x_last = _pieces(level, corner.T)
    return np.concatenate([np.stack([first, last], axis=1), np.stack([x_first, x_last], axis=1)[..., ::-1]])


def _pieces(edges: Bools, corner: Bools) -> tuple[Floats, Floats]:
    """Join edges (n, m) along the second axis up to the corners (n, m + 1); return first and last nodes (k, 2)."""
    before = np.pad(edges, ((0, 0), (1, 0)))[:, :-1]
    after = np.pad(edges, ((0, 0), (0, 1)))[:, 1:]
    first = np.argwhere(edges & (corner[:, :-1] | ~before))
    last = np.argwhere(edges & (corner[:, 1:] | ~after)) + [0, 1]
    return first.astype(np.float64), last.astype(np.float64)
