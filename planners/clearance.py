"""Exact distances to the barriers of the robot: walls, and borders of free space without a wall."""

from __future__ import annotations

import numpy as np
import shapely

from planners.arena import Arena
from planners.groups import members
from planners.types import Bools, Floats

MAX_SEGMENT = 4.0
"""[m] Longer walls are cut, so that their boxes in the search tree do not overlap everywhere."""


class Barriers:
    """Segments that the robot's centre must keep clear of, with exact vectorised queries."""

    def __init__(self, arena: Arena) -> None:
        border = shapely.boundary(arena.free)
        rings = [np.asarray(line.coords)[:, :2] for line in getattr(border, "geoms", [border])]
        edges = [np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]
        both = np.concatenate([arena.walls, *edges])  # (n, 2, 2)
        flipped = (both[:, 0, 0] > both[:, 1, 0]) | (
            (both[:, 0, 0] == both[:, 1, 0]) & (both[:, 0, 1] > both[:, 1, 1])
        )
        both[flipped] = both[flipped][:, ::-1]
        self.segments: Floats = np.unique(both, axis=0)
        """(n, 2, 2) [m] each segment once, in a canonical direction."""
        self._lines = np.asarray(shapely.linestrings(_cut(self.segments)))  # (m,) of geometries
        self._tree = shapely.STRtree(self._lines)

    def distances(self, points: Floats) -> Floats:
        """Return exact distances (n,) [m] of points (n, 2) to the nearest barrier."""
        where = shapely.points(points[:, 0], points[:, 1])
        nearest = self._tree.nearest(where)
        return np.asarray(shapely.distance(where, self._lines[nearest]), dtype=np.float64)

    def are_clear(self, starts: Floats, ends: Floats, clearance: float) -> Bools:
        """Return whether each straight move (n, 2) -> (n, 2) keeps `clearance` [m]; exact, without sampling."""
        moves = shapely.linestrings(np.stack([starts, ends], axis=1))
        hit, _ = self._tree.query(moves, predicate="dwithin", distance=clearance - 1e-9)
        clear = np.ones(len(starts), dtype=np.bool_)
        clear[hit] = False
        return clear

    def field(self, x: Floats, y: Floats, cap: float) -> Floats:
        """Return exact distances (nx, ny) [m] at the nodes of an even grid, capped at `cap` [m]."""
        square = np.full((len(x), len(y)), cap * cap)
        low = self.segments.min(axis=1) - cap  # (n, 2)
        high = self.segments.max(axis=1) + cap
        i = np.searchsorted(x, np.stack([low[:, 0], high[:, 0]]))
        j = np.searchsorted(y, np.stack([low[:, 1], high[:, 1]]))
        for k, (start, end) in enumerate(self.segments):
            window = np.s_[i[0, k] : i[1, k], j[0, k] : j[1, k]]
            px, py = x[window[0], None] - start[0], y[None, window[1]] - start[1]
            ux, uy = end - start
            share = (px * ux + py * uy) / (ux * ux + uy * uy)
            np.maximum(np.minimum(share, 1.0, out=share), 0.0, out=share)
            np.minimum(square[window], (px - share * ux) ** 2 + (py - share * uy) ** 2, out=square[window])
        return np.asarray(np.sqrt(square), dtype=np.float64)


def _cut(segments: Floats) -> Floats:
    """Cut long segments into even parts of at most `MAX_SEGMENT`."""
    parts = np.ceil(np.hypot(*(segments[:, 1] - segments[:, 0]).T) / MAX_SEGMENT).astype(int).clip(1)
    owner, number = members(parts)
    ends = np.stack([number, number + 1], axis=1) / parts[owner, None]  # (m, 2) shares of the segment
    start, step = segments[owner, :1], segments[owner, 1:] - segments[owner, :1]
    return np.asarray(start + ends[:, :, None] * step, dtype=np.float64)
