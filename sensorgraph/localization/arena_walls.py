"""Free sides of the walls of an arena, and straight walls of an occupancy-grid map."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from planners.groups import members
from sensorgraph.types import Floats
from sensorgraph.world.pixel_walls import is_raster, pixel_of, straightened

BESIDE = 1e-3
"""[m] Distance from a drawn wall at which its sides are tested for free space."""
STEP = 0.1
"""[m] Distance between the tested points of a wall: a narrower gap next to it shows no ray of it."""


def free_sides(arena: Arena, beside: float = BESIDE) -> Floats:
    """Return the unit normals (n_walls, 2) of the walls towards free space; 0, 0 where both sides or none are free.

    A side is free where a point next to the wall is free: another wall may cover a part of it.

    Parameters
    ----------
    beside : [m] Distance from a wall at which its sides are tested.
    """
    ahead = np.diff(arena.walls, axis=1)[:, 0]
    normals = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.maximum(np.hypot(*ahead.T), BESIDE)[:, None]
    n_pieces = np.ceil(np.hypot(*ahead.T) / STEP).astype(
        np.intp
    )  # tested in their middles: corners have other sides
    wall, piece = members(n_pieces)
    points = arena.walls[wall, 0] + ((piece + 0.5) / n_pieces[wall])[:, None] * ahead[wall]
    left, right = (
        np.bincount(wall, arena.contains(points + sign * beside * normals[wall]), arena.n_walls) > 0
        for sign in (1.0, -1.0)
    )
    return np.asarray((left.astype(np.float64) - right)[:, None] * normals)


def straight_walls(arena: Arena) -> tuple[Floats, Floats] | None:
    """Return the straight walls (n, 2, 2) [m, map] of an occupancy-grid map with their normals (n, 2); None for a
    drawn arena, and where no cells are straight.

    Free space begins half a cell before a straight wall, and within a cell of every wall.
    """
    if not is_raster(arena):
        return None
    straight, _ = straightened(arena)
    return (straight.walls, free_sides(straight, pixel_of(arena))) if straight.n_walls else None
