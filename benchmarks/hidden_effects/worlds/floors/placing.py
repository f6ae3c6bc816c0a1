"""Where effects are put: a part of a wall, a thing, a spot of the floor, people on two legs; and a plane that dips."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.log import Booleans, Floats
from benchmarks.hidden_effects.worlds.floors.effect import Effect
from benchmarks.hidden_effects.worlds.floors.rooms import OUTLINE, Room
from benchmarks.hidden_effects.worlds.floors.scene import PHI, Rays, Scene, X, meet_walls, pose_at

SHORTEST_WALL = 0.7
"""[m] that gets an effect."""
MOST_ATTEMPTS = 4000


@dataclass(frozen=True, kw_only=True)
class WallPart:
    """A part of a wall of the outline."""

    edge: int
    """Index of the wall."""
    a: float
    b: float
    """[m] from the wall's first end."""

    @property
    def location(self) -> dict[str, Any]:
        """As the truth tells it."""
        return {"name": f"{OUTLINE}/edge_{self.edge}", "xy": None}

    def hit_by(self, rays: Rays) -> Booleans:
        """Return which rays end on it."""
        return np.asarray((rays.wall == self.edge) & (rays.along >= self.a) & (rays.along <= self.b))

    def reflected(self, rays: Rays, is_hit: Booleans) -> Floats:
        """Return the ranges [m] from the wall to what the rays that hit it (n,) meet as in a mirror."""
        ends = rays.walls[self.edge]
        along = np.array([ends[2] - ends[0], ends[3] - ends[1]])
        along /= np.hypot(*along)
        angle = math.atan2(along[1], along[0])
        directions = rays.directions[is_hit]
        ahead = np.stack([np.cos(directions), np.sin(directions)], -1)
        starts = rays.starts[is_hit] + rays.ranges[is_hit][:, None] * ahead
        skipped = np.full(len(directions), self.edge)
        return meet_walls(starts, 2 * angle - directions, rays.walls, skipped).ranges


def pick_wall(
    scene: Scene, shortest: float = 0.8, longest: float = 2.4, least_share: float = 0.04
) -> WallPart:
    """Draw a part [m] of a wall on which at least this share of the rays ends."""
    hits = scene.hits
    seen = []
    for edge in range(len(scene.room.outer)):  # whose walls come first
        x0, y0, x1, y1 = hits.walls[edge]
        length = math.hypot(x1 - x0, y1 - y0)
        if length > SHORTEST_WALL:
            seen.append((float((hits.wall == edge).mean()), edge, length))
    seen.sort(reverse=True)
    good = [one for one in seen if one[0] >= least_share] or seen[:2]
    _, edge, length = good[scene.rng.integers(len(good))]
    along = hits.along[hits.wall == edge]
    half = min(length / 2, scene.rng.uniform(shortest, longest) / 2)
    middle = float(np.clip(scene.rng.choice(along), half, length - half))
    return WallPart(edge=edge, a=round(middle - half, 3), b=round(middle + half, 3))


class OnWall(Effect):
    """An effect of a part of a wall."""

    part: WallPart

    def pick(
        self, scene: Scene, shortest: float = 0.8, longest: float = 2.4, least_share: float = 0.04
    ) -> None:
        """Draw the part."""
        self.part = pick_wall(scene, shortest, longest, least_share)
        self.location = self.part.location


class Rebuilt(Effect):
    """The true room is not that of the map."""

    def changed(self, room: Room) -> Room:
        """Return the room as it is."""
        raise NotImplementedError

    def meet(self, rays: Rays) -> None:
        """Let rays meet the walls of the changed room."""
        rays.walls = self.changed(self.scene.room).walls
        rays.meet()


def pick_obstacle(scene: Scene, least_share: float) -> str:
    """Draw a piece of furniture at which at least this share of the rays ends."""
    names, walls = scene.room.furniture, scene.room.wall_names
    shares = {
        name: np.isin(
            scene.hits.wall, [j for j, wall in enumerate(walls) if wall.startswith(f"{name}/")]
        ).mean()
        for name in names
    }
    good = [name for name in names if shares[name] >= least_share]
    good = good or sorted(names, key=lambda name: shares[name])[-2:]
    return good[scene.rng.integers(len(good))]


def location_of(scene: Scene, name: str) -> dict[str, Any]:
    """Return where a thing of the map is, as the truth tells it."""
    return {"name": name, "xy": [round(float(one), 3) for one in scene.plan.rings[name].mean(0)]}


