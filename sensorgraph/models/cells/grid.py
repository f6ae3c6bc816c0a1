"""Cells of a square grid that is fixed in the map frame, and the traversal of the grid by a ray.

Cell (i, j) covers [i, i + 1) x [j, j + 1) times the cell size in map, whatever the log.
Directions are divided into 16 sectors; sector b is centred on b * 22.5 deg in map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.types import Floats

RowGrid = NDArray[np.int32]
CellIndices = NDArray[np.int64]

N_SECTORS = 16
BORDER_CELLS = 6
"""Width of the margin around the covered cells, so that neighbours within it need no bounds check."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GridWindow:
    """A rectangular part of the grid, with the row of each of its cells."""

    cell: float
    """[m] Side of a cell."""
    low: tuple[int, int]
    """(i, j) of the window's first cell."""
    index: RowGrid
    """(nx, ny) row of each cell; -1 for cells without a row."""

    @classmethod
    def around(cls, xy: Floats, reach: float, cell: float) -> GridWindow:
        """Return an empty window that covers everything within reach [m] of places (n, 2)."""
        low = np.floor((xy.min(axis=0) - reach) / cell).astype(np.int64) - BORDER_CELLS
        high = np.floor((xy.max(axis=0) + reach) / cell).astype(np.int64) + BORDER_CELLS + 1
        shape = high - low
        return cls(cell=cell, low=(int(low[0]), int(low[1])), index=np.full(shape, -1, dtype=np.int32))

    def places(self) -> CellIndices:
        """Return the indices (n_rows, 2) in the window of each row's cell."""
        i, j = np.nonzero(self.index >= 0)
        places = np.empty((len(i), 2), dtype=np.int64)
        places[self.index[i, j]] = np.column_stack([i, j])
        return places


def per_ray(poses: Floats) -> Floats:
    """Return poses (n, n_rays or 1, 3) from poses (n, 3), shared by all rays of a scan, or (n, n_rays, 3)."""
    return poses if poses.ndim == 3 else poses[:, None]


@inner_kernel
def sector_of(c: float, s: float) -> int:
    """Return the sector of direction (c, s)."""
    return round(math.atan2(s, c) / (2 * math.pi / N_SECTORS)) % N_SECTORS


@outer_kernel
def traverse(
    x: float, y: float, c: float, s: float, far: float, cell: float, at: CellIndices, ends: Floats
) -> int:
    """List the cells that a ray crosses (Amanatides & Woo 1987).

    Parameters
    ----------
    x, y : [m] Start of the ray, relative to the corner of the window's first cell.
    c, s : Direction of the ray.
    far : [m] Length of the ray.
    at : (n_max, 2) Filled with the indices in the window of each crossed cell.
    ends : (n_max,) [m] Filled with the distance at which the ray leaves that cell.

    Returns
    -------
    number of cells; the chord in cell k is ends[k] - ends[k - 1]
    """
    i, j = math.floor(x / cell), math.floor(y / cell)
    step_i, step_j = (1 if c > 0 else -1), (1 if s > 0 else -1)
    delta_i = cell / abs(c) if c != 0.0 else math.inf
    delta_j = cell / abs(s) if s != 0.0 else math.inf
    next_i = ((i + (c > 0)) * cell - x) / c if c != 0.0 else math.inf
    next_j = ((j + (s > 0)) * cell - y) / s if s != 0.0 else math.inf
    n = 0
    t = 0.0
    while t < far and n < len(ends):
        at[n, 0], at[n, 1] = i, j
        if next_i < next_j:
            t = next_i
            next_i += delta_i
            i += step_i
        else:
            t = next_j
            next_j += delta_j
            j += step_j
        ends[n] = min(t, far)
        n += 1
    return n


@outer_kernel
def max_cells_met(far: float, cell: float) -> int:
    """Return the maximum number of cells that a ray of length `far` [m] can cross."""
    return int(math.sqrt(2.0) * far / cell) + 4
