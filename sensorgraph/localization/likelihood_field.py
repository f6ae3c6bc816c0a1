"""LikelihoodField: likelihood of a return on a grid (Thrun, Burgard and Fox 2005, ch. 6.4).

The value of a cell is exp(-d² / (2 sigma²)), where d is the distance from its centre to the nearest surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.groups import members
from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.models.faces.observed_space import MAX_CELLS
from sensorgraph.types import Floats, Ints

REACH = 3.0
"""[sigma] Distance to a surface beyond which a return scores 0."""
PEAK = int(np.iinfo(np.uint8).max)
"""Value of a cell whose centre lies on a surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LikelihoodField:
    """exp(-d² / (2 sigma²)) at the centre of each cell, with distance d to the nearest surface."""

    values: NDArray[np.uint8]
    """(ny, nx) Values from 0, far from all surfaces, to `PEAK`, on a surface; row 0 has the lowest y."""
    origin: Floats
    """(2,) [m, map] Lower left corner of cell (0, 0)."""
    resolution: float
    """[m] Side of a cell."""

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.dtype != np.uint8 or self.origin.shape != (2,):
            raise ValueError(
                f"values has shape {self.values.shape} and type {self.values.dtype}, origin {self.origin.shape}, "
                "expected (ny, nx) uint8 and (2,)"
            )

    def at(self, points: Floats) -> Floats:
        """Return the values (...) from 0 to 1 at points (..., 2) [m, map]; 0 outside the grid."""
        ny, nx = self.values.shape
        cell = np.floor((points - self.origin) / self.resolution).astype(np.intp)
        inside = (cell >= 0).all(axis=-1) & (cell[..., 0] < nx) & (cell[..., 1] < ny)
        x, y = np.where(inside, cell[..., 0], 0), np.where(inside, cell[..., 1], 0)
        return np.where(inside, self.values[y, x] / PEAK, 0.0)


def field_of_points(points: Floats, *, resolution: float = 0.05, sigma: float = 0.07) -> LikelihoodField:
    """Build the field of points on surfaces.

    Parameters
    ----------
    points : (n, 2) [m, map] Finite points.
    resolution : [m] Side of a cell, doubled until the grid has at most `MAX_CELLS`.
    sigma : [m] Scatter of returns around a surface, including the error of its position; at least one cell.

    Raises
    ------
    ValueError : There is no point, or a point is not finite.
    """
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0 or not np.isfinite(points).all():
        raise ValueError(f"points has shape {points.shape}, expected (n, 2), n > 0, all finite")
    extent = np.ptp(points, axis=0)
    while np.prod((extent + 2 * REACH * max(sigma, resolution)) / resolution + 2) > MAX_CELLS:
        resolution *= 2
    sigma = max(sigma, resolution)
    reach = REACH * sigma
    lowest, highest = points.min(axis=0) - reach, points.max(axis=0) + reach
    origin = np.floor(lowest / resolution) * resolution
    nx, ny = (np.floor((highest - origin) / resolution) + 1).astype(int)
    squares = np.full((ny, nx), reach**2)
    _nearest(squares, (points - origin) / resolution, resolution, int(np.ceil(reach / resolution)))
    near = squares < reach**2
    values = np.where(near, np.rint(PEAK * np.exp(squares / (-2 * sigma**2))), 0).astype(np.uint8)
    return LikelihoodField(values=values, origin=origin, resolution=resolution)


def points_on(segments: Floats, spacing: float) -> Floats:
    """Return points (n, 2) on segments (n_segments, 2, 2), both ends included, at most `spacing` [m] apart."""
    return points_with_owners(segments, spacing)[0]


def points_with_owners(segments: Floats, spacing: float) -> tuple[Floats, Ints]:
    """Return `points_on` segments, and the segment of each point (n,)."""
    lengths = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    counts = np.ceil(lengths / spacing).astype(np.intp) + 1
    owner, rank = members(counts)
    share = rank / np.maximum(counts[owner] - 1, 1)
    points: Floats = segments[owner, 0] + share[:, None] * (segments[owner, 1] - segments[owner, 0])
    return points, owner


@outer_kernel
def _nearest(squares: Floats, points: Floats, resolution: float, reach: int) -> None:
    """Lower `squares` (ny, nx) to the squared distance [m²] of each cell centre to the nearest point (n, 2) [cells]."""
    for i in range(len(points)):
        _lower_around(squares, points[i, 0], points[i, 1], resolution, reach)


@inner_kernel
def _lower_around(squares: Floats, x: float, y: float, resolution: float, reach: int) -> None:
    ny, nx = squares.shape
    at_x, at_y = int(x), int(y)
    for row in range(max(at_y - reach, 0), min(at_y + reach + 1, ny)):
        dy = (row + 0.5 - y) * resolution
        for column in range(max(at_x - reach, 0), min(at_x + reach + 1, nx)):
            dx = (column + 0.5 - x) * resolution
            square = dx * dx + dy * dy
            if square < squares[row, column]:
                squares[row, column] = square