def free_spot(scene: Scene, radius: float, farthest: float = 1.2) -> tuple[float, float]:
    """Draw the middle [m] of something round [m] beside the way of the robot."""
    floor = scene.room.free()
    free = floor.buffer(-radius - 0.04)
    way = LineString(scene.run[::100, X:PHI])
    near, far = scene.robot.footprint + radius + 0.04, scene.robot.footprint + radius + farthest
    x0, y0, x1, y1 = free.bounds

    def draw() -> Point:
        return Point(scene.rng.uniform(x0, x1), scene.rng.uniform(y0, y1))

    for _ in range(MOST_ATTEMPTS):
        spot = draw()
        distance = spot.distance(way)
        if free.contains(spot) and near < distance < far:
            return spot.x, spot.y
    shapely.prepare(floor)
    for _ in range(MOST_ATTEMPTS):
        spot = draw()
        if floor.contains(spot) and spot.distance(way) > scene.robot.footprint * 0.8 + radius:
            return spot.x, spot.y
    raise Redraw("no spot")


def is_passed(scene: Scene, thing: BaseGeometry) -> bool:
    """Return whether the robot drives by, and not over a thing."""
    way = LineString(scene.run[::50, X:PHI])
    return bool(way.distance(thing) > scene.robot.footprint * 0.95)


def dip(rays: Rays, angle: Floats | float, deepest: float, height: float) -> None:
    """Let rays lie in a plane that dips by an angle [rad] at one bearing [rad]; it meets the floor [m] below."""
    off = rays.bearings - deepest
    c, s = np.cos(off), np.sin(off)
    ahead = c * np.cos(angle)
    level = np.hypot(ahead, s)
    rays.directions = rays.directions - rays.bearings + deepest + np.arctan2(s, ahead)
    rays.meet()
    down = np.sin(angle) * c
    floor = np.where(down > 1e-9, height / np.maximum(down, 1e-9), np.inf)
    rays.ranges = np.minimum(rays.ranges / level, floor)


STRIDE = 0.25
"""[m] by which a leg is ahead or behind at most."""
HIPS = 0.11
"""[m] from the middle to a leg."""
MOMENT = 0.1
"""[s] over which a walker's direction is taken."""
BESIDE = 0.4
"""[m] that people keep to the robot."""


def legs(scene: Scene, rng: np.random.Generator, t: Floats, present: Sequence[tuple[float, float]]) -> Floats:
    """Return the legs (n_times, 2 n_people, 3) [m] x, y and radius, 0 while nobody is there.

    Parameters
    ----------
    t : (n_times,) [s]
    present : of each person, when it comes and goes [s]
    """
    found = np.zeros((t.size, 2 * len(present), 3))
    robot_x, robot_y, _ = pose_at(scene.run, t)
    for k, (comes, goes) in enumerate(present):
        times, places = _walk(scene, rng)
        x, y = np.interp(t, times, places[:, 0]), np.interp(t, times, places[:, 1])
        vx = np.interp(t + MOMENT, times, places[:, 0]) - x
        vy = np.interp(t + MOMENT, times, places[:, 1]) - y
        v = np.hypot(vx, vy) + 1e-9
        ux, uy = np.where(v > 1e-6, vx / v, 1), np.where(v > 1e-6, vy / v, 0)
        swing = STRIDE * np.sin(2 * np.pi * 1.0 * t) * np.minimum(1, v / 0.05)
        radius = rng.uniform(0.06, 0.09)
        is_away = np.hypot(robot_x - x, robot_y - y) > scene.robot.footprint + BESIDE
        is_there = (t > comes) & (t < goes) & is_away
        for leg, side in ((0, 1), (1, -1)):
            found[:, 2 * k + leg, 0] = x + ux * swing * side - uy * HIPS * side
            found[:, 2 * k + leg, 1] = y + uy * swing * side + ux * HIPS * side
            found[:, 2 * k + leg, 2] = np.where(is_there, radius, 0)
    return found


def _walk(scene: Scene, rng: np.random.Generator) -> tuple[list[float], Floats]:
    """Return times [s] and places (n, 2) [m] of one who goes from cell to cell, with pauses."""
    ways = scene.ways
    places = [ways.place(int(rng.integers(len(ways.cells))))]
    times = [0.0]
    while times[-1] < scene.duration:
        path = ways.path(places[-1][0], places[-1][1], int(rng.integers(len(ways.cells))))
        lengths = np.hypot(*np.diff(path, axis=0).T)
        speed = rng.uniform(0.5, 1.2)
        for place, length in zip(path[1:], lengths, strict=True):
            times.append(times[-1] + length / speed + 1e-6)
            places.append(place)
        times.append(times[-1] + rng.uniform(0.5, 4))
        places.append(places[-1])
    return times, np.array(places)
