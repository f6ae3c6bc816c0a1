"""Foreign effects of the building and of things in it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from shapely.geometry import LineString, Point, Polygon

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.geometry import edges_of
from benchmarks.hidden_effects.log import Booleans, Floats
from benchmarks.hidden_effects.worlds.floors.effect import Effect, even, rounded
from benchmarks.hidden_effects.worlds.floors.placing import OnWall, Rebuilt, free_spot, is_passed
from benchmarks.hidden_effects.worlds.floors.rooms import OUTLINE, Room, rectangle
from benchmarks.hidden_effects.worlds.floors.scene import PHI, Rays, Scene, X, meet_discs, meet_walls

REFRACTION = 1.5
"""Index of glass."""
N_LEGS = 5
"""Of a chair, besides its column."""
N_STRIPES = 400
"""More than there are walls."""


class HalfMirror(OnWall, name="g_halfmirror"):
    """A pane returns itself, or by Fresnel the mirrored room; near mirror/glass."""

    def draw(self, scene: Scene) -> None:
        self.pick(scene, 1.4, 3.0, 0.08)
        self.parameters = rounded(a=self.part.a, b=self.part.b, n=REFRACTION, gain=even(scene, 5, 9))

    def ideal(self, rays: Rays) -> None:
        is_hit = self.part.hit_by(rays)
        inside, n = np.clip(rays.cosine[is_hit], 1e-6, 1), REFRACTION
        beyond = np.sqrt(1 - (1 - inside**2) / n**2)
        across = ((inside - n * beyond) / (inside + n * beyond)) ** 2
        along = ((n * inside - beyond) / (n * inside + beyond)) ** 2
        reflected = self.part.reflected(rays, is_hit)
        chance = np.minimum(0.9, self.parameters["gain"] * (0.5 * (across + along)))
        is_ghost = rays.rng.random(len(inside)) < chance
        ranges = rays.ranges.copy()
        ranges[is_hit] = np.where(is_ghost, ranges[is_hit] + reflected, ranges[is_hit])
        rays.ranges = ranges


class Chairs(Effect, name="g_chairs"):
    """Thin-legged chairs, dragged to new places every so often; near unmapped_obstacle/people."""

    def draw(self, scene: Scene) -> None:
        n = int(scene.rng.integers(4, 6))
        self.every = even(scene, 18, 30)
        self.leg = even(scene, 0.016, 0.025)
        n_times = int(scene.duration / self.every) + 1
        self.spots = np.array([[free_spot(scene, 0.28) for _ in range(n_times)] for _ in range(n)])
        self.yaws = scene.rng.uniform(0, 6, (n, n_times))
        self.parameters = rounded(chairs=n, leg=self.leg, every=self.every)

    def ideal(self, rays: Rays) -> None:
        n_times = self.spots.shape[1]
        at = np.minimum((rays.taken / self.every).astype(int), n_times - 1)
        ranges = rays.ranges
        for k in range(n_times):
            discs = []
            for (x, y), yaw in zip(self.spots[:, k], self.yaws[:, k], strict=True):
                for leg in range(N_LEGS):
                    angle = yaw + leg * 2 * math.pi / N_LEGS
                    at_x, at_y = x + 0.26 * math.cos(angle), y + 0.26 * math.sin(angle)
                    discs.append([at_x, at_y, self.leg])
                discs.append([x, y, self.leg * 1.4])
            short = np.minimum(ranges, meet_discs(rays.starts, rays.directions, np.array(discs)))
            ranges = np.where(at == k, short, ranges)
        rays.ranges = ranges


class Posters(Effect, name="g_posters"):
    """Striped prints: dark reads long, white short, on several walls; near moved_wall/range_bias."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(b=even(scene, 0.03, 0.06), period=even(scene, 0.3, 0.7), share=0.5)
        self.shifts = scene.rng.uniform(0, 1, N_STRIPES)
        self.chances = scene.rng.random(N_STRIPES)

    def ideal(self, rays: Rays) -> None:
        wall = rays.wall % N_STRIPES
        stripe = np.floor(rays.along / self.parameters["period"] * 2 + self.shifts[wall]).astype(int) % 3
        bias = np.array([1.0, -0.7, 0.0])[stripe] * self.parameters["b"]
        is_printed = self.chances[wall] < self.parameters["share"]
        rays.ranges = rays.ranges + np.where(is_printed, bias, 0)


class Added(Effect):
    """Things of straight walls that the map lacks."""

    def add(self, rays: Rays, rings: Sequence[Floats], is_there: Booleans | None = None) -> None:
        """Shorten rays that meet rings (n, 2) [m] while they are there."""
        walls = np.vstack([edges_of(ring) for ring in rings])
        short = np.minimum(rays.ranges, meet_walls(rays.starts, rays.directions, walls).ranges)
        rays.ranges = short if is_there is None else np.where(is_there, short, rays.ranges)


