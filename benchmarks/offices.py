"""Random offices as GeoJSON text: rooms with doors, desks, round columns, legs of chairs and tables.

No import from the project but the writer of maps of `benchmarks.hidden_effects`: what is planned, identified or diagnosed on them shares no code with them.
"""

from __future__ import annotations

import numpy as np

from benchmarks.hidden_effects.case import geojson

WALL_THICKNESS = 0.10  # [m] thickness of inner walls
DOOR = 0.90  # [m]
LEAST_ROOM = 2.8  # [m] side below which a room is not divided again

Box = tuple[float, float, float, float]
Corners = list[tuple[float, float]]


def office(seed: int, *, width: float = 15.0, depth: float = 12.0, rooms: int = 5) -> str:
    """Return a random office as the GeoJSON text of an arena; the same seed gives the same text."""
    rng = np.random.default_rng([seed, 815])
    spaces: list[Box] = [(0.0, 0.0, width, depth)]
    obstacles: list[tuple[str, Corners]] = []
    while len(spaces) < rooms:
        spaces.sort(key=lambda box: (box[2] - box[0]) * (box[3] - box[1]))
        parts, walls = _divide(spaces.pop(), rng)
        spaces += parts
        obstacles += [(f"wall_{len(obstacles) + i}", wall) for i, wall in enumerate(walls)]
        if not walls:
            break
    for number, space in enumerate(sorted(spaces)):
        obstacles += [(f"room_{number}_{name}", corners) for name, corners in _furnish(space, rng)]
    return geojson("office", {"office": _box(0.0, 0.0, width, depth), **dict(obstacles)})


def _box(x0: float, y0: float, x1: float, y1: float) -> Corners:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _divide(space: Box, rng: np.random.Generator) -> tuple[list[Box], list[Corners]]:
    """Cut a space across its longer side by a wall with a door."""
    x0, y0, x1, y1 = space
    along_x = x1 - x0 >= y1 - y0
    low, high = (x0, x1) if along_x else (y0, y1)
    if high - low < 2 * LEAST_ROOM:
        return [space], []
    cut = round(float(rng.uniform(low + LEAST_ROOM, high - LEAST_ROOM)), 2)
    a, b = (y0, y1) if along_x else (x0, x1)
    door = round(float(rng.uniform(a + 0.3, b - 0.3 - DOOR)), 2)
    pieces = [(a, door), (door + DOOR, b)]
    half = WALL_THICKNESS / 2
    if along_x:
        walls = [_box(cut - half, s, cut + half, e) for s, e in pieces]
        return [(x0, y0, cut - half, y1), (cut + half, y0, x1, y1)], walls
    walls = [_box(s, cut - half, e, cut + half) for s, e in pieces]
    return [(x0, y0, x1, cut - half), (x0, cut + half, x1, y1)], walls


def _furnish(space: Box, rng: np.random.Generator) -> list[tuple[str, Corners]]:
    """Place things that do not touch each other nor block the middle of the room's sides."""
    x0, y0, x1, y1 = space
    placed: list[tuple[float, float, float]] = []  # x, y, radius
    things: list[tuple[str, Corners]] = []

    def spot(radius: float, gap: float) -> tuple[float, float] | None:
        if min(x1 - x0, y1 - y0) <= 2 * (radius + gap):
            return None
        for _ in range(60):
            x = float(rng.uniform(x0 + radius + gap, x1 - radius - gap))
            y = float(rng.uniform(y0 + radius + gap, y1 - radius - gap))
            if all(np.hypot(x - px, y - py) > radius + pr + 0.55 for px, py, pr in placed):
                placed.append((x, y, radius))
                return x, y
        return None

    if min(x1 - x0, y1 - y0) < 2.0:
        return things
    for i in range(int(rng.integers(1, 3))):
        length, depth = float(rng.uniform(1.2, 1.7)), float(rng.uniform(0.6, 0.8))
        if at := spot(float(np.hypot(length, depth)) / 2, 0.5):
            turn = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)]))
            things.append((f"desk_{i}", _turned(at, length, depth, turn)))
    if rng.random() < 0.6 and (at := spot(0.2, 0.5)):
        radius, n = float(rng.uniform(0.12, 0.22)), int(rng.integers(24, 33))
        angles = 2 * np.pi * np.arange(n) / n
        ring = [(at[0] + radius * float(np.cos(a)), at[1] + radius * float(np.sin(a))) for a in angles]
        things.append(("column", ring))
    for i in range(int(rng.integers(0, 3))):
        size = float(rng.uniform(0.4, 0.7))
        if at := spot(size, 0.4):
            turn = float(rng.uniform(0, np.pi))
            for k, (sx, sy) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)]):
                c, s = np.cos(turn), np.sin(turn)
                x, y = at[0] + size / 2 * float(c * sx - s * sy), at[1] + size / 2 * float(s * sx + c * sy)
                things.append((f"leg_{i}_{k}", _turned((x, y), 0.08, 0.08, turn)))
    return things


def _turned(at: tuple[float, float], length: float, depth: float, turn: float) -> Corners:
    c, s = float(np.cos(turn)), float(np.sin(turn))
    return [
        (at[0] + c * u * length / 2 - s * v * depth / 2, at[1] + s * u * length / 2 + c * v * depth / 2)
        for u, v in [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    ]
