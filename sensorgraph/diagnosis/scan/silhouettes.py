"""Where the surface that a ray meets ends for the eye, and what stands behind it there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.ray_intersection import SAME_PLACE, nearest_from_each

BESIDE = 1e-4
"""[rad] beside the end of a surface, where a ray meets what is behind it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouettes:
    """Ends of k surfaces, each between a ray that meets it and one that does not."""

    edge: Floats
    """(k,) [rad] from the right ray to the end."""
    wall: Ints
    """(k,) index of the wall that ends there."""
    behind: Ints
    """(k,) index of the wall that is met just beside it; -1 none."""
    ranges: Floats
    """(k,) [m] there; inf for none."""


def silhouettes(
    walls: Floats,
    origins: tuple[Floats, Floats],
    directions: tuple[Floats, Floats],
    wall: Ints,
    is_right: Bools,
    edge: Floats,
    gap: Floats,
) -> Silhouettes:
    """Follow surfaces from wall to wall to where they end, and cast a ray beside that.

    Parameters
    ----------
    walls : (n_walls, 2, 2) [m]
    origins, directions : x and y (k,) [m] of where the right ray begins, and of its unit direction
    wall : (k,) index of the wall that the ray meets whose surface is followed
    is_right : (k,) it is the right ray; its surface ends to the left
    edge : (k,) [rad] from the right ray to the end of that wall
    gap : (k,) [rad] between the rays
    """
    edge, wall, side = edge.copy(), wall.copy(), np.where(is_right, 1.0, -1.0)
    behind, ranges = np.full(len(wall), -1, dtype=np.intp), np.full(len(wall), np.inf)
    some = np.arange(len(wall))
    while len(some):  # each time a corner further
        ox, oy, ux, uy = (part[some] for part in (*origins, *directions))
        c, s = np.cos(edge[some] + side[some] * BESIDE), np.sin(edge[some] + side[some] * BESIDE)
        ranges[some], behind[some] = (
            found[0]
            for found in nearest_from_each(
                walls, ox[None], oy[None], (c * ux - s * uy)[None], (s * ux + c * uy)[None]
            )
        )
        joined, far_end = _onward(walls, wall[some], behind[some])
        x, y = far_end[:, 0] - ox, far_end[:, 1] - oy
        angle = np.arctan2(ux * y - uy * x, ux * x + uy * y)
        further = joined & (side[some] * (angle - edge[some]) > 0) & (angle > 0) & (angle < gap[some])
        edge[some[further]], wall[some[further]] = angle[further], behind[some[further]]
        some = some[further]
    return Silhouettes(edge=edge, wall=wall, behind=behind, ranges=ranges)


def _onward(walls: Floats, wall: Ints, other: Ints) -> tuple[Bools, Floats]:
    """Tell which pairs of walls (k,) meet in a corner, and return where the other one ends (k, 2) [m]."""
    a, b = walls[wall], walls[np.maximum(other, 0)]  # (k, 2, 2)
    apart = np.abs(a[:, :, None] - b[:, None]).sum(axis=3)  # (k, 2, 2) from each end to each of the other's
    at_end = (apart < SAME_PLACE).any(axis=1)  # (k, 2)
    joined = at_end.any(axis=1) & (other >= 0) & (other != wall)
    return joined, np.where(at_end[:, :1], b[:, 1], b[:, 0])