class Radiators(Added, name="g_radiators"):
    """Map of another level: radiators and ducts stand before many walls at the height of the laser; near
    moved_wall/unmapped_obstacle.
    """

    def draw(self, scene: Scene) -> None:
        self.rings: list[Floats] = []
        outline = scene.room.rings[OUTLINE]
        for first, last in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            length = float(np.hypot(*(last - first)))
            if length >= 1.0:
                self._line(scene, first, (last - first) / length, length)
        if not self.rings:
            raise Redraw("no wall is long enough")
        self.parameters = rounded(n=len(self.rings), depth=0.1)

    def _line(self, scene: Scene, first: Floats, along: Floats, length: float) -> None:
        """Put boxes along a wall [m] where the robot does not drive."""
        inward = np.array([-along[1], along[0]])
        begins = 0.2
        while begins < length - 0.7:
            width = min(even(scene, 0.6, 1.4), length - begins - 0.15)
            depth = even(scene, 0.07, 0.13)
            one, other = first + along * begins, first + along * (begins + width)
            ring = np.array([one, one + inward * depth, other + inward * depth, other])
            if scene.rng.random() < 0.6 and is_passed(scene, Polygon(ring)):
                self.rings.append(ring)
            begins += width + even(scene, 0.3, 1.0)

    def ideal(self, rays: Rays) -> None:
        self.add(rays, self.rings)


class Plaster(Rebuilt, name="g_plaster", d=(0.03, 0.05)):
    """Plan of the raw building: all walls have a lining, free space is smaller all around; near
    range_bias/map_scale.
    """

    def changed(self, room: Room) -> Room:
        def lined(name: str, ring: Floats) -> Floats:
            if name in room.furniture:
                return ring
            edge = np.roll(ring, -1, 0) - ring
            length = np.hypot(*edge.T)[:, None]
            after = np.column_stack([-edge[:, 1], edge[:, 0]]) / length * (1 if name == OUTLINE else -1)
            before = np.roll(after, 1, 0)
            blunt = 1 + (after * before).sum(1, keepdims=True)
            corner = np.where(blunt > 0.2, (after + before) / np.maximum(blunt, 0.2), after)
            return np.asarray(ring + corner * self.parameters["d"])

        return room.changed(lined)


class Cart(Added, name="g_cart"):
    """A trolley parks here, then there, then elsewhere; near unmapped_obstacle/people."""

    def draw(self, scene: Scene) -> None:
        self.rings: list[Floats] = []
        for _ in range(int(scene.rng.integers(2, 4))):
            for _ in range(60):
                x, y = free_spot(scene, 0.3)
                length, width = even(scene, 0.5, 0.8), even(scene, 0.35, 0.5)
                cart = rectangle(x, y, length, width, even(scene, 0, 3.1))
                if is_passed(scene, cart):
                    self.rings.append(np.array(cart.exterior.coords)[:-1])
                    break
        if not self.rings:
            raise Redraw("no place for a trolley")
        n = len(self.rings)
        self.parameters = rounded(places=n, every=scene.duration / max(2, n))

    def ideal(self, rays: Rays) -> None:
        every = self.parameters["every"]
        for i, ring in enumerate(self.rings):
            is_there = (rays.taken >= i * every) & (rays.taken < (i + 1) * every)
            self.add(rays, [ring], is_there)


class Overhang(Rebuilt, name="g_overhang", d=(0.07, 0.11)):
    """At the height of the laser all furniture is larger by its table tops; near moved_obstacle."""

    def changed(self, room: Room) -> Room:
        def larger(name: str, ring: Floats) -> Floats:
            if name not in room.furniture:
                return ring
            grown = Polygon(ring).buffer(self.parameters["d"], join_style="mitre")
            return np.array(grown.exterior.coords)[:-1]

        return room.changed(larger)


class Pipes(Effect, name="g_pipes"):
    """Risers and boxed columns in the corners of the plan; near unmapped_obstacle, many at once."""

    def draw(self, scene: Scene) -> None:
        outline = scene.room.rings[OUTLINE]
        way = LineString(scene.run[::50, X:PHI])
        discs = []
        for i, corner in enumerate(outline):
            before, after = corner - outline[i - 1], outline[(i + 1) % len(outline)] - corner
            lengths = np.hypot(*before), np.hypot(*after)
            turn = before[0] * after[1] - before[1] * after[0]
            if turn > 0.6 * lengths[0] * lengths[1] and min(lengths) > 0.5:
                radius = even(scene, 0.12, 0.25)
                if way.distance(Point(corner)) > radius + scene.robot.footprint:
                    discs.append([corner[0], corner[1], radius])
        if len(discs) < 2:
            raise Redraw("too few corners")
        self.discs = np.array(discs)
        self.parameters = rounded(n=len(discs), r=self.discs[:, 2].mean())

    def ideal(self, rays: Rays) -> None:
        rays.ranges = np.minimum(rays.ranges, meet_discs(rays.starts, rays.directions, self.discs))
