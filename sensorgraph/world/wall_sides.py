"""Sides of walls: which parts of a wall border free space, and the direction away from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.arena import Arena
from planners.groups import members
from sensorgraph.types import Bools, Floats, Ints

BESIDE = 1e-3
"""[m] Distance from a drawn wall at which its sides are tested for free space."""
STEP = 0.02
"""[m] Maximum length of the pieces of a wall that are tested."""


def outward(arena: Arena, indices: Ints) -> Floats:
    """Return the unit normals (n, 2) of walls, pointing away from the side of which more is free.

    They point to the right of a wall without a free side, and to the left of one that is as free on both.
    """
    some = WallPieces.of(arena, (BESIDE,), indices)
    left, right = (np.bincount(some.wall, side, len(indices)) for side in (some.left, some.right))
    return np.where(((right >= left) & (right > 0))[:, None], some.normals, -some.normals)


@dataclass(frozen=True, kw_only=True, eq=False)
class WallPieces:
    """Pieces of the walls of an arena, and the free space next to them."""

    wall: Ints
    """(n,) Wall of each piece, of the walls that were cut."""
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
    def of(cls, arena: Arena, beside: Sequence[float], indices: Ints | None = None) -> WallPieces:
        """Cut walls; a side is free if the points at all distances `beside` [m] from its middle are.

        Parameters
        ----------
        indices : (n_walls,) The walls to cut; None: all.
        """
        walls = arena.walls if indices is None else arena.walls[indices]
        ahead = np.diff(walls, axis=1)[:, 0]
        length = np.hypot(*ahead.T)
        normals = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.maximum(length, BESIDE)[:, None]
        counts = np.ceil(length / STEP).astype(np.intp)
        wall, rank = members(counts)
        middle = walls[wall, 0] + ((rank + 0.5) / counts[wall])[:, None] * ahead[wall]
        left, right = (
            np.all([arena.contains(middle + sign * off * normals[wall]) for off in beside], axis=0)
            for sign in (1, -1)
        )
        return cls(wall=wall, rank=rank, count=counts[wall], left=left, right=right, normals=normals)
