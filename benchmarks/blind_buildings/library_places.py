"""Effects of the library: surfaces, changes of the room, and people."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.blind_buildings.draws import DEGREE, rounded, sign, size
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.people import legs
from benchmarks.blind_buildings.placing import (
    OnWall,
    Rebuilt,
    free_spot,
    location_of,
    pick_obstacle,
    pick_wall,
)
from benchmarks.blind_buildings.raycast import meet_discs, meet_moving_discs, meet_walls
from benchmarks.blind_buildings.rooms import OUTLINE, Room
from benchmarks.blind_buildings.scene import Rays, Scene


class Glass(OnWall):
    """Rays that meet a pane obliquely go through it, to a wall at some depth or to what the room has behind."""

    name = "glass"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.pick(scene)
        depth = 0.0 if scene.rng.random() < 0.25 else scene.rng.uniform(0.4, 3.0)
        returns = scene.rng.uniform(5, 32) * DEGREE
        self.parameters = rounded(a=self.part.a, b=self.part.b, alpha_ret=returns, depth=depth)

    def ideal(self, rays: Rays) -> None:
        is_through = self.part.hit_by(rays) & (rays.incidence() > self.parameters["alpha_ret"])
        if self.parameters["depth"] > 0:
            behind = rays.ranges + self.parameters["depth"] / np.maximum(rays.cosine, 1e-3)
        else:
            skipped = np.full(rays.wall.shape, self.part.wall)
            behind = meet_walls(rays.starts, rays.directions, rays.walls, skipped).ranges
        rays.ranges = np.where(is_through, behind, rays.ranges)


class Mirror(OnWall):
    """Rays are reflected."""

    name = "mirror"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.pick(scene, 0.6, 1.8)
        self.parameters = rounded(a=self.part.a, b=self.part.b)

    def ideal(self, rays: Rays) -> None:
        is_hit = self.part.hit_by(rays)
        ranges = rays.ranges.copy()
        ranges[is_hit] = rays.ranges[is_hit] + self.part.reflected(rays, is_hit)
        rays.ranges = ranges


class BlackSurface(OnWall):
    """Less comes back the farther and the more obliquely it is seen."""

    name = "black_surface"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.pick(scene, 1.0, 2.6)
        self.parameters = rounded(a=self.part.a, b=self.part.b, r0=scene.rng.uniform(0.6, 2.2))

    def ideal(self, rays: Rays) -> None:
        near = (self.parameters["r0"] / np.maximum(rays.ranges, 1e-6)) ** 2
        chance = np.minimum(1, rays.cosine * near)
        is_lost = self.part.hit_by(rays) & (rays.rng.random(rays.ranges.shape) > chance)
        rays.ranges = np.where(is_lost, np.inf, rays.ranges)


class UnmappedObstacle(Effect):
    """Something round stands where the map has nothing."""

    name = "unmapped_obstacle"

    def draw(self, scene: Scene) -> None:
        radius = size(scene, 0.02, 2.5)
        x, y = free_spot(scene, radius)
        self.parameters = rounded(x=x, y=y, r=radius)
        self.location = {"name": None, "xy": [self.parameters["x"], self.parameters["y"]]}

    def ideal(self, rays: Rays) -> None:
        disc = np.array([[self.parameters[key] for key in ("x", "y", "r")]])
        rays.ranges = np.minimum(rays.ranges, meet_discs(rays.starts, rays.directions, disc))


class MovedObstacle(Rebuilt):
    """A piece of furniture stands elsewhere."""

    name = "moved_obstacle"

    def draw(self, scene: Scene) -> None:
        self.moved = pick_obstacle(scene, 0.025)
        shift, angle = size(scene, 0.01, 2), scene.rng.uniform(-math.pi, math.pi)
        self.parameters = rounded(dx=shift * math.cos(angle), dy=shift * math.sin(angle))
        self.location = location_of(scene, self.moved)

    def change(self, room: Room) -> None:
        shift = (self.parameters["dx"], self.parameters["dy"])
        room.rings[self.moved] = room.rings[self.moved] + shift


class MissingObstacle(Rebuilt):
    """A piece of furniture is gone."""

    name = "missing_obstacle"

    def draw(self, scene: Scene) -> None:
        self.gone = pick_obstacle(scene, 0.02)
        self.location = location_of(scene, self.gone)

    def change(self, room: Room) -> None:
        del room.rings[self.gone]


class MovedWall(Rebuilt):
    """A wall of the outline stands farther out or in."""

    name = "moved_wall"

    def draw(self, scene: Scene) -> None:
        part = pick_wall(scene, least_share=0.06)
        self.edge = part.edge
        self.location = part.location
        self.parameters = rounded(d=sign(scene) * size(scene, 0.01))

    def change(self, room: Room) -> None:
        ring = room.rings[OUTLINE]
        first, last = self.edge, (self.edge + 1) % len(ring)
        along = ring[last] - ring[first]
        outward = np.array([along[1], -along[0]]) / np.hypot(*along)
        ring[first] += outward * self.parameters["d"]
        ring[last] += outward * self.parameters["d"]


class MapScale(Rebuilt):
    """The map is of another scale, and a little off."""

    name = "map_scale"

    def draw(self, scene: Scene) -> None:
        scale = sign(scene) * size(scene, 0.002)
        dx, dy = scene.rng.normal(0, 0.003), scene.rng.normal(0, 0.003)
        self.parameters = rounded(s=scale, dx=dx, dy=dy)

    def change(self, room: Room) -> None:
        outline = self.scene.plan.rings[OUTLINE]
        middle = (outline.min(0) + outline.max(0)) / 2
        shift = (self.parameters["dx"], self.parameters["dy"])
        for name, ring in room.rings.items():
            room.rings[name] = middle + (1 + self.parameters["s"]) * (ring - middle) + shift


class People(Effect):
    """One to three people walk about for a while."""

    name = "people"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        n = int(scene.rng.integers(1, 4))
        comes = scene.rng.uniform(0, 0.4, n) * scene.duration
        self.present = [(one, one + scene.rng.uniform(0.3, 0.7) * scene.duration) for one in comes]
        self.state = scene.rng.bit_generator.state
        self.parameters = {"p": None}

    def ideal(self, rays: Rays) -> None:
        rng = np.random.default_rng()
        rng.bit_generator.state = self.state  # the same walk, however often it is looked at
        discs = legs(self.scene, rng, rays.taken.ravel(), self.present)
        ranges = meet_moving_discs(rays.starts, rays.directions, discs)
        self.parameters = rounded(p=(ranges < rays.ranges).mean())
        rays.ranges = np.minimum(rays.ranges, ranges)
