"""Cast rays with individual origins: against all walls, or against the walls of the cells on their way.

A ray o + r u meets the wall a + share d at

    r = (a-o)×d / (u×d),  share = (a-o)×u / (u×d).

It is a hit if 0 <= share <= 1 and r >= 0; walls are longer by a share `CORNER` at both ends.
"""

from __future__ import annotations

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.types import Floats, Ints
from sensorgraph.world.wall_grid import CORNER, grid_of, nearest_in_grid

MAX_UNSORTED_WALLS = 100
"""Number of walls up to which every ray meets every wall; beyond, rays meet the walls of the cells on their
way ..."""
MAX_UNSORTED_PAIRS = 300_000
"""... if the number of ray-wall pairs exceeds this, so that sorting the walls into cells pays off."""


def nearest_walls(walls: Floats, ox: Floats, oy: Floats, ux: Floats, uy: Floats) -> tuple[Floats, Ints]:
    """Return the range and the wall of each ray.

    Parameters
    ----------
    walls : (n_walls, 2, 2) [m]
    ox, oy : (n,) [m] Origins.
    ux, uy : (n,) Unit directions.

    Returns
    -------
    Ranges (n,) [m], inf without a hit, and walls (n,), -1 without a hit. Of several equally near walls the
    first counts.
    """
    ranges, wall = np.full(len(ux), np.inf), np.full(len(ux), -1, np.intp)
    _meet_walls(walls, ox, oy, ux, uy, ranges, wall)
    return ranges, wall


@outer_kernel
def _meet_walls(
    walls: Floats, ox: Floats, oy: Floats, ux: Floats, uy: Floats, ranges: Floats, wall: Ints
) -> None:
    """Enter nearer walls, and their ranges, as of `nearest_walls`."""
    for k in range(len(ux)):
        for at in range(len(walls)):
            dx, dy = walls[at, 1, 0] - walls[at, 0, 0], walls[at, 1, 1] - walls[at, 0, 1]
            ax, ay = walls[at, 0, 0] - ox[k], walls[at, 0, 1] - oy[k]
            across = ux[k] * dy - uy[k] * dx
            share = (ax * uy[k] - ay * ux[k]) / across
            if share >= -CORNER and share <= 1.0 + CORNER:  # false for a parallel ray: inf or nan
                r = (ax * dy - ay * dx) / across
                if r >= 0.0 and r < ranges[k]:
                    ranges[k], wall[k] = r, at


def nearest_after_moves(
    walls: Floats, moved: Ints, ox: Floats, oy: Floats, ux: Floats, uy: Floats, ranges: Floats, wall: Ints
) -> tuple[Floats, Ints]:
    """Return the result of `nearest_from_each`, updated from an earlier cast before some walls moved.

    Parameters
    ----------
    moved : (k,) Indices of the moved walls.
    ranges, wall : Like `ux`, [m] and index of the wall, from the earlier cast.
    """
    shape = ux.shape
    has_moved = np.zeros(len(walls) + 1, dtype=np.bool_)
    has_moved[moved] = True
    new, at = nearest_from_each(walls[moved], ox, oy, ux, uy)
    at = np.append(moved, -1)[at]  # the last one: -1, no hit
    nearer = (new < ranges) | ((new == ranges) & (at >= 0) & (at < wall))
    ranges, wall = np.where(nearer, new, ranges), np.where(nearer, at, wall)
    again = has_moved[wall] & ~nearer
    if again.any():
        x, y = (np.broadcast_to(o, shape)[again][None] for o in (ox, oy))
        ranges[again], wall[again] = (
            a[0] for a in nearest_from_each(walls, x, y, ux[again][None], uy[again][None])
        )
    return ranges, wall


def nearest_from_each(walls: Floats, ox: Floats, oy: Floats, ux: Floats, uy: Floats) -> tuple[Floats, Ints]:
    """Cast rays with individual origins; return ranges [m] and walls (-1: none), shaped like `ux`."""
    x, y = (
        np.broadcast_to(o, ux.shape).flatten() for o in (ox, oy)
    )  # writable copies: a single compiled version
    if len(walls) > MAX_UNSORTED_WALLS and len(walls) * ux.size > MAX_UNSORTED_PAIRS:
        walls = np.ascontiguousarray(walls)
        ranges, wall = nearest_in_grid(walls, grid_of(walls.tobytes()), x, y, ux.ravel(), uy.ravel())
    else:
        ranges, wall = nearest_walls(walls, x, y, ux.ravel(), uy.ravel())
    return ranges.reshape(ux.shape), wall.reshape(ux.shape)
