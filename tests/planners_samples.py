"""Arenas that several planner tests share."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import shapely

from planners.arena import Arena
from planners.maps import geojson


def shipped(name: str) -> Arena:
    """Read a shipped arena."""
    return geojson.loads((files("sensorgraph.data") / f"{name}.geojson").read_text())


def outlined(free: shapely.Polygon | shapely.MultiPolygon) -> Arena:
    """Make every border of free space a wall."""
    lines = shapely.get_parts(shapely.boundary(free))
    rings = [np.asarray(line.coords) for line in lines]
    walls = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    names = tuple(f"w/edge_{i}" for i in range(len(walls)))
    return Arena(free=free, walls=walls, names=names, surfaces=("wall",) * len(walls))


def door_arena(width: float) -> Arena:
    """Two rooms of 2 x 3 m behind a wall of 10 cm at x = 2 with a door in its middle; 0: closed, 9: no wall."""
    free = shapely.box(0, 0, 4, 3)
    if width < 3:
        free = free.difference(shapely.box(1.95, 0, 2.05, 1.5 - width / 2))
        free = free.difference(shapely.box(1.95, 1.5 + width / 2, 2.05, 3))
    return outlined(free)


def random_arena(rng: np.random.Generator) -> Arena:
    """A 4 x 3.5 m room with up to four convex obstacles."""
    free = shapely.box(0, 0, 4, 3.5)
    for _ in range(int(rng.integers(0, 5))):
        corners = rng.uniform(0.5, 3.2, 2) + rng.uniform(-0.4, 0.4, (6, 2))
        free = free.difference(shapely.convex_hull(shapely.multipoints(corners)))
    return outlined(free)
