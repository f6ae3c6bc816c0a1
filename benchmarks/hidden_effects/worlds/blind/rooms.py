"""Rooms: ten floor plans with furniture, their walls and their free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from shapely.geometry import Polygon

from benchmarks.hidden_effects import geometry
from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.geometry import free_space, largest_part, ngon, outward, turned
from benchmarks.hidden_effects.log import Floats

Thing = tuple[str, Floats]
"""Name and corners (n, 2) [m] of an obstacle."""
KEEP_OFF = 0.14
"""[m] beyond the footprint that must stay free between things."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Room(geometry.Room):
    """An arena and the things in it."""

    @property
    def lengths(self) -> Floats:
        """Lengths (n,) [m] of the arena's walls."""
        return np.asarray(np.hypot(*(np.roll(self.outer, -1, axis=0) - self.outer).T))

    @property
    def middle(self) -> Floats:
        """Middle (2,) [m] of the arena's bounding box."""
        return np.asarray(0.5 * (self.outer.min(axis=0) + self.outer.max(axis=0)))

    def outward(self, edge: int) -> Floats:
        """Return the outward normal (2,) of a wall of the arena."""
        return outward(self.outer[edge], self.outer[(edge + 1) % len(self.outer)])

    def wall_name(self, edge: int) -> str:
        """Return the name of a wall of the arena."""
        return f"{self.name}/edge_{edge}"


@dataclass(frozen=True, kw_only=True, eq=False)
class FloorPlan:
    """A kind of room before it is scaled, furnished and placed in the map."""

    corners: Sequence[tuple[float, float]] | Floats
    """[m]"""
    n_things: tuple[int, int]
    """Least count of things, and one more than the most."""
    sizes: tuple[float, float]
    """[m] half widths of the things."""
    is_crooked: bool = True
    """Its corners may be moved by 15 cm."""
    pillars: tuple[tuple[float, float], ...] = ()
    """[m] centres."""


# fmt: off
PLANS = {
    "lab": FloorPlan(corners=[(0, 0), (5, 0), (5, 4), (0, 4)], n_things=(2, 4), sizes=(0.15, 0.38)),
    "ell": FloorPlan(
        corners=[(0, 0), (7.2, 0), (7.2, 3.2), (3.4, 3.2), (3.4, 6.4), (0, 6.4)], n_things=(2, 5), sizes=(0.18, 0.45)
    ),
    "corridor": FloorPlan(
        corners=[(0, 0), (4, 0), (4, -0.5), (5.2, -0.5), (5.2, 0), (13, 0), (13, 2.1), (9.5, 2.1), (9.5, 2.9), (8, 2.9),
                 (8, 2.1), (3, 2.1), (3, 2.6), (1.8, 2.6), (1.8, 2.1), (0, 2.1)],
        n_things=(2, 4), sizes=(0.12, 0.22), is_crooked=False,
    ),
    "hall": FloorPlan(
        corners=[(0, 0), (11, 0), (11, 8), (0, 8)], n_things=(3, 6), sizes=(0.25, 0.6),
        pillars=((3.2, 2.7), (7.8, 2.7), (3.2, 5.4), (7.8, 5.4)),
    ),
    "slanted": FloorPlan(
        corners=[(0, 0), (6.1, -0.7), (7.3, 2.6), (5.2, 5.2), (0.8, 4.5)], n_things=(2, 6), sizes=(0.18, 0.42)
    ),
    "tworooms": FloorPlan(
        corners=[(0, 0), (4.2, 0), (4.2, 1.5), (4.36, 1.5), (4.36, 0), (8.6, 0), (8.6, 3.9), (4.36, 3.9), (4.36, 2.6),
                 (4.2, 2.6), (4.2, 3.9), (0, 3.9)],
        n_things=(2, 5), sizes=(0.15, 0.34), is_crooked=False,
    ),
    "rotunda": FloorPlan(corners=ngon(14, 3.1, 0.1, 0.86), n_things=(3, 6), sizes=(0.15, 0.35)),
    "flat": FloorPlan(
        corners=[(0, 0), (5, 0), (5, 1.1), (8, 1.1), (8, 6.8), (4.4, 6.8), (4.4, 5.9), (1.2, 5.9), (1.2, 3.2), (0, 3.2)],
        n_things=(7, 11), sizes=(0.14, 0.4), is_crooked=False,
    ),
    "ushape": FloorPlan(
        corners=[(0, 0), (9, 0), (9, 5.6), (6.2, 5.6), (6.2, 2.7), (2.9, 2.7), (2.9, 6.3), (0, 6.3)],
        n_things=(2, 6), sizes=(0.18, 0.4),
    ),
    "workshop": FloorPlan(
        corners=[(0, 0), (8, 0), (8, 3.4), (6.6, 4.8), (4.9, 4.8), (4.9, 7.2), (1.7, 7.2), (1.7, 4.1), (0, 3.7)],
        n_things=(4, 8), sizes=(0.18, 0.45),
    ),
}
# fmt: on
LARGE = ("ell", "hall", "slanted", "ushape")
"""Rooms for the largest robot."""


