"""People who walk about, as the legs that a laser sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from shapely.geometry import LineString, Point
from shapely.prepared import prep

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.blind.base import X, Y
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.rooms import largest_part

STEP = 0.05
"""[s]"""
WALL_DISTANCE = 0.22
"""[m] that people keep off walls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """A moving disc."""

    stamps: Floats
    x: Floats
    y: Floats
    """(n,) [s, m, m]"""
    radius: float
    """[m]"""
    is_there: Floats
    """(n,) 1 while its owner is in the room."""


class _Floor:
    """Where people may walk."""

    def __init__(self, free: Any) -> None:
        inner = largest_part(free.buffer(-WALL_DISTANCE))
        self._bounds, self.passable = inner.bounds, prep(inner)

    def goal(self, rng: np.random.Generator, start: Floats | None = None) -> Floats:
        """Draw a point (2,) [m], in sight of a start."""
        x0, y0, x1, y1 = self._bounds
        for _ in range(300):
            point = np.array([rng.uniform(x0, x1), rng.uniform(y0, y1)])
            if not self.passable.contains(Point(point)):
                continue
            if start is None:
                return point
            if np.hypot(*(point - start)) > 0.8 and self.passable.covers(LineString([start, point])):
                return point
        return point if start is None else start


def walkers(
    rng: np.random.Generator, free: Any, driven: Driven, duration: float, n_people: int
) -> tuple[Leg, ...]:
    """Return the legs of people who walk, pause, and step aside for the robot."""
    floor, stamps = _Floor(free), np.arange(0, duration + STEP, STEP)
    robot = np.column_stack([driven.at(stamps, X), driven.at(stamps, Y)])
    legs: list[Leg] = []
    for _ in range(n_people):
        legs += _walk(rng, floor, stamps, robot, duration)
    return tuple(legs)


def _walk(
    rng: np.random.Generator, floor: _Floor, stamps: Floats, robot: Floats, duration: float
) -> list[Leg]:
    at = floor.goal(rng)
    while np.hypot(*(at - robot[0])) < 0.9:
        at = floor.goal(rng)
    goal = floor.goal(rng, at)
    speed = rng.uniform(0.5, 1.1)
    pause = heading = way = 0.0
    radius = rng.uniform(0.055, 0.075)
    track = np.zeros((len(stamps), 4))  # x, y, way, heading
    for i in range(len(stamps)):
        off, left = at - robot[i], float(np.hypot(*(goal - at)))
        if np.hypot(*off) < 0.55:
            aside = at + off / max(np.hypot(*off), 1e-6) * STEP * 0.8
            if floor.passable.contains(Point(aside)):
                at = aside
                way += 0.04
            goal, pause = floor.goal(rng, at), 0.0
        elif pause > 0:
            pause -= STEP
        elif left < 0.06:
            goal = floor.goal(rng, at)
            pause = rng.uniform(0, 2.5) if rng.random() < 0.5 else 0.0
            speed = rng.uniform(0.5, 1.1)
        else:
            ahead, towards = at + (goal - at) / left * min(left, speed * STEP), goal - at
            if np.hypot(*(ahead - robot[i])) < 0.6:
                goal = floor.goal(rng, at)
            else:
                at, heading = ahead, float(np.arctan2(towards[1], towards[0]))
                way += speed * STEP
        track[i] = *at, way, heading
    is_there = np.ones(len(stamps))
    if rng.random() < 0.5:
        enters = rng.uniform(0, 0.35) * duration
        leaves = enters + rng.uniform(0.5, 0.65) * duration
        is_there = ((stamps > enters) & (stamps < leaves)).astype(float)
    return [_leg(track, stamps, side, radius, is_there) for side in (1, -1)]


def _leg(track: Floats, stamps: Floats, side: int, radius: float, is_there: Floats) -> Leg:
    """Return the left or right leg, which swings while its owner walks."""
    x, y, way, heading = track.T
    swing = 0.17 * np.sin(2 * np.pi * way / 1.3) * side
    c, s = np.cos(heading), np.sin(heading)
    return Leg(
        stamps=stamps,
        x=x + c * swing - s * 0.09 * side,
        y=y + s * swing + c * 0.09 * side,
        radius=radius,
        is_there=is_there,
    )
