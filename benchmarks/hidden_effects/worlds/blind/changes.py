"""Rooms that are not what the map says: walls and things moved, added, missing, and corners a few millimetres off."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from shapely.geometry import LineString, Point, Polygon

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.geometry import largest_part, ngon, turned, with_edge_moved
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.blind.effects import Hidden, either_sign, material_size, rounded
from benchmarks.hidden_effects.worlds.blind.robots import Robot
from benchmarks.hidden_effects.worlds.blind.rooms import KEEP_OFF, Room

MOST_JITTERED = 25
"""Corners of an arena from which on they are left where they are: its walls are bent by an effect."""
Change = Callable[[Room, Hidden, np.random.Generator, Robot], Room]


def changed_room(room: Room, hidden: Mapping[str, Hidden], rng: np.random.Generator, robot: Robot) -> Room:
    """Return the room as built; draws size and place of the effects that change it."""
    for name, change in CHANGES.items():
        if name in hidden:
            room = change(room, hidden[name], rng, robot)
    return room


def jittered(room: Room, seed: int) -> Room:
    """Return the room with its corners off by up to 4 mm; the same corner is off by the same in map and changed room."""

    def moved(name: str, ring: Floats) -> Floats:
        is_outer, n = name == room.name, len(ring)
        rng = np.random.default_rng([seed, sum(map(ord, "outer" if is_outer else name))])
        errors = np.clip(rng.normal(0, 0.002, (200, 2)), -0.004, 0.004)
        if is_outer:
            return ring + (errors[:n] if n < MOST_JITTERED else 0)
        return ring + errors[0] + 0.4 * errors[1 : n + 1]

    return room.changed(moved)


def _long_walls(room: Room, least: float) -> list[int]:
    walls = [k for k in range(len(room.outer)) if room.lengths[k] > least]
    if not walls:
        raise Redraw(f"no wall of {least} m")
    return walls


def _moved_wall(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    edge = int(rng.choice(_long_walls(room, 1.6)))
    d = either_sign(rng) * material_size(rng, 0.01)
    hidden.values, hidden.place, hidden.wall = {"d": rounded(d)}, room.wall_name(edge), edge
    return room.with_ring(room.name, with_edge_moved(room.outer, edge, d))


def _draw_thing(room: Room, rng: np.random.Generator) -> str:
    """Draw the name of one of the larger things."""
    sizes = [Polygon(room.rings[name]).area * rng.uniform(0.4, 1) for name in room.obstacles]
    return room.obstacles[int(np.argmax(sizes))]


def _moved_obstacle(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    hidden.place = _draw_thing(room, rng)
    angle = rng.uniform(0, 2 * np.pi)
    size = material_size(rng, 0.01)
    shift = np.round([size * np.cos(angle), size * np.sin(angle)], 5)
    hidden.values = {"dx": float(shift[0]), "dy": float(shift[1])}
    return room.with_ring(hidden.place, room.rings[hidden.place] + shift)


def _missing_obstacle(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    hidden.place = _draw_thing(room, rng)
    x, y = room.rings[hidden.place].mean(axis=0)
    hidden.xy = (rounded(x, 3), rounded(y, 3))
    return room.with_ring(hidden.place, None)


def _unmapped_obstacle(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    radius, free, gap = material_size(rng, 0.02), room.free(), robot.footprint + KEEP_OFF
    x0, y0, x1, y1 = free.bounds
    for _ in range(500):
        at = np.round([rng.uniform(x0, x1), rng.uniform(y0, y1)], 3)
        if not free.contains(Point(at)) or free.boundary.distance(Point(at)) < radius + 0.12:
            continue
        passable = free.difference(Point(at).buffer(radius)).buffer(-gap)
        if largest_part(passable).area > 0.8 * free.buffer(-gap).area:
            break
    hidden.xy = (float(at[0]), float(at[1]))
    hidden.values = {"x": hidden.xy[0], "y": hidden.xy[1], "r": rounded(radius, 4)}
    return room.with_ring("extra", ngon(32, radius) + at)


def _map_scale(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    s = rounded(either_sign(rng) * material_size(rng, 0.002))
    shift, middle = np.round(rng.uniform(-0.012, 0.012, 2), 4), room.middle
    hidden.values = {"s": s, "dx": float(shift[0]), "dy": float(shift[1])}
    return room.changed(lambda _, ring: middle + shift + (1 + s) * (ring - middle))


def _shear(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    k, y = rounded(either_sign(rng) * rng.uniform(0.015, 0.025), 4), room.outer.mean(axis=0)[1]
    hidden.values = {"k": k}
    return room.changed(lambda _, ring: ring + np.column_stack([k * (ring[:, 1] - y), np.zeros(len(ring))]))


def _bow(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    edge = max(_long_walls(room, 2.5), key=lambda k: float(room.lengths[k]))
    A = rounded(rng.uniform(0.06, 0.1), 4)
    share = np.linspace(0, 1, 26)[1:-1, None]
    a, b = room.outer[edge], room.outer[(edge + 1) % len(room.outer)]
    bent = a + share * (b - a) + 4 * A * share * (1 - share) * room.outward(edge)
    hidden.values, hidden.place = {"A": A}, room.wall_name(edge)
    return room.with_ring(room.name, np.insert(room.outer, edge + 1, bent, axis=0))


def _corrugated(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    """Give the longest wall niches as wide as what is left between them."""
    edge = int(np.argmax(room.lengths))
    depth, pitch = rounded(rng.uniform(0.08, 0.12), 4), rounded(rng.uniform(0.3, 0.5), 4)
    a, b = room.outer[edge], room.outer[(edge + 1) % len(room.outer)]
    length = float(room.lengths[edge])
    along, out = (b - a) / length, room.outward(edge)
    corners = []
    for first in np.arange(pitch / 2, length - 0.75 * pitch, pitch):
        for way, deep in ((0.0, 0.0), (0.0, depth), (pitch / 2, depth), (pitch / 2, 0.0)):
            corners.append(a + (first + way) * along + deep * out)
    hidden.values, hidden.place = {"depth": depth, "pitch": pitch}, room.wall_name(edge)
    return room.with_ring(room.name, np.insert(room.outer, edge + 1, np.array(corners), axis=0))


def _wing(room: Room, hidden: Hidden, rng: np.random.Generator, robot: Robot) -> Room:
    """Turn all beyond a line across the longer side about a point on that line."""
    size = np.ptp(room.outer, axis=0)
    axis = int(np.argmax(size))
    at = room.outer.min(axis=0) + rng.uniform(0.4, 0.6) * size
    angle = rounded(either_sign(rng) * rng.uniform(0.02, 0.035))
    hinge = np.where(np.arange(2) == axis, at, room.middle)

    corners: list[Floats] = []
    for a, b in zip(room.outer, np.roll(room.outer, -1, axis=0), strict=True):
        corners.append(a)
        if (a[axis] - hinge[axis]) * (b[axis] - hinge[axis]) < 0:
            corners.append(a + (hinge[axis] - a[axis]) / (b[axis] - a[axis]) * (b - a))
    hidden.values = {"angle": angle, "x": rounded(hinge[0], 3), "y": rounded(hinge[1], 3), "axis": axis}

    def moved(name: str, ring: Floats) -> Floats:
        if name == room.name:
            outer = np.array(corners)
            is_beyond = outer[:, axis] > hinge[axis]
            return np.where(is_beyond[:, None], hinge + turned(outer - hinge, angle), outer)
        return hinge + turned(ring - hinge, angle) if ring.mean(axis=0)[axis] > hinge[axis] else ring

    return room.changed(moved)


CHANGES: dict[str, Change] = {
    "moved_wall": _moved_wall,
    "moved_obstacle": _moved_obstacle,
    "missing_obstacle": _missing_obstacle,
    "unmapped_obstacle": _unmapped_obstacle,
    "map_scale": _map_scale,
    "f_shear": _shear,
    "f_bow": _bow,
    "f_corrugated": _corrugated,
    "f_wing": _wing,
}
"""In the order in which they act."""


def shove(room: Room, hidden: Hidden, rng: np.random.Generator) -> Room:
    """Return the room after one of its larger things was pushed aside."""
    name = _draw_thing(room, rng)
    ring, others = room.rings[name], [Polygon(room.rings[one]) for one in room.obstacles if one != name]
    for _ in range(60):
        angle, way = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 0.4)
        shift = np.round([way * np.cos(angle), way * np.sin(angle)], 4)
        there = Polygon(ring + shift)
        inside = Polygon(room.outer).buffer(-0.04).contains(there)
        if inside and all(there.distance(other) > 0.06 for other in others):
            break
    else:
        raise Redraw("nothing can be shoved")
    hidden.values = {"dx": float(shift[0]), "dy": float(shift[1])}
    hidden.place = name
    return room.with_ring(name, ring + shift)


def put_fence(room: Room, hidden: Hidden, rng: np.random.Generator) -> LineString:
    """Put a mesh fence before a long wall; return it."""
    edge = int(rng.choice(_long_walls(room, 2.4)))
    a, b = room.outer[edge], room.outer[(edge + 1) % len(room.outer)]
    off = -room.outward(edge) * rng.uniform(0.4, 0.6)
    ends = np.array([*(a + 0.2 * (b - a) + off), *(a + 0.8 * (b - a) + off)])
    hidden.shapes["ends"] = np.round(ends, 4)
    hidden.values = {"p": rounded(rng.uniform(0.25, 0.45), 3)}
    hidden.xy = (rounded(ends[::2].mean(), 3), rounded(ends[1::2].mean(), 3))
    return LineString([tuple(ends[:2]), tuple(ends[2:])])
