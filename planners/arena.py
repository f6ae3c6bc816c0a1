"""Arena: free space and named walls. File formats are in `planners.maps`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from planners.errors import PlanError
from planners.groups import members
from planners.types import Bools, Floats


def wrap(angle: Floats | float) -> Floats:
    """Wrap angles [rad] into (-pi, pi]."""
    return np.pi - (np.pi - np.asarray(angle, dtype=np.float64)) % (2 * np.pi)


@dataclass(frozen=True, kw_only=True, eq=False)
class Arena:
    """Free space of a robot, and the walls that its sensor sees.

    Raises
    ------
    ValueError : The arrays of the walls do not match, or are not finite.
    PlanError : There is no free space.
    """

    free: Polygon | MultiPolygon
    """[m, map] area without walls and obstacles, for a point (not for the robot's footprint)."""
    walls: Floats
    """(n_walls, 2, 2) [m, map] end points of each wall segment, in the order of the file."""
    names: tuple[str, ...]
    """(n_walls,) `FEATURE/edge_i`."""
    surfaces: tuple[str, ...]
    """(n_walls,) surface material of each wall; `wall` unless the file states another."""
    notes: tuple[str, ...] = ()
    """How ambiguous content of the file was interpreted; one line each."""
    is_identified: bool = False
    """Whether the walls were identified from a log, and not drawn or measured."""

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
        """Number of wall segments."""
        return len(self.names)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) [m] of the free space."""
        x0, y0, x1, y1 = self.free.bounds
        return float(x0), float(y0), float(x1), float(y1)

    def contains(self, points: Floats) -> Bools:
        """Return whether each point (..., 2) [m] lies in free space, as bool of shape (...)."""
        points = np.asarray(points, dtype=np.float64)
        return np.asarray(shapely.contains_xy(self.free, points[..., 0], points[..., 1]), dtype=np.bool_)

    def contains_grid(self, x: Floats, y: Floats) -> Bools:
        """Return `contains` of each node of a grid with ascending x (nx,) and y (ny,) [m], as bool (nx, ny).

        Each row of the grid is cut with the edges of the free space; a node is inside if an odd number of cuts lies before
        it (scan conversion; Foley and van Dam 1990). Nodes on an edge are outside.
        """
        ends, ring = shapely.get_coordinates(
            shapely.get_rings(shapely.get_parts(self.free)), return_index=True
        )
        is_edge = ring[1:] == ring[:-1]
        start, end = ends[:-1][is_edge], ends[1:][is_edge]
        low, high = np.minimum(start, end), np.maximum(start, end)
        first, last = np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1], side="right")
        edge, number = members(last - first)
        row = first[edge] + number  # that an edge touches
        rise = end[edge, 1] - start[edge, 1]
        is_level = rise == 0.0
        along = (y[row] - start[edge, 1]) / np.where(is_level, 1.0, rise)
        cut = start[edge, 0] + along * (end[edge, 0] - start[edge, 0])
        cut = np.where(is_level, low[edge, 0], np.clip(cut, low[edge, 0], high[edge, 0]))
        column = np.searchsorted(x, cut)
        counts = y[row] < high[edge, 1]  # a corner belongs to the edge above it
        cuts = np.zeros((len(x) + 1, len(y)), dtype=np.uint8)
        np.add.at(cuts, (column[counts], row[counts]), 1)
        inside = np.asarray(np.bitwise_xor.accumulate(cuts & 1, axis=0)[:-1], dtype=np.bool_)
        touched = np.searchsorted(x, np.where(is_level, high[edge, 0], cut), side="right") - column
        touch, number = members(touched)  # nodes on an edge
        inside[column[touch] + number, row[touch]] = False
        return inside

    def solid_rings(self, pad: float = 0.0) -> tuple[Floats, NDArray[np.int64]]:
        """Return the closed rings around the space that is not free, within the bounds plus `pad` [m].

        Returns
        -------
        Corners (n, 2) [m], the last of a ring equal to its first; and the number (n,) of the ring of each.
        """
        frame = self.free.envelope.buffer(pad, join_style="mitre") if pad else self.free.envelope
        parts = shapely.get_parts(frame.difference(self.free))
        areas = parts[shapely.get_type_id(parts) == shapely.GeometryType.POLYGON]
        corners, ring = shapely.get_coordinates(shapely.get_rings(areas), return_index=True)
        return np.asarray(corners, dtype=np.float64), np.asarray(ring, dtype=np.int64)
