"""The surfaces of a known place as localisation takes them: lines to match, a field to search, walls to look through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, kernel
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.branch_and_bound import MaxPyramid, SearchWindow
from sensorgraph.localization.likelihood_field import LikelihoodField, field_of_points, points_on
from sensorgraph.localization.line_map import LineMap, line_map
from sensorgraph.localization.map_settings import KNOWN_MAP, KnownMapSettings
from sensorgraph.types import Floats

WALL = 225.0
"""Value of the fine field from which on a cell is a wall."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownMap:
    """A place in which a robot is to be found."""

    surfaces: LineMap
    pyramid: MaxPyramid
    """Of a coarse field, for the search without a guess."""
    field: LikelihoodField
    """Fine, for the likelihood of rays."""
    window: SearchWindow
    """All places where the robot may be."""

    def judge(
        self, poses: Floats, points: Floats, starts: Floats, settings: KnownMapSettings = KNOWN_MAP
    ) -> tuple[Floats, Floats]:
        """Return log-likelihood and share of hidden returns, (n_poses,) each, by the beam model of Thrun, Burgard and Fox (2005), ch. 6.3.

        A return on a surface is a hit; in free space it is of something that the map lacks; one that a wall should have
        hidden is very unlikely.

        Parameters
        ----------
        poses : (n_poses, 3) base_link in map
        points : (n, 2) [m] returns in base_link
        starts : (n, 2) [m] where their rays begin in base_link
        """
        out = np.zeros((len(poses), 2))
        s = settings
        peak = s.hit / (s.ray_sigma * np.sqrt(2 * np.pi))
        numbers = np.array([peak, s.unmapped / s.ray_length, s.through_wall / s.ray_length, s.before_wall])
        _judge(
            self.field.values,
            self.field.origin,
            self.field.resolution,
            np.ascontiguousarray(poses, dtype=np.float64),
            np.ascontiguousarray(points),
            np.ascontiguousarray(starts),
            numbers,
            out,
        )
        return out[:, 0], out[:, 1] / max(len(points), 1)


def known_map(walls: Floats, settings: KnownMapSettings = KNOWN_MAP) -> KnownMap:
    """Prepare the walls (n, 2, 2) [m, map] of a place, both ends of each.

    Raises
    ------
    SensorgraphError : there is no wall
    """
    if len(walls) == 0:
        raise SensorgraphError("the map has no wall to find a robot by; give one with walls")
    points = points_on(walls, settings.spacing)
    fine = field_of_points(
        points_on(walls, settings.resolution / 2),
        resolution=settings.resolution,
        sigma=settings.ray_sigma,
    )
    coarse = field_of_points(points, resolution=settings.search_resolution, sigma=settings.search_sigma)
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    window = SearchWindow(x=(x0 + x1) / 2, y=(y0 + y1) / 2, half_x=(x1 - x0) / 2, half_y=(y1 - y0) / 2)
    return KnownMap(surfaces=line_map(points), pyramid=MaxPyramid(field=coarse), field=fine, window=window)


@kernel
def _judge(
    values: NDArray[np.uint8],
    origin: Floats,
    resolution: float,
    poses: Floats,
    points: Floats,
    starts: Floats,
    numbers: Floats,
    out: Floats,
) -> None:
    for i in range(len(poses)):
        cos, sin = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        total, hidden = 0.0, 0.0
        for k in range(len(points)):
            x0 = poses[i, 0] + cos * starts[k, 0] - sin * starts[k, 1] - origin[0]
            y0 = poses[i, 1] + sin * starts[k, 0] + cos * starts[k, 1] - origin[1]
            x1 = poses[i, 0] + cos * points[k, 0] - sin * points[k, 1] - origin[0]
            y1 = poses[i, 1] + sin * points[k, 0] + cos * points[k, 1] - origin[1]
            hit = numbers[0] * _value(values, x1 / resolution, y1 / resolution) / 255.0
            is_hidden = _meets_wall(
                values,
                x0 / resolution,
                y0 / resolution,
                x1 / resolution,
                y1 / resolution,
                numbers[3] / resolution,
            )
            total += np.log(numbers[2] + 0.1 * hit if is_hidden else numbers[1] + hit)
            hidden += 1.0 if is_hidden else 0.0
        out[i, 0], out[i, 1] = total, hidden


@inner_kernel
def _value(values: NDArray[np.uint8], x: float, y: float) -> float:
    ny, nx = values.shape
    if x < 0 or y < 0 or x >= nx or y >= ny:
        return 0.0
    return float(values[int(y), int(x)])


@inner_kernel
def _meets_wall(values: NDArray[np.uint8], x0: float, y0: float, x1: float, y1: float, before: float) -> bool:
    """Tell whether a ray, all in cells, meets a wall more than `before` before its end."""
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    n = int(length - before)
    k = 2
    while k < n and _value(values, x0 + dx * (k / length), y0 + dy * (k / length)) <= WALL:
        k += 1
    return k < n
