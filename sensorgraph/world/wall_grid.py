"""Walls sorted into the cells of a grid that rays traverse, for buildings with thousands of walls.

A ray meets the walls of the cells that it crosses, nearest first, and stops in the first cell with a hit
(Amanatides and Woo 1987, a fast voxel traversal algorithm).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planners.groups import members
from planners.kernel import kernel
from planners.types import ROUND_OFF, SAME_PLACE
from sensorgraph.types import Floats, Ints

CELLS_PER_WALL = 2.0
MAX_CELLS = 1_000_000
PAD = SAME_PLACE  # [m] a wall belongs to all cells within this distance, so that no ray passes between two cells
CORNER = ROUND_OFF
"""Share of its length by which a wall is longer at each end, so that no ray passes through a corner."""
FAR = 1e6  # [m] maximum distance of a wall from the origin of the map


@dataclass(frozen=True, kw_only=True, eq=False)
class WallGrid:
    """The walls in each cell of a grid."""

    starts: Ints
    """(nx * ny + 1,) Start of the walls of each cell in `members`; y varies fastest."""
    members: Ints
    """Indices of walls."""
    frame: Floats
    """(3,) [m] x and y of the lower left corner, side of a cell."""
    shape: tuple[int, int]
    """Number of cells along x and y."""

    @staticmethod
    def of(walls: Floats) -> WallGrid:
        """Sort walls (n_walls, 2, 2) [m] into cells; walls without length or far away are omitted."""
        is_wall = (walls[:, 0] != walls[:, 1]).any(axis=1) & (np.abs(walls) < FAR).all(axis=(1, 2))
        kept = np.flatnonzero(is_wall)
        if len(kept) == 0:
            return WallGrid(
                starts=np.zeros(2, np.intp), members=kept, frame=np.array([0, 0, 1.0]), shape=(1, 1)
            )
        low, high = walls[kept].min(axis=(0, 1)) - 2 * PAD, walls[kept].max(axis=(0, 1)) + 2 * PAD
        size = high - low
        cell = float(np.sqrt(size[0] * size[1] / (CELLS_PER_WALL * len(kept))))
        cell = max(cell, float(size.max()) / np.sqrt(MAX_CELLS), 1e-3)
        nx, ny = (int(n) for n in size // cell + 1)
        frame = np.array([*low, cell])
        wall, place = _cells_of(walls, kept, frame, nx, ny)
        order = np.argsort(place, kind="stable")  # stable: walls keep their order in each cell
        starts = np.searchsorted(place[order], np.arange(nx * ny + 1))
        return WallGrid(starts=starts, members=wall[order], frame=frame, shape=(nx, ny))


@lru_cache(maxsize=8)
def grid_of(walls: bytes) -> WallGrid:
    """Return the grid of walls that are equal in many casts, though not the same array, as those of a scene."""
    return WallGrid.of(np.frombuffer(walls).reshape(-1, 2, 2))


def _cells_of(walls: Floats, kept: Ints, frame: Floats, nx: int, ny: int) -> tuple[Ints, Ints]:
    """Return (wall, cell) for every cell that a wall touches, column by column."""
    x0, y0, cell = frame
    a, b = walls[kept, 0], walls[kept, 1]
    left, right = np.minimum(a[:, 0], b[:, 0]) - PAD, np.maximum(a[:, 0], b[:, 0]) + PAD
    first = ((left - x0) / cell).astype(np.intp).clip(0, nx - 1)
    last = ((right - x0) / cell).astype(np.intp).clip(0, nx - 1)
    row, column = _expanded(first, last)
    d = b - a
    steep = np.abs(d[:, 0]) < PAD
    slope = np.where(steep, 0.0, d[:, 1] / np.where(steep, 1.0, d[:, 0]))[row]
    low, high = np.minimum(a[:, 1], b[:, 1])[row], np.maximum(a[:, 1], b[:, 1])[row]
    at = [
        a[row, 1] + slope * (x0 + (column + side) * cell + pad - a[row, 0])
        for side, pad in ((0, -PAD), (1, PAD))
    ]
    bottom = np.where(steep[row], low, np.clip(np.minimum(*at), low, high)) - PAD
    top = np.where(steep[row], high, np.clip(np.maximum(*at), low, high)) + PAD
    first = ((bottom - y0) / cell).astype(np.intp).clip(0, ny - 1)
    last = ((top - y0) / cell).astype(np.intp).clip(0, ny - 1)
    pair, line = _expanded(first, last)
    return kept[row[pair]], column[pair] * ny + line


def _expanded(first: Ints, last: Ints) -> tuple[Ints, Ints]:
    """Return (index, k) for every k from first[index] to last[index]."""
    index, number = members(last - first + 1)
    return index, first[index] + number


def nearest_in_grid(
    walls: Floats, grid: WallGrid, ox: Floats, oy: Floats, ux: Floats, uy: Floats
) -> tuple[Floats, Ints]:
    """Return the result of `nearest_walls`, for walls in a grid.

    Parameters
    ----------
    walls : (n_walls, 2, 2) [m]
    ox, oy : (n,) [m] Origins.
    ux, uy : (n,) Unit directions.
    """
    nx, ny = grid.shape
    cell = grid.frame[2]
    begin, end = np.zeros(len(ux)), np.full(len(ux), np.inf)  # [m] where each ray enters and leaves the grid
    for at, along, size in ((ox - grid.frame[0], ux, nx * cell), (oy - grid.frame[1], uy, ny * cell)):
        with np.errstate(divide="ignore", invalid="ignore"):
            near, far = -at / along, (size - at) / along
        beside = (along == 0.0) & ((at < 0.0) | (at > size))
        within = (along == 0.0) & ~beside
        np.maximum(begin, np.where(within, 0.0, np.minimum(near, far)), out=begin)
        np.minimum(end, np.where(within, np.inf, np.maximum(near, far)), out=end)
        end[beside] = -1.0
    return _march(walls, grid.starts, grid.members, grid.frame, ny, np.stack([ox, oy, ux, uy, begin, end]))


@kernel
def _march(
    walls: Floats, starts: Ints, members: Ints, frame: Floats, ny: int, rays: Floats
) -> tuple[Floats, Ints]:
    """Intersect rays with the walls of the cells on their way.

    Parameters
    ----------
    starts, members, frame : Arrays of the WallGrid.
    ny : Number of cells along y.
    rays : (6, n) [m] Origin, unit direction, and the distances at which the ray enters and leaves the grid.
    """
    nx, cell, n = (len(starts) - 1) // ny, frame[2], rays.shape[1]
    ranges, wall = np.empty(n), np.empty(n, np.intp)
    for k in range(n):
        ox, oy, u, v, begin, end = rays[:, k]
        x, y = ox - frame[0], oy - frame[1]
        ranges[k], wall[k] = np.inf, -1
        i = min(max(int((x + begin * u) / cell), 0), nx - 1) if end >= begin else nx
        j = min(max(int((y + begin * v) / cell), 0), ny - 1) if end >= begin else ny
        ahead, up = 1 if u > 0.0 else 0, 1 if v > 0.0 else 0
        while 0 <= i < nx and 0 <= j < ny:
            for place in range(starts[i * ny + j], starts[i * ny + j + 1]):
                at = members[place]
                dx, dy = walls[at, 1, 0] - walls[at, 0, 0], walls[at, 1, 1] - walls[at, 0, 1]
                ax, ay = walls[at, 0, 0] - ox, walls[at, 0, 1] - oy
                across = u * dy - v * dx
                share = (ax * v - ay * u) / across
                r = (ax * dy - ay * dx) / across
                is_met = -CORNER <= share <= 1.0 + CORNER and r >= 0.0  # false for a parallel ray: inf or nan
                if is_met and (r < ranges[k] or (r == ranges[k] and at < wall[k])):
                    ranges[k], wall[k] = r, at
            next_x = ((i + ahead) * cell - x) / u if u != 0.0 else np.inf
            next_y = ((j + up) * cell - y) / v if v != 0.0 else np.inf
            if min(next_x, next_y) >= min(ranges[k], end):
                break
            if next_x < next_y:
                i += 2 * ahead - 1
            else:
                j += 2 * up - 1
    return ranges, wall
