"""A known map prepared for localization: lines for matching, fields for search and evaluation, ray tests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, kernel
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.branch_and_bound import MaxPyramid, SearchWindow
from sensorgraph.localization.displaced_walls import StraightWalls
from sensorgraph.localization.likelihood_field import (
    LikelihoodField,
    field_of_points,
    points_on,
    points_with_owners,
)
from sensorgraph.localization.line_map import LineMap, line_map
from sensorgraph.localization.settings import KNOWN_MAP
from sensorgraph.models.cells.grid import CellIndices, max_cells_met, traverse
from sensorgraph.models.seen_space import SeenSpace
from sensorgraph.types import Bools, Floats

SPACING = 0.04
"""[m] Spacing of the points on the walls to which scans are matched."""
RESOLUTION = 0.05
"""[m] Cell size of the field in which rays are evaluated; the cells of the global search are twice as large."""
SEARCH_SIGMA = 0.12
"""[m] Scatter of returns around the surfaces of the field of the search."""
WALL = 225.0
"""Value of the fine field above which a cell is a wall."""


EVERYWHERE = SeenSpace(cells=np.zeros((0, 0), dtype=np.bool_), origin=np.zeros(2), resolution=1.0)
"""Observed space of a map that is complete everywhere."""


class MapWalls(NamedTuple):
    """Walls of a map, as `known_map` and `locate_in_map` take them."""

    walls: Floats
    """(n, 2, 2) [m, map] Both ends of each wall."""
    seen: SeenSpace | None = None
    """Observed space; None: everywhere."""
    normals: Floats | None = None
    """(n, 2) Unit normals from each wall to its observed side. None, or 0, 0: both sides match."""
    straight: StraightWalls | None = None
    """Walls of the same place that are more accurate but not complete, for the last match."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayVerdicts:
    """Evaluation of the rays of a view at several poses."""

    likelihoods: Floats
    """(n_poses,) Log likelihood of all rays."""
    hidden: Floats
    """(n_poses,) Share of the returns that walls of the map should have hidden."""
    unseen: Floats
    """(n_poses,) Share of the rays in unobserved space."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownMap:
    """A place in which a robot is to be located."""

    surfaces: LineMap
    """Surfaces for search and tracking."""
    straight: LineMap
    """Surfaces for the last match."""
    pyramid: MaxPyramid
    """Pyramid of a coarse field, for the global search."""
    field: LikelihoodField
    """Fine field, for the likelihood of rays."""
    window: SearchWindow
    """All possible positions of the robot."""
    seen: SeenSpace = EVERYWHERE
    """Observed space."""

    def judge(self, poses: Floats, points: Floats, starts: Floats) -> RayVerdicts:
        """Evaluate a view at several poses by the beam model (Thrun, Burgard and Fox 2005, ch. 6.3).

        The log likelihood of a pose is the sum of log p over the returns. For a return in free space or on a
        surface:

            p = hit · N(d) + unmapped / ray_length.

        For a return behind a wall of the map:

            p = 0.1 · hit · N(d) + (1 - hit - unmapped) / ray_length.

        For a ray that leaves the observed space and meets no wall:

            p = 1 / ray_length.

        Here d is the distance of the return to the nearest surface. N is the normal density with standard
        deviation `ray_sigma`, cut off at three standard deviations.

        Parameters
        ----------
        poses : (n_poses, 3) base_link in map.
        points : (n, 2) [m] Returns in base_link.
        starts : (n, 2) [m] Origins of their rays in base_link.
        """
        out = np.zeros((len(poses), 3))
        s = KNOWN_MAP
        peak = s.hit / (s.ray_sigma * np.sqrt(2 * np.pi))
        shares = np.array([s.unmapped, 1.0 - s.hit - s.unmapped, 1.0]) / s.ray_length
        numbers = np.array([peak, *shares, 5.0 * s.ray_sigma, s.ray_sigma])
        _judge(
            self.field.values,
            self.field.origin,
            self.field.resolution,
            self.seen.cells,
            np.asarray(self.seen.origin, dtype=np.float64),
            self.seen.resolution,
            np.ascontiguousarray(poses, dtype=np.float64),
            np.ascontiguousarray(points),
            np.ascontiguousarray(starts),
            numbers,
            out,
        )
        n = max(len(points), 1)
        return RayVerdicts(likelihoods=out[:, 0], hidden=out[:, 1] / n, unseen=out[:, 2] / n)


def known_map(
    walls: Floats,
    seen: SeenSpace | None = None,
    normals: Floats | None = None,
    straight: StraightWalls | None = None,
) -> KnownMap:
    """Prepare a known map.

    Parameters
    ----------
    walls, seen, normals, straight : As in `MapWalls`. Returns from behind a wall with a normal are not matched to it.

    Raises
    ------
    SensorgraphError : There is no wall.
    """
    if len(walls) == 0:
        raise SensorgraphError("the map has no wall; expected a map with walls")
    points, owner = points_with_owners(walls, SPACING)
    fine = field_of_points(points_on(walls, RESOLUTION / 2), resolution=RESOLUTION, sigma=KNOWN_MAP.ray_sigma)
    coarse = field_of_points(points, resolution=2 * RESOLUTION, sigma=SEARCH_SIGMA)
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    window = SearchWindow(x=(x0 + x1) / 2, y=(y0 + y1) / 2, half_x=(x1 - x0) / 2, half_y=(y1 - y0) / 2)
    surfaces = line_map(points, None if normals is None else normals[owner], facing=0.0)
    last = surfaces
    if straight is not None:
        points, owner = points_with_owners(straight.walls, SPACING)
        last = line_map(points, straight.normals[owner], facing=0.0)
    return KnownMap(
        surfaces=surfaces,
        straight=last,
        pyramid=MaxPyramid(field=coarse),
        field=fine,
        window=window,
        seen=EVERYWHERE if seen is None else seen,
    )


@kernel
def _judge(
    values: NDArray[np.uint8],
    origin: Floats,
    resolution: float,
    seen: Bools,
    seen_origin: Floats,
    seen_resolution: float,
    poses: Floats,
    points: Floats,
    starts: Floats,
    numbers: Floats,
    out: Floats,
) -> None:
    longest = 0.0
    for k in range(len(points)):
        way_x, way_y = points[k, 0] - starts[k, 0], points[k, 1] - starts[k, 1]
        longest = max(longest, np.sqrt(way_x * way_x + way_y * way_y))
    n_cells = max_cells_met(longest, seen_resolution)
    at, ends = np.empty((n_cells, 2), dtype=np.int64), np.empty(n_cells)
    for i in range(len(poses)):
        cos, sin = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        total, hidden, unseen = 0.0, 0.0, 0.0
        for k in range(len(points)):
            x0 = poses[i, 0] + cos * starts[k, 0] - sin * starts[k, 1]
            y0 = poses[i, 1] + sin * starts[k, 0] + cos * starts[k, 1]
            x1 = poses[i, 0] + cos * points[k, 0] - sin * points[k, 1]
            y1 = poses[i, 1] + sin * points[k, 0] + cos * points[k, 1]
            ray = _in_cells(x0, y0, x1, y1, origin, resolution)
            value = _value(values, ray[2], ray[3])
            hit = numbers[0] * value / 255.0
            is_hidden = _is_hidden(values, *ray, numbers[4] / resolution, numbers[5] / resolution)
            if is_hidden:
                hidden += 1.0
                total += np.log(numbers[2] + 0.1 * hit)
                continue
            is_unobserved = (
                value == 0.0
                and seen.shape[0] > 0
                and not _is_ray_seen(seen, *_in_cells(x0, y0, x1, y1, seen_origin, seen_resolution), at, ends)
            )
            if is_unobserved:
                unseen += 1.0
                total += np.log(numbers[3])
            else:
                total += np.log(numbers[1] + hit)
        out[i, 0], out[i, 1], out[i, 2] = total, hidden, unseen


@inner_kernel
def _in_cells(
    x0: float, y0: float, x1: float, y1: float, origin: Floats, resolution: float
) -> tuple[float, float, float, float]:
    """Return both ends of a ray in cell units."""
    return (
        (x0 - origin[0]) / resolution,
        (y0 - origin[1]) / resolution,
        (x1 - origin[0]) / resolution,
        (y1 - origin[1]) / resolution,
    )


@inner_kernel
def _value(values: NDArray[np.uint8], x: float, y: float) -> float:
    ny, nx = values.shape
    if x < 0 or y < 0 or x >= nx or y >= ny:
        return 0.0
    return float(values[int(y), int(x)])


@inner_kernel
def _is_hidden(
    values: NDArray[np.uint8], x0: float, y0: float, x1: float, y1: float, before: float, aside: float
) -> bool:
    """Tell whether a ray, in cell units, crossed a wall, also when displaced by `aside` to its left and right.

    A ray along a wall, or past its end, can meet it through a pose or map error of a few centimetres.
    """
    if not _meets_wall(values, x0, y0, x1, y1, before):
        return False
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    ax, ay = -dy * (aside / length), dx * (aside / length)
    return _meets_wall(values, x0 + ax, y0 + ay, x1 + ax, y1 + ay, before) and _meets_wall(
        values, x0 - ax, y0 - ay, x1 - ax, y1 - ay, before
    )


@inner_kernel
def _meets_wall(values: NDArray[np.uint8], x0: float, y0: float, x1: float, y1: float, before: float) -> bool:
    """Tell whether a ray, in cell units, meets a wall more than `before` ahead of its end."""
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    n = int(length - before)
    k = 2
    while k < n and _value(values, x0 + dx * (k / length), y0 + dy * (k / length)) <= WALL:
        k += 1
    return k < n


@inner_kernel
def _is_ray_seen(
    cells: Bools, x0: float, y0: float, x1: float, y1: float, at: CellIndices, ends: Floats
) -> bool:
    """Tell whether all cells that a ray, in cell units, crosses are observed.

    Parameters
    ----------
    at, ends : (n, 2) and (n,) Space for the cells of the ray.
    """
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    nx, ny = cells.shape
    for k in range(traverse(x0, y0, dx / length, dy / length, length, 1.0, at, ends)):
        i, j = at[k, 0], at[k, 1]
        if i < 0 or j < 0 or i >= nx or j >= ny or not cells[i, j]:
            return False
    return True
