"""Arena: the free space and its named walls. File formats live in `planners.maps`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from planners.errors import PlanError
from planners.types import Bools, Floats


def wrap(angle: Floats | float) -> Floats:
    """Wrap angles [rad] into (-pi, pi]."""
    return np.pi - (np.pi - np.asarray(angle, dtype=np.float64)) % (2 * np.pi)


@dataclass(frozen=True, kw_only=True, eq=False)
class Arena:
    """Where a robot may be, and the walls that its sensor sees.

    Raises
    ------
    ValueError : the arrays of the walls do not match, or are not finite
    PlanError : there is no free space
    """

    free: Polygon | MultiPolygon
    """[m, map] space not taken by walls or obstacles (for a point, not for a robot's body)."""
    walls: Floats
    """(n_walls, 2, 2) [m, map] both ends of each wall segment, in the order of the file."""
    names: tuple[str, ...]
    """(n_walls,) `FEATURE/edge_i`."""
    surfaces: tuple[str, ...]
    """(n_walls,) what the wall is made of; `wall` unless the file says otherwise."""
    notes: tuple[str, ...] = ()
    """How the file was understood, where it leaves room for doubt: one line each."""
    is_identified: bool = False
    """Whether the walls were found in a log, which has seen them on its day, and not drawn or measured."""

    def __post_init__(self) -> None:
        n_walls = len(self.names)
        if self.walls.shape != (n_walls, 2, 2) or len(self.surfaces) != n_walls:
            raise ValueError(
                f"walls has shape {self.walls.shape} with {n_walls} names and {len(self.surfaces)} surfaces, "
                f"expected ({n_walls}, 2, 2) and as many surfaces"
            )
        if not np.isfinite(self.walls).all():
            raise ValueError("walls has a coordinate that is not finite")
        if self.free.is_empty:
            raise PlanError("the arena has no free space: obstacles cover all of it")

    def __repr__(self) -> str:
        x0, y0, x1, y1 = self.bounds
        return f"Arena({x1 - x0:g} x {y1 - y0:g} m, {self.n_walls} walls, {self.free.area:.1f} m² free)"

    @property
    def n_walls(self) -> int:
        """Count of wall segments."""
        return len(self.names)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) [m] of the free space."""
        x0, y0, x1, y1 = self.free.bounds
        return float(x0), float(y0), float(x1), float(y1)

    def contains(self, points: Floats) -> Bools:
        """Tell which points (..., 2) [m] lie in free space; returns bool of shape (...)."""
        points = np.asarray(points, dtype=np.float64)
        return np.asarray(shapely.contains_xy(self.free, points[..., 0], points[..., 1]), dtype=np.bool_)
