"""The accuracy of a careful set-up, and how much of an effect's parameters it hides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.world.robot import Tolerances


@dataclass(frozen=True, kw_only=True)
class SetUp:
    """Tolerances of a robot in its arena, and the resolution of its sensor."""

    tolerances: Tolerances
    median_range: float
    """[m] of the returns of the run."""
    ray_spacing: float
    """[rad] between neighbouring rays."""
    wall_length: float
    """[m] median over the walls of the map; inf where there are none."""
    range_bias: float
    """[m] standard deviation of a bias of the laser that is no effect."""
    strays: float
    """Standard deviation of a share of strays that is none, which is as likely anywhere up to its limit."""


def map_error(set_up: SetUp) -> float:
    """Return the error [m] of one wall of the map."""
    return set_up.tolerances.map


def half_map_error(set_up: SetUp) -> float:
    """Return the error [m] of what is measured against several walls of the map."""
    return set_up.tolerances.map / 2


def third_of_map_error(set_up: SetUp) -> float:
    """Return the error [m] of what is measured along a whole wall of the map."""
    return set_up.tolerances.map / 3


def wall_direction_error(set_up: SetUp) -> float:
    """Return the error [rad] of the direction of a wall of median length."""
    return set_up.tolerances.map / set_up.wall_length


def end_of_part_error(set_up: SetUp) -> float:
    """Return the error [m] of where a part of a wall ends: single rays tell."""
    t = set_up.tolerances
    return float(np.hypot(t.map, t.pose_xy + t.pose_yaw * set_up.median_range))


def depth_edge_error(set_up: SetUp) -> float:
    """Return the error [rad] of where a few edges in depth stand, each off by the map's tolerance."""
    return 0.5 * set_up.tolerances.map / max(set_up.median_range, 0.1)


def between_rays(set_up: SetUp) -> float:
    """Return the error [rad] of a bearing that falls anywhere between two rays: uniform over their spacing."""
    return float(set_up.ray_spacing / np.sqrt(12))


def range_bias(set_up: SetUp) -> float:
    """Return the error [m] of a range that is told by readings alone."""
    return set_up.range_bias


def share_of_strays(set_up: SetUp) -> float:
    """Return the error of a share of readings that may be the strays that every laser has."""
    return set_up.strays
