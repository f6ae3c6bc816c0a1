"""Where the free space of an arena ends though no wall stands there: beyond, nothing is known."""

from __future__ import annotations

import numpy as np
import shapely

from planners.arena import Arena
from sensorgraph.types import Floats

WALL_DISTANCE = 0.12
"""[m] from a wall within which free space ends at that wall; a graph's free space is of cells of 5 to 10 cm."""
MIN_HOLE = 0.25
"""[m²] of what was never crossed amid free space, below which rays pass: no ray happened to cross those cells."""


def open_borders(arena: Arena) -> Floats:
    """Return where free space ends though no wall stands there, (n, 2, 2) [m]; none in a map that walls enclose."""
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