def draw_room(kind: str, footprint: float, rng: np.random.Generator) -> Room:
    """Draw a room of a kind whose free space hangs together for a robot of this radius [m]."""
    plan, gap = PLANS[kind], footprint + KEEP_OFF
    for _ in range(400):
        scale = rng.uniform(0.93, 1.12)
        n_things = int(rng.integers(*plan.n_things))
        outer = np.array(plan.corners, dtype=float) * scale
        things: list[Thing] = [("pillar", (ngon(16, 0.24) + at) * scale) for at in plan.pillars]
        if rng.random() < 0.3:
            outer = outer + rng.uniform(-0.15, 0.15, outer.shape) * plan.is_crooked
        if _furnish(outer, things, n_things, plan.sizes, gap, rng) >= 2:
            break
    else:
        raise Redraw("no layout")
    angle = rng.uniform(-np.pi, np.pi) if rng.random() < 0.5 else rng.choice([0, np.pi / 2])
    shift = rng.uniform(-6, 6, 2)
    rings = {kind: outer} | {f"{name}_{k + 1}": ring for k, (name, ring) in enumerate(things)}
    return Room(rings={name: np.round(turned(ring, angle) + shift, 4) for name, ring in rings.items()})


def _furnish(
    outer: Floats,
    things: list[Thing],
    n_things: int,
    sizes: tuple[float, float],
    gap: float,
    rng: np.random.Generator,
) -> int:
    """Add things that leave most of the free space in one piece; return how many."""
    arena = Polygon(outer)
    empty_area = arena.buffer(-gap).area
    count = 0
    for _ in range(300):
        if count >= n_things:
            break
        name, ring = _draw_thing(sizes, rng)
        x0, y0, x1, y1 = arena.bounds
        ring = ring + (rng.uniform(x0, x1), rng.uniform(y0, y1))
        shape = Polygon(ring)
        if not arena.buffer(-0.04).contains(shape):
            continue
        if any(shape.distance(Polygon(other)) < 0.06 for _, other in things):
            continue
        passable = free_space(outer, [*(other for _, other in things), ring]).buffer(-gap)
        largest = largest_part(passable).area
        if largest < 0.45 * empty_area or largest < 0.9 * passable.area:
            continue
        things.append((name, ring))
        count += 1
    return count


def _draw_thing(sizes: tuple[float, float], rng: np.random.Generator) -> Thing:
    half, angle, kind = rng.uniform(*sizes), rng.uniform(0, 2 * np.pi), rng.integers(0, 6)
    if kind <= 1:
        a, b = half * rng.uniform(0.7, 1.3), half * rng.uniform(0.5, 1.0)
        return "box", turned(np.array([(-a, -b), (a, -b), (a, b), (-a, b)]), angle)
    if kind == 2:
        return "drum", ngon(18, half * 0.8, angle)
    if kind == 3:
        return "wedge", ngon(3, half * 1.1, angle)
    if kind == 4:
        return "hexa", ngon(6, half, angle)
    a = half * 1.1
    ring = [(-a, -a), (a, -a), (a, -0.2 * a), (-0.2 * a, -0.2 * a), (-0.2 * a, a), (-a, a)]
    return "corner", turned(np.array(ring), angle)
