"""Walls of a map of pixels: straight, through the middle of their cells, and where free space ends without one.

A map_server map has thousands of walls as long as a pixel. Their outlines are simplified (Douglas and Peucker 1973),
and every straight stretch is fitted to the steps that it replaces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from planners.arena import Arena
from sensorgraph.types import Floats

PREFIX = "map/edge_"
"""Of the walls of a map of pixels, which are named by their order."""
STRAIGHT = "outline/edge_"
"""Of the straight walls that stand for them."""
MAX_STEP = 1.0
"""[pixel] that a straight wall may leave the outline of the cells."""
MIN_WALLS = 40
"""Fewer borders are no steps worth straightening."""
SPECK = 0.2
"""[pixel] a shorter wall is what is left of a single cell."""
MIN_WALL = 1.5
"""[pixel] a shorter stretch of an outline stays a part of its neighbour."""


def is_raster(arena: Arena) -> bool:
    """Tell whether the walls of an arena are the borders of cells."""
    return arena.n_walls >= MIN_WALLS and all(name.startswith(PREFIX) for name in arena.names)


def pixel_of(arena: Arena) -> float:
    """Return the width of a cell [m]."""
    return float(np.hypot(*np.diff(arena.walls, axis=1)[:, 0].T).min())


def straightened(arena: Arena) -> tuple[Arena, float]:
    """Return an arena of pixels with straight walls, and how far these leave the borders of the cells, r.m.s. [m]."""
    pixel = pixel_of(arena)
    rings = shapely.get_parts(shapely.polygonize([shapely.union_all(shapely.linestrings(arena.walls))]))
    outlines = [np.array(ring.coords)[:-1] for face in rings for ring in (face.exterior, *face.interiors)]
    unique = {tuple(sorted(map(tuple, np.round(ring, 6).tolist()))): ring for ring in outlines}
    shapely.prepare(arena.free)
    walls, off = [], []
    for ring in unique.values():
        corners, misses = _straight(ring, arena.free, pixel)
        walls.append(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
        off.append(misses)
    straight = np.concatenate(walls)
    straight = straight[np.hypot(*np.diff(straight, axis=1)[:, 0].T) > SPECK * pixel]
    names = tuple(f"{STRAIGHT}{i}" for i in range(len(straight)))
    rms = float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    return replace(arena, walls=straight, names=names, surfaces=("wall",) * len(straight)), rms


def _straight(ring: Floats, free: shapely.Geometry, pixel: float) -> tuple[Floats, Floats]:
    """Return the corners (n, 2) of straight walls along a closed outline of steps, and what they leave [m].

    A cell is occupied because a surface is somewhere in it: walls lie in the middle of their cells, half a pixel
    behind the border that faces free space.
    """
    far = int(np.argmax(np.hypot(*(ring - ring.mean(axis=0)).T)))  # a true corner to begin at
    steps = _dense(np.roll(ring, -far, axis=0), pixel)
    closed = shapely.LineString(np.vstack([steps, steps[:1]]))
    kept = np.array(closed.simplify(MAX_STEP * pixel).coords)[:-1]
    if len(kept) < 3:
        return ring, np.zeros(1)
    at = [int(np.argmin(np.hypot(*(steps - corner).T))) for corner in kept]
    lines, off, behind = [], [], []
    for first, last in zip(at, [*at[1:], at[0] + len(steps)], strict=True):
        points = steps[np.arange(first, last + 1) % len(steps)]
        middles = (points[1:] + points[:-1]) / 2
        centre = middles.mean(axis=0)
        way = points[-1] - points[0]
        if len(middles) >= 2 * MIN_WALL:
            way = np.linalg.svd(middles - centre, full_matrices=False)[2][0]
            off.append((middles - centre) @ np.array([-way[1], way[0]]))
        across = np.array([-way[1], way[0]]) / max(float(np.hypot(*way)), 1e-9)
        sides = [middles + side * pixel * across for side in (-1, 1)]
        left_free, right_free = (float(shapely.contains_xy(free, *side.T).mean()) for side in sides)
        behind.append(0.5 * pixel * np.sign(left_free - right_free) * across)
        lines.append((centre + behind[-1], way))
    corners = [
        _meet(*lines[k - 1], *lines[k], kept[k] + behind[k - 1] + behind[k], pixel) for k in range(len(lines))
    ]
    return np.array(corners), np.concatenate([np.zeros(1), *off])


def _dense(ring: Floats, pixel: float) -> Floats:
    """Return the outline with a point every half pixel."""
    line = shapely.LineString(np.vstack([ring, ring[:1]]))
    return np.array(shapely.segmentize(line, 0.5 * pixel).coords)[:-1]


def _meet(p: Floats, u: Floats, q: Floats, v: Floats, corner: Floats, pixel: float) -> Floats:
    """Return where two lines meet, or the corner where they hardly do, or far from it."""
    cross = float(u[0] * v[1] - u[1] * v[0])
    if abs(cross) < 0.2 * float(np.hypot(*u) * np.hypot(*v)):
        return corner
    s = float((q - p)[0] * v[1] - (q - p)[1] * v[0]) / cross
    meet = p + s * u
    return meet if np.hypot(*(meet - corner)) < 2 * pixel else corner


def unknown_borders(arena: Arena) -> Floats:
    """Return where free space ends without a wall, (n, 2, 2) [m]."""
    walls = shapely.union_all(shapely.linestrings(arena.walls)).buffer(
        1e-4 * pixel_of(arena), cap_style="flat"
    )
    left = shapely.get_parts(arena.free.boundary.difference(walls))
    segments = [
        np.stack([c[:-1], c[1:]], axis=1) for c in (np.array(part.coords) for part in left) if len(c) > 1
    ]
    long = [s[np.hypot(*np.diff(s, axis=1)[:, 0].T) > 0.01 * pixel_of(arena)] for s in segments]
    return np.concatenate(long) if long else np.zeros((0, 2, 2))
