"""Where a robot can drive: clearance on a grid, and ways through it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.log import Booleans, Floats, Ints
from benchmarks.hidden_effects.worlds.floors.rooms import Room

RESOLUTION = 0.08
"""[m] of the grid."""
MARGIN = 0.2
"""[m] of the grid around the room."""
SLACK = 0.06
"""[m] beyond the robot's radius that ways keep."""
NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ways:
    """Cells that a robot can reach and how they hang together."""

    origin: Floats
    """(2,) [m]"""
    clearances: Floats
    """(nx, ny) [m] to the nearest wall, 0 within walls."""
    rows: list[list[float]]
    """The same as lists, which are faster to look up one by one."""
    cells: Ints
    """(n, 2) that can be reached."""
    graph: sparse.csr_matrix
    """(n, n) [m] from cell to cell, more near walls."""

    def clearance(self, x: float, y: float) -> float:
        """Return the clearance at a place [m]."""
        i, j = int((x - self.origin[0]) / RESOLUTION), int((y - self.origin[1]) / RESOLUTION)
        nx, ny = self.clearances.shape
        return self.rows[i][j] if 0 <= i < nx and 0 <= j < ny else 0.0

    def place(self, cell: int) -> Floats:
        """Return the middle (2,) [m] of a cell."""
        return np.asarray(self.origin + (self.cells[cell] + 0.5) * RESOLUTION)

    def path(self, x: float, y: float, goal: int) -> Floats:
        """Return a way (n, 2) [m] from a place to a cell."""
        off = self.origin + (self.cells + 0.5) * RESOLUTION - (x, y)
        cell = int(np.argmin((off**2).sum(1)))
        _, before = csgraph.dijkstra(  # type: ignore[call-overload]  # a number is an index, too
            self.graph, directed=False, indices=goal, return_predecessors=True
        )
        places = [self.place(cell)]
        while cell != goal and before[cell] >= 0:
            cell = before[cell]
            places.append(self.place(cell))
        path = np.array(places)
        if len(path) > 5:
            smooth = [ndimage.uniform_filter1d(path[:, k], 5, mode="nearest") for k in (0, 1)]
            path = np.column_stack(smooth)
        return path


def survey(room: Room, radius: float) -> Ways:
    """Find where a robot of this radius [m] can drive: the largest connected part."""
    free = room.free()
    shapely.prepare(free)
    x0, y0, x1, y1 = free.bounds
    origin = np.array([x0 - MARGIN, y0 - MARGIN])
    nx, ny = (int((size + 2 * MARGIN) / RESOLUTION) + 1 for size in (x1 - x0, y1 - y0))
    x, y = np.meshgrid(
        origin[0] + (np.arange(nx) + 0.5) * RESOLUTION,
        origin[1] + (np.arange(ny) + 0.5) * RESOLUTION,
        indexing="ij",
    )
    walls = shapely.union_all([free.boundary])
    shapely.prepare(walls)
    clearances = np.where(shapely.contains_xy(free, x, y), shapely.distance(walls, shapely.points(x, y)), 0.0)
    needed = radius + SLACK
    parts, n = ndimage.label(clearances > needed)
    if n == 0:
        raise Redraw("no way")
    reached = parts == np.argmax(np.bincount(parts.ravel())[1:]) + 1
    return Ways(
        origin=origin,
        clearances=clearances,
        rows=clearances.tolist(),
        cells=np.argwhere(reached),
        graph=_graph(reached, clearances, needed),
    )


def _graph(reached: Booleans, clearances: Floats, needed: float) -> sparse.csr_matrix:
    """Return the lengths (n, n) [m] from cell to neighbouring cell; up to 2.5 times as long near walls."""
    cells = np.argwhere(reached)
    index = -np.ones(reached.shape, int)
    index[reached] = np.arange(reached.sum())
    penalty = 1 + 1.5 * np.exp(-(clearances - needed) / 0.15)
    rows, columns, lengths = [], [], []
    nx, ny = reached.shape
    for step in NEIGHBOURS:
        one, other = cells, cells + step
        is_inside = (other[:, 0] < nx) & (other[:, 1] < ny) & (other[:, 1] >= 0)
        one, other = one[is_inside], other[is_inside]
        is_reached = reached[other[:, 0], other[:, 1]]
        one, other = one[is_reached], other[is_reached]
        rows.append(index[one[:, 0], one[:, 1]])
        columns.append(index[other[:, 0], other[:, 1]])
        both = penalty[one[:, 0], one[:, 1]] + penalty[other[:, 0], other[:, 1]]
        lengths.append(math.hypot(*step) * RESOLUTION * both / 2)
    at = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_matrix((np.concatenate(lengths), at), (len(cells), len(cells)))
