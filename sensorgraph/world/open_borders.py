"""Borders of the free space of an arena without a wall; beyond them nothing is known."""

from __future__ import annotations

import numpy as np
import shapely

from planners.arena import Arena
from sensorgraph.types import Floats

WALL_DISTANCE = 0.12
"""[m] Distance to a wall within which free space ends at that wall. The free space of a sensorgraph consists
of cells of 5 to 10 cm."""
MIN_HOLE = 0.25
"""[m²] Area of an uncrossed region within free space below which rays pass it: no ray happened to cross these
cells."""


def open_borders(arena: Arena) -> Floats:
    """Return the borders (n, 2, 2) [m] of free space without a wall; empty for a map enclosed by walls."""
    rings = [
        np.asarray(ring.coords)[:, :2]
        for part in shapely.get_parts(arena.free)
        for ring in (part.exterior, *(r for r in part.interiors if shapely.Polygon(r).area > MIN_HOLE))
    ]
    edges = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    edges = edges[(edges[:, 0] != edges[:, 1]).any(axis=1)]
    tree = shapely.STRtree(np.asarray(shapely.linestrings(arena.walls)))
    middles = shapely.points(edges.mean(axis=1))
    at_wall, _ = tree.query(middles, predicate="dwithin", distance=WALL_DISTANCE)
    return np.delete(edges, np.unique(at_wall), axis=0)
