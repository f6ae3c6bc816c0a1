"""Polygons, and rooms made of them; angles, interpolation and noise that lasts. Nothing here is physics of a world."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np
import shapely
from shapely.geometry import Polygon

from benchmarks.hidden_effects.case import geojson
from benchmarks.hidden_effects.log import Floats

Angle = TypeVar("Angle", float, Floats)


def wrapped(angle: Angle) -> Angle:
    """Return angles in [-pi, pi) [rad]."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def turned(points: Floats, angle: float) -> Floats:
    """Return points (n, 2) turned about the origin by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def interpolated(at: Floats | float, times: Floats, rows: Floats) -> Floats:
    """Return rows (n, k), known at times (n,), at other times (...): (..., k)."""
    return np.stack([np.interp(at, times, column) for column in rows.T], axis=-1)


def ngon(n: int, radius: float, turn: float = 0.0, stretch: float = 1.0) -> Floats:
    """Return the corners (n, 2) [m] of a regular polygon about the origin, its y stretched."""
    angle = turn + 2 * np.pi * np.arange(n) / n
    return np.column_stack([radius * np.cos(angle), stretch * radius * np.sin(angle)])


def rectangle(width: float, depth: float) -> Floats:
    """Return the corners (4, 2) [m] of a rectangle with a corner at the origin."""
    return np.array([(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)])


def outward(a: Floats, b: Floats) -> Floats:
    """Return the normal (2,) to the right of the way from a to b: outward on a ring that runs counter-clockwise."""
    along = b - a
    return np.asarray(np.array([along[1], -along[0]]) / np.hypot(*along))


def with_edge_moved(ring: Floats, i: int, d: float) -> Floats:
    """Return a ring (n, 2) whose edge i is moved outward by d [m], with both its corners."""
    j = (i + 1) % len(ring)
    moved = ring.copy()
    moved[[i, j]] += d * outward(ring[i], ring[j])
    return moved


def edges_of(ring: Floats) -> Floats:
    """Return the edges (n, 4) [m] of a ring: x and y of one end, then of the other."""
    return np.hstack([ring, np.roll(ring, -1, axis=0)])


def largest_part(shape: Any) -> Polygon:
    """Return the largest polygon of a shape; an empty one if there is none."""
    parts = [part for part in getattr(shape, "geoms", [shape]) if isinstance(part, Polygon)]
    return max(parts, key=lambda part: part.area, default=Polygon())


def free_space(outer: Floats, solids: Sequence[Floats]) -> Any:
    """Return what a ring encloses and no solid covers."""
    arena = Polygon(outer)
    return arena.difference(shapely.union_all([Polygon(ring) for ring in solids])) if solids else arena


def spot_in(shape: Any, rng: np.random.Generator) -> Floats:
    """Draw a place (2,) [m] in a shape."""
    x0, y0, x1, y1 = shape.bounds
    while True:
        spot = rng.uniform((x0, y0), (x1, y1))
        if shape.contains(shapely.Point(spot)):
            return np.asarray(spot)


def lasting(noise: Floats, keep: float) -> Floats:
    """Return noise (n, k) of unit variance of which a share lasts from each row to the next (autoregressive)."""
    noise = noise.copy()
    for i in range(1, len(noise) if keep else 0):
        noise[i] = keep * noise[i - 1] + math.sqrt(1 - keep**2) * noise[i]
    return noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Room:
    """Rings of corners (n, 2) [m] by name, counter-clockwise: first that of the outer wall, then those of obstacles."""

    rings: dict[str, Floats]

    @property
    def name(self) -> str:
        """Name of the outer ring."""
        return next(iter(self.rings))

    @property
    def outer(self) -> Floats:
        """(n, 2) [m] corners of the outer wall."""
        return self.rings[self.name]

    @property
    def obstacles(self) -> list[str]:
        """Names of the other rings."""
        return list(self.rings)[1:]

    @property
    def walls(self) -> Floats:
        """(n, 4) [m] edges of all rings, those of the outer one first."""
        return np.concatenate([edges_of(ring) for ring in self.rings.values()])

    @property
    def wall_names(self) -> tuple[str, ...]:
        """(n,) `RING/edge_i` of all edges."""
        return tuple(f"{name}/edge_{i}" for name, ring in self.rings.items() for i in range(len(ring)))

    def edge(self, name: str) -> tuple[Floats, Floats]:
        """Return both ends (2,) of the wall `RING/edge_i`."""
        of, i = name.split("/edge_")
        ring = self.rings[of]
        return ring[int(i)], ring[(int(i) + 1) % len(ring)]

    def free(self) -> Any:
        """Return the free space."""
        return free_space(self.outer, [self.rings[name] for name in self.obstacles])

    def with_ring(self, name: str, ring: Floats | None) -> Self:
        """Return the room with one ring replaced or added; None takes it out."""
        rings = {**self.rings, name: ring}
        return replace(self, rings={key: value for key, value in rings.items() if value is not None})

    def changed(self, move: Callable[[str, Floats], Floats]) -> Self:
        """Return the room with each ring moved: (name, ring) -> ring."""
        return replace(self, rings={name: move(name, ring) for name, ring in self.rings.items()})

    def geojson(self, digits: int = 4) -> str:
        """Return the map as a FeatureCollection."""
        return geojson(self.name, self.rings, digits)
