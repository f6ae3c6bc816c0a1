"""Rooms drawn from a seed, and a plain ray caster (rays x walls)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely import affinity

from benchmarks.hidden_effects.geometry import Room, rectangle, turned
from benchmarks.hidden_effects.log import Floats, Ints

ARENA = "arena"
MIN_GAP = 0.9
"""[m] between obstacles, and between obstacles and walls: the robot passes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Walls:
    """Segments that stop a ray."""

    a: Floats
    """(n_walls, 2) [m]"""
    b: Floats
    """(n_walls, 2) [m]"""
    names: tuple[str, ...]
    """(n_walls,) `FEATURE/edge_i`."""

    def index(self, name: str) -> Ints:
        """Return the indices of the segments that carry a name."""
        return np.array([i for i, other in enumerate(self.names) if other == name], dtype=np.intp)


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueHits:
    """Where each of n rays ended."""

    ranges: Floats
    """(n,) [m]; +inf: nothing."""
    wall: Ints
    """(n,) index of the wall; -1: nothing or a disc."""
    incidence: Floats
    """(n,) [rad] 0 = head-on."""
    along: Floats
    """(n,) [m] from the first vertex of the wall."""


def centroid(room: Room) -> Floats:
    """Return the centroid (2,) [m] of the arena."""
    return np.array(shapely.Polygon(room.outer).centroid.coords[0])


def walls_of(room: Room) -> Walls:
    """Return the segments of all rings."""
    return Walls(a=room.walls[:, :2], b=room.walls[:, 2:], names=room.wall_names)


def cast(walls: Walls, origins: Floats, angles: Floats) -> TrueHits:
    """Cast rays from origins (n, 2) [m] at angles (n,) [rad] against the walls."""
    ox, oy = np.ascontiguousarray(origins[:, 0]), np.ascontiguousarray(origins[:, 1])
    cx, cy = np.cos(angles), np.sin(angles)
    best = np.full(len(angles), np.inf)
    wall = np.full(len(angles), -1, dtype=np.intp)
    for i, (a, b) in enumerate(zip(walls.a, walls.b, strict=True)):
        ex, ey = b - a
        ax, ay = a[0] - ox, a[1] - oy
        with np.errstate(divide="ignore", invalid="ignore"):
            inv = 1.0 / (cx * ey - cy * ex)
            t = (ax * ey - ay * ex) * inv
            u = (ax * cy - ay * cx) * inv
        nearer = (t > 1e-7) & (t < best) & (u >= -1e-9) & (u <= 1 + 1e-9)
        best[nearer] = t[nearer]
        wall[nearer] = i
    e = walls.b - walls.a
    length = np.hypot(e[:, 0], e[:, 1])
    w = np.maximum(wall, 0)
    cos_inc = np.abs(-e[w, 1] * cx + e[w, 0] * cy) / length[w]
    with np.errstate(invalid="ignore"):
        x, y = ox + best * cx - walls.a[w, 0], oy + best * cy - walls.a[w, 1]
        along = (x * e[w, 0] + y * e[w, 1]) / length[w]
    return TrueHits(
        ranges=best,
        wall=wall,
        incidence=np.where(wall >= 0, np.arccos(np.clip(cos_inc, 0, 1)), 0.0),
        along=np.where(wall >= 0, along, 0.0),
    )


def disc_range(origins: Floats, angles: Floats, centres: Floats, radius: float) -> Floats:
    """Return the ranges (n,) [m] to a disc; centres (n, 2) or (2,) [m]; +inf where it is missed."""
    dx, dy = centres[..., 0] - origins[:, 0], centres[..., 1] - origins[:, 1]
    c, s = np.cos(angles), np.sin(angles)
    ahead, aside = dx * c + dy * s, -dx * s + dy * c
    half = radius**2 - aside**2
    near = ahead - np.sqrt(np.maximum(half, 0.0))
    return np.where((half > 0) & (near > 0), near, np.inf)


def make_room(rng: np.random.Generator) -> Room:
    """Draw a room: square, rectangle, L, alcove, corridor or crooked, with one to five obstacles."""
    outer = _outer(rng)
    solid = shapely.Polygon(outer)
    rings: dict[str, Floats] = {ARENA: outer}
    n = int(rng.integers(2, 5)) if solid.area < 30 else int(rng.integers(1, 6))
    keep_out = solid.exterior.buffer(MIN_GAP)
    x0, y0, x1, y1 = solid.bounds
    names = list(rng.permutation(["box", "crate", "wedge", "shelf", "pillar", "desk", "block"]))
    for _ in range(400):
        if len(rings) > n:
            break
        shape = affinity.translate(
            shapely.Polygon(_obstacle(rng)), rng.uniform(x0 + 0.8, x1 - 0.8), rng.uniform(y0 + 0.8, y1 - 0.8)
        )
        if solid.contains(shape) and not keep_out.intersects(shape):
            keep_out = keep_out.union(shape.buffer(MIN_GAP))
            rings[names[len(rings) - 1]] = np.round(np.array(shape.exterior.coords)[:-1], 3)
    if len(rings) == 1:
        return make_room(rng)
    return Room(rings=rings)


