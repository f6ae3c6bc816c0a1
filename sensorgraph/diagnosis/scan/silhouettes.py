"""Find the visible ends of surfaces that rays meet, and the surfaces behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.ray_intersection import SAME_PLACE, nearest_from_each

BESIDE = 1e-4
"""[rad] Angle beyond the end of a surface at which a ray meets the surface behind it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouettes:
    """Ends of k surfaces, each between a ray that meets the surface and one that does not."""

    edge: Floats
    """(k,) [rad] Angle from the right ray to the end."""
    wall: Ints
    """(k,) Index of the wall that ends there."""
    behind: Ints
    """(k,) Index of the wall just beyond the end, -1 for none."""
    ranges: Floats
    """(k,) [m] Range of that wall; inf for none."""


def silhouettes(
    walls: Floats,
    origins: tuple[Floats, Floats],
    directions: tuple[Floats, Floats],
    wall: Ints,
    is_right: Bools,
    edge: Floats,
    gap: Floats,
) -> Silhouettes:
    """Follow surfaces from wall to wall to their ends, and cast a ray just beyond each end.

    Parameters
    ----------
    walls : (n_walls, 2, 2) [m]
    origins, directions : x and y (k,) [m] of the origin of the right ray, and of its unit direction
    wall : (k,) index of the wall met by the ray whose surface is followed
    is_right : (k,) whether that ray is the right one, so that its surface ends to the left
    edge : (k,) [rad] angle from the right ray to the end of that wall
    gap : (k,) [rad] angle between the rays
    """
    edge, wall, side = edge.copy(), wall.copy(), np.where(is_right, 1.0, -1.0)
    behind, ranges = np.full(len(wall), -1, dtype=np.intp), np.full(len(wall), np.inf)
    some = np.arange(len(wall))
    while len(some):  # one more corner per iteration
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
    """Return which pairs of walls (k,) meet in a corner, and the far end (k, 2) [m] of the other wall."""
    a, b = walls[wall], walls[np.maximum(other, 0)]  # (k, 2, 2)
    apart = np.abs(a[:, :, None] - b[:, None]).sum(axis=3)  # (k, 2, 2) from each end to each of the other's
    at_end = (apart < SAME_PLACE).any(axis=1)  # (k, 2)
    joined = at_end.any(axis=1) & (other >= 0) & (other != wall)
    return joined, np.where(at_end[:, :1], b[:, 1], b[:, 0])
