"""Corners of a map, whose position errors move the walls that end there, and their contribution to the normal equations.

It is summed over rays by the wall that each ray meets.

V, B and S are the derivatives of the readings by corner shifts, by the pose of a scan and by the shared unknowns. W holds
the weights and y the residuals.

    cv = Bᵀ W V (for each scan),    gv = Sᵀ W V,    vv = Vᵀ W V,    rv = Vᵀ W y.

A corner shift changes a reading only by its component along the wall's normal n: V = ends nᵀ for each of the two ends.
The sums are compiled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Bools, Floats, Ints

Sums = tuple[Floats, Floats, Floats, Floats]


def corner_sums(
    w: Floats,
    rows: Floats,
    ends: Floats,
    wall: Ints,
    y: Floats,
    normals: Floats,
    corners: Ints,
    count: int,
) -> Sums:
    """Return the weighted products cv, gv, vv, rv of corner shifts with poses, columns, each other and residuals.

    Parameters
    ----------
    w : (n_scans, n_rays) [1/m²] Weights; 0 excludes a ray.
    rows : (n_scans, 3 + k, n_rays) Columns of the pose of each scan, and those that all scans share.
    ends : (2, n_scans, n_rays) Derivative of the reading by a shift of each end of the wall along its normal.
    wall : (n_scans, n_rays) Index of the wall.
    y : (n_scans, n_rays) [m] Residuals.
    normals : (n_walls, 2) Unit normals.
    corners : (n_walls, 2) Index of the corner at each end.
    count : Number of corners; each has two columns, x and y.

    Returns
    -------
    (n_scans, 3, 2 count), (k, 2 count), (2 count, 2 count), (2 count,)
    """
    packed = np.ascontiguousarray(ends)  # the kernel is compiled for this layout
    with_pose, by_wall, square = _by_wall(w, rows, packed, wall, y, normals, corners, count)
    with_column, with_corner = _by_corner(by_wall, square, normals, corners, count)
    return with_pose, with_column[:-1], with_corner, with_column[-1]


@kernel
def _by_corner(
    by_wall: Floats, square: Floats, normals: Floats, corners: Ints, count: int
) -> tuple[Floats, Floats]:
    """Convert products by wall end, along its normal, into products by x and y of each corner.

    Returns those with columns (k + 1, 2 count) and with each other (2 count, 2 count).
    """
    with_column = np.zeros((len(by_wall), 2 * count))
    with_corner = np.zeros((2 * count, 2 * count))
    for at in range(len(normals)):
        for e in range(2):
            for d in range(2):
                column = 2 * corners[at, e] + d
                for j in range(len(by_wall)):
                    with_column[j, column] += by_wall[j, e, at] * normals[at, d]
                for f in range(2):
                    for c in range(2):
                        other = 2 * corners[at, f] + c
                        with_corner[column, other] += square[e, f, at] * normals[at, d] * normals[at, c]
    return with_column, with_corner


@kernel
def _by_wall(
    w: Floats,
    rows: Floats,
    ends: Floats,
    wall: Ints,
    y: Floats,
    normals: Floats,
    corners: Ints,
    count: int,
) -> tuple[Floats, Floats, Floats]:
    """Return the products of corner shifts with poses, and by wall end with columns and each other.

    Shapes: (n_scans, 3, 2 count); (k + 1, 2, n_walls), whose last row is the product with residuals; (2, 2, n_walls).
    """
    n_scans, n_rays = w.shape
    k, n_walls = rows.shape[1] - 3, len(normals)
    with_pose = np.zeros((n_scans, 3, 2 * count))
    by_wall = np.zeros((k + 1, 2, n_walls))
    square = np.zeros((2, 2, n_walls))
    for i in range(n_scans):
        for m in range(n_rays):
            if w[i, m] == 0.0:
                continue
            at = wall[i, m]
            for e in range(2):
                value = w[i, m] * ends[e, i, m]
                for d in range(2):
                    column = 2 * corners[at, e] + d
                    for axis in range(3):
                        with_pose[i, axis, column] += value * normals[at, d] * rows[i, axis, m]
                by_wall[k, e, at] += value * y[i, m]
                square[e, 0, at] += value * ends[0, i, m]
                square[e, 1, at] += value * ends[1, i, m]
        for j in range(k):
            for m in range(n_rays):
                value = w[i, m] * rows[i, 3 + j, m]
                if value != 0.0:
                    by_wall[j, 0, wall[i, m]] += value * ends[0, i, m]
                    by_wall[j, 1, wall[i, m]] += value * ends[1, i, m]
    return with_pose, by_wall, square


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Corners at the ends of each wall."""

    ends: Ints
    """(n_walls, 2) Indices of the corners."""
    count: int
    rest: int = -1
    """Index shared by all fixed corners; -1 if every corner may shift."""

    @classmethod
    def of(cls, walls: Floats, met: Bools | None = None) -> Corners:
        """Merge wall ends that coincide; corners that only end walls which no ray meets, by `met` (n_walls,), are fixed."""
        x, y = np.round(walls.reshape(-1, 2), 6).T
        _, index = np.unique(x + 1j * y, return_inverse=True)
        index = index.reshape(-1, 2)
        count = int(index.max()) + 1 if len(index) else 0
        if met is None:
            return cls(ends=index, count=count)
        is_met = np.zeros(count, dtype=np.bool_)
        is_met[index[met]] = True
        n_met = int(is_met.sum())
        if n_met == count:
            return cls(ends=index, count=count)
        index = np.where(is_met, np.cumsum(is_met) - 1, n_met)[index]
        return cls(ends=index, count=n_met + 1, rest=n_met)