def _outer(rng: np.random.Generator) -> Floats:
    kind = rng.choice(
        ["square", "rectangle", "l_shape", "alcove", "corridor", "crooked"],
        p=[3, 3, 2, 1, 1, 1] / np.float64(11),
    )
    if kind == "square":
        ring = rectangle(5.0, 5.0)
    elif kind == "rectangle":
        ring = rectangle(*rng.permutation([rng.uniform(4.0, 8.0), rng.uniform(6.0, 11.0)]))
    elif kind == "l_shape":
        w, h = rng.uniform(6.0, 9.0, size=2)
        u, v = rng.uniform(0.45, 0.6) * w, rng.uniform(0.45, 0.6) * h
        ring = np.array([(0, 0), (w, 0), (w, v), (u, v), (u, h), (0, h)])
    elif kind == "alcove":
        w, h, depth = rng.uniform(5.0, 7.0), rng.uniform(4.5, 6.5), rng.uniform(0.8, 1.8)
        p, q = rng.uniform(0.15, 0.3) * w, rng.uniform(0.55, 0.75) * w
        ring = np.array([(0, 0), (w, 0), (w, h), (q, h), (q, h + depth), (p, h + depth), (p, h), (0, h)])
    elif kind == "corridor":
        w, h = rng.uniform(4.5, 6.0, size=2)
        long, wide = rng.uniform(2.5, 4.0), rng.uniform(1.4, 1.8)
        p = rng.uniform(0.5, h - wide - 0.5)
        ring = np.array(
            [(0, 0), (w, 0), (w, p), (w + long, p), (w + long, p + wide), (w, p + wide), (w, h), (0, h)]
        )
    else:
        w, h = rng.uniform(4.5, 8.0), rng.uniform(5.0, 9.0)
        ring = rectangle(w, h) + rng.uniform(-0.5, 0.5, size=(4, 2))
    if rng.random() < 0.25:
        ring = turned(ring, rng.uniform(-0.6, 0.6))
    if rng.random() < 0.3:
        ring = ring + rng.uniform(-5, 5, size=2)
    return np.round(ring.astype(np.float64), 3)


def _obstacle(rng: np.random.Generator) -> Floats:
    kind = rng.choice(["box", "triangle", "l_shape", "hexagon"], p=[0.4, 0.2, 0.25, 0.15])
    w, h = rng.uniform(0.25, 0.9, size=2)
    if kind == "box":
        ring = rectangle(w, h)
    elif kind == "triangle":
        ring = np.array([(0.0, 0.0), (w + 0.2, 0.0), (rng.uniform(0, w), h + 0.2)])
    elif kind == "l_shape":
        w, h, t = w + 0.3, h + 0.3, rng.uniform(0.15, 0.3)
        ring = np.array([(0.0, 0.0), (w, 0.0), (w, t), (t, t), (t, h), (0.0, h)])
    else:
        angle = np.arange(6) * np.pi / 3
        ring = rng.uniform(0.12, 0.35) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = ring - ring.mean(axis=0)
    return turned(ring, float(rng.choice([0.0, rng.uniform(-np.pi, np.pi)])))


def shift_edge(ring: Floats, i: int, d: float) -> Floats:
    """Move edge i of a ring by d [m] along its right-hand normal; its neighbours keep their lines."""
    n = len(ring)
    a, b = ring[i], ring[(i + 1) % n]
    along = (b - a) / np.linalg.norm(b - a)
    normal = np.array([along[1], -along[0]])
    moved = ring.copy()
    moved[i] = _meet(a + d * normal, along, ring[(i - 1) % n], a - ring[(i - 1) % n])
    moved[(i + 1) % n] = _meet(b + d * normal, along, ring[(i + 2) % n], b - ring[(i + 2) % n])
    return moved


def _meet(p: Floats, along: Floats, q: Floats, other: Floats) -> Floats:
    det = along[0] * other[1] - along[1] * other[0]
    t = ((q[0] - p[0]) * other[1] - (q[1] - p[1]) * other[0]) / det
    return p + t * along
