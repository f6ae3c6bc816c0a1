"""Walls of an arena that a laser can see, with their free sides, and straight walls of an occupancy-grid map."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from sensorgraph.localization.displaced_walls import StraightWalls, straight_walls_of_grid
from sensorgraph.types import Floats
from sensorgraph.world.pixel_walls import grid_axes, is_raster, pixel_of, straightened
from sensorgraph.world.wall_sides import BESIDE, WallPieces

NARROW = 0.05
"""[m] Width of gaps, as between two drawn walls, into which no ray is expected to pass."""


def drawn_walls(arena: Arena) -> tuple[Floats, Floats]:
    """Return the parts of the walls (n, 2, 2) [m, map] that border free space, and their normals (n, 2) towards it.

    A normal is 0, 0 where both sides are free. Parts without a free side are left out, such as the back of a wall at
    the outline, or what another wall covers: no ray meets them.
    """
    some = WallPieces.of(arena, (BESIDE, NARROW))
    side = some.left + 2 * some.right
    first = np.flatnonzero(np.diff(some.wall, prepend=-1) | np.diff(side, prepend=-1))
    last = np.append(first[1:], len(side)) - 1
    is_bordering = side[first] > 0
    first, last = first[is_bordering], last[is_bordering]
    wall = some.wall[first]
    ends = np.stack([some.rank[first], some.rank[last] + 1], axis=1) / some.count[first][:, None]
    ahead = np.diff(arena.walls, axis=1)
    facing = some.left[first].astype(np.float64) - some.right[first]
    return arena.walls[wall, :1] + ends[:, :, None] * ahead[wall], facing[:, None] * some.normals[wall]


def straight_walls(arena: Arena) -> StraightWalls | None:
    """Return the straight walls of an occupancy-grid map with their normals, and how far each can be displaced.

    None for a drawn arena, and where no cells are straight. Free space begins half a cell before a straight wall, and
    within a cell of every wall; the borders of its cells are no straight line.
    """
    if not is_raster(arena):
        return None
    straight, _ = straightened(arena)
    if not straight.n_walls:
        return None
    some = WallPieces.of(straight, (pixel_of(arena),))
    left, right = (np.bincount(some.wall, side, straight.n_walls) > 0 for side in (some.left, some.right))
    normals = (left.astype(np.float64) - right)[:, None] * some.normals
    return straight_walls_of_grid(straight.walls, normals, grid_axes(arena)[0], pixel_of(arena))
