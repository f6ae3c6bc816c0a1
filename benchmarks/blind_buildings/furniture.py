"""Furniture, as its outline at the height of the laser."""

from __future__ import annotations

import numpy as np
from shapely import affinity
from shapely.geometry import Point, Polygon, box

KINDS = ("desk", "cabinet", "bin", "ldesk", "sofa", "plant")


def piece(kind: str, rng: np.random.Generator) -> Polygon:
    """Return a piece of furniture [m] near the origin."""
    if kind == "desk":
        return box(0, 0, rng.uniform(1.0, 1.6), rng.uniform(0.6, 0.8))
    if kind == "cabinet":
        return box(0, 0, rng.uniform(0.6, 1.2), rng.uniform(0.35, 0.5))
    if kind == "bin":
        return Point(0, 0).buffer(rng.uniform(0.15, 0.25), quad_segs=3)
    if kind == "ldesk":
        a, b = rng.uniform(1.2, 1.7, 2)
        d = rng.uniform(0.5, 0.7)
        return Polygon([(0, 0), (a, 0), (a, d), (d, d), (d, b), (0, b)])
    if kind == "sofa":
        a = rng.uniform(1.3, 1.9)
        back, arm = 0.8, 0.2
        return Polygon(
            [(0, 0), (a, 0), (a, back), (a - arm, back), (a - arm, 0.3), (arm, 0.3), (arm, back), (0, back)]
        )
    return Polygon([(0, 0), (0.5, 0), (0.62, 0.35), (0.25, 0.6), (-0.12, 0.35)])


def rectangle(x: float, y: float, length: float, width: float, yaw: float) -> Polygon:
    """Return a rectangle [m] about (x, y), turned by yaw [rad]."""
    flat = box(-length / 2, -width / 2, length / 2, width / 2)
    turned = affinity.rotate(flat, yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, x, y)
