"""Walls of an arena that a laser can see, with their free sides, and straight walls of an occupancy-grid map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.arena import Arena
from planners.groups import members
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.pixel_walls import is_raster, pixel_of, straightened

BESIDE = 1e-3
"""[m] Distance from a drawn wall at which its sides are tested for free space."""
NARROW = 0.05
"""[m] Width of gaps, as between two drawn walls, into which no ray is expected to pass."""
STEP = 0.02
"""[m] Maximum length of the pieces of a wall that are tested."""


def drawn_walls(arena: Arena) -> tuple[Floats, Floats]:
    """Return the parts of the walls (n, 2, 2) [m, map] that border free space, and their normals (n, 2) towards it.

    A normal is 0, 0 where both sides are free. Parts without a free side are left out, such as the back of a wall at
    the outline, or what another wall covers: no ray meets them.
    """
    some = _Pieces.of(arena, (BESIDE, NARROW))
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


def straight_walls(arena: Arena) -> tuple[Floats, Floats] | None:
    """Return the straight walls (n, 2, 2) [m, map] of an occupancy-grid map with their normals (n, 2).

    None for a drawn arena, and where no cells are straight. Free space begins half a cell before a straight wall, and
    within a cell of every wall; the borders of its cells are no straight line.
    """
    if not is_raster(arena):
        return None
    straight, _ = straightened(arena)
    if not straight.n_walls:
        return None
    some = _Pieces.of(straight, (pixel_of(arena),))
    left, right = (np.bincount(some.wall, side, straight.n_walls) > 0 for side in (some.left, some.right))
    return straight.walls, (left.astype(np.float64) - right)[:, None] * some.normals


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pieces:
    """Pieces of the walls of an arena, and the free space next to them."""

    wall: Ints
    """(n,) Wall of each piece."""
    rank: Ints
    """(n,) Number of the piece in its wall."""
    count: Ints
    """(n,) Number of pieces of its wall."""
    left: Bools
    """(n,) The side of the normal is free."""
    right: Bools
    """(n,) The other side is free."""
    normals: Floats
    """(n_walls, 2) Unit normals of the walls."""

    @classmethod
    def of(cls, arena: Arena, beside: Sequence[float]) -> _Pieces:
        """Cut the walls; a side is free if the points at all distances `beside` [m] from its middle are."""
        ahead = np.diff(arena.walls, axis=1)[:, 0]
        length = np.hypot(*ahead.T)
        normals = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.maximum(length, BESIDE)[:, None]
        counts = np.ceil(length / STEP).astype(np.intp)
        wall, rank = members(counts)
        middle = arena.walls[wall, 0] + ((rank + 0.5) / counts[wall])[:, None] * ahead[wall]
        left, right = (
            np.all([arena.contains(middle + sign * off * normals[wall]) for off in beside], axis=0)
            for sign in (1, -1)
        )
        return cls(wall=wall, rank=rank, count=counts[wall], left=left, right=right, normals=normals)
