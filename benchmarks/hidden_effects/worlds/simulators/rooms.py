"""Rooms drawn from a seed, and a way through them: targets that a robot reaches on straight lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from benchmarks.hidden_effects.geometry import Room, ngon, rectangle, spot_in, turned, wrapped
from benchmarks.hidden_effects.log import Floats

OUTER = "arena"
GAP = 1.0
"""[m] between obstacles, and between obstacles and walls."""


def draw_room(rng: np.random.Generator) -> Room:
    """Draw a rectangle, an L or a room with an alcove, and three or four boxes and prisms in it."""
    w, h = rng.uniform(5.0, 8.0), rng.uniform(4.5, 7.0)
    kind = rng.choice(["rectangle", "l", "alcove"])
    if kind == "l":
        u, v = w * rng.uniform(0.5, 0.65), h * rng.uniform(0.5, 0.65)
        outer = np.array([(0, 0), (w, 0), (w, v), (u, v), (u, h), (0, h)])
    elif kind == "alcove":
        p, depth = h * 0.3, rng.uniform(0.8, 1.6)
        outer = np.array(
            [(0, 0), (w, 0), (w, p), (w + depth, p), (w + depth, 2 * p), (w, 2 * p), (w, h), (0, h)]
        )
    else:
        outer = rectangle(w, h)
    rings = {OUTER: np.round(outer.astype(np.float64), 3)}
    keep_out, inside = shapely.Polygon(outer).exterior.buffer(GAP), shapely.Polygon(outer)
    for _ in range(300):
        if len(rings) == 5:
            break
        ring = _prism(rng) + rng.uniform((0.8, 0.8), (w - 0.8, h - 0.8))
        shape = shapely.Polygon(ring)
        if inside.contains(shape) and not keep_out.intersects(shape):
            keep_out = keep_out.union(shape.buffer(GAP))
            rings[f"thing_{len(rings)}"] = np.round(ring, 3)
    return Room(rings=rings) if len(rings) > 2 else draw_room(rng)


def _prism(rng: np.random.Generator) -> Floats:
    """Draw a convex outline about the origin, (n, 2) [m]."""
    if rng.random() < 0.6:
        w, h = rng.uniform(0.3, 0.9, 2) / 2
        ring = np.array([(-w, -h), (w, -h), (w, h), (-w, h)])
    else:
        ring = ngon(int(rng.integers(3, 7)), rng.uniform(0.25, 0.45))
    return turned(ring, rng.uniform(-np.pi, np.pi))


@dataclass(eq=False)
class Pilot:
    """Gives set points (v, omega): drive to a target on a free line, now and then spin or back off."""

    room: Room
    rng: np.random.Generator
    v_max: float = 0.35
    omega_max: float = 0.8
    period: float = 0.05
    """[s] between set points."""

    def __post_init__(self) -> None:
        self.space = self.room.free().buffer(-0.45)
        self.core = self.room.free().buffer(-0.42)
        self.spin_left, self.back_left, self.pause_left = 0.0, 0.0, 1.0
        self.target: Floats | None = None
        self.speed = self.v_max
        self.v, self.omega = 0.0, 0.0

    def start(self) -> Floats:
        """Draw a pose (x, y, phi) to begin at."""
        return np.array([*spot_in(self.space, self.rng), self.rng.uniform(-np.pi, np.pi)])

    def command(self, pose: Floats) -> tuple[float, float]:
        """Return the next set point, of limited slope."""
        v, omega = self._goal(pose)
        self.v += float(np.clip(v - self.v, -0.5 * self.period, 0.5 * self.period))
        self.omega += float(np.clip(omega - self.omega, -2.0 * self.period, 2.0 * self.period))
        return self.v, self.omega

    def _goal(self, pose: Floats) -> tuple[float, float]:
        if self.pause_left > 0:
            self.pause_left -= self.period
            return 0.0, 0.0
        if abs(self.spin_left) > 0.05:
            omega = float(np.sign(self.spin_left)) * self.turn_rate
            self.spin_left -= omega * self.period
            return 0.0, omega
        if self.back_left > 0:
            self.back_left -= 0.2 * self.period
            return -0.2, 0.0
        if self.target is None:
            self._choose(pose)
        assert self.target is not None
        away = self.target - pose[:2]
        distance = float(np.hypot(*away))
        off = wrapped(float(np.arctan2(away[1], away[0]) - pose[2]))
        if distance < 0.12:
            self._arrived(pose)
            return 0.0, 0.0
        omega = float(np.clip(1.6 * off, -self.omega_max, self.omega_max))
        v = self.speed if abs(off) < 0.5 else 0.0
        return min(v, 0.8 * distance), omega

    def _arrived(self, pose: Floats) -> None:
        self.target = None
        chance = self.rng.random()
        self.turn_rate = float(self.rng.uniform(0.3, self.omega_max))
        if chance < 0.4:
            self.spin_left = float(self.rng.choice([-1, 1]) * self.rng.uniform(2.0, 2 * np.pi))
        elif chance < 0.6:
            behind = pose[:2] - 0.5 * np.array([np.cos(pose[2]), np.sin(pose[2])])
            if self.core.contains(shapely.LineString([pose[:2], behind])):
                self.back_left = 0.4
        elif chance < 0.7:
            self.pause_left = float(self.rng.uniform(0.5, 2.0))

    def _choose(self, pose: Floats) -> None:
        self.speed = float(self.rng.uniform(0.4, 1.0) * self.v_max)
        for _ in range(200):
            point = spot_in(self.space, self.rng)
            if np.hypot(*(point - pose[:2])) < 0.5:
                continue
            if self.core.buffer(0.05).contains(shapely.LineString([pose[:2], point])):
                self.target = point
                return
        self.target = np.array(shapely.ops.nearest_points(self.space, shapely.Point(pose[:2]))[0].coords[0])
