"""The accuracy of a careful setup, and the errors of effect parameters that follow from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.world.robot import Tolerances


@dataclass(frozen=True, kw_only=True)
class SetUp:
    """Tolerances of a robot in its arena, and the resolution of its sensor."""

    tolerances: Tolerances
    median_range: float
    """[m] Median of the returns of the run."""
    ray_spacing: float
    """[rad] Angle between neighbouring rays."""
    wall_length: float
    """[m] Median length of the walls of the map; inf without walls."""
    range_bias: float
    """[m] Standard deviation of the laser's bias without an effect."""
    strays: float
    """Standard deviation of the share of outliers without an effect, uniform up to its limit."""


def map_error(set_up: SetUp) -> float:
    """Return the error [m] of one wall of the map."""
    return set_up.tolerances.map


def half_map_error(set_up: SetUp) -> float:
    """Return the error [m] of a quantity measured against several walls of the map."""
    return set_up.tolerances.map / 2


def third_of_map_error(set_up: SetUp) -> float:
    """Return the error [m] of a quantity measured along a whole wall of the map."""
    return set_up.tolerances.map / 3


def wall_direction_error(set_up: SetUp) -> float:
    """Return the error [rad] of the direction of a wall of median length."""
    return set_up.tolerances.map / set_up.wall_length


def end_of_part_error(set_up: SetUp) -> float:
    """Return the error [m] of the end of a part of a wall, which depends on single rays."""
    t = set_up.tolerances
    return float(np.hypot(t.map, t.pose_xy + t.pose_yaw * set_up.median_range))


def depth_edge_error(set_up: SetUp) -> float:
    """Return the error [rad] of the place of a few depth edges, each with the tolerance of the map."""
    return 0.5 * set_up.tolerances.map / max(set_up.median_range, 0.1)


def between_rays(set_up: SetUp) -> float:
    """Return the error [rad] of a bearing between two rays, uniform over their spacing."""
    return float(set_up.ray_spacing / np.sqrt(12))


def range_bias(set_up: SetUp) -> float:
    """Return the error [m] of a range that is estimated from readings alone."""
    return set_up.range_bias


def share_of_strays(set_up: SetUp) -> float:
    """Return the error of a share of outliers, which each laser has."""
    return set_up.strays
