"""Effects of the library: wheels, clock of the odometry and motors; surfaces, changes of the room, and people."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.hidden_effects.geometry import with_edge_moved
from benchmarks.hidden_effects.worlds.floors.base import follow, lagged
from benchmarks.hidden_effects.worlds.floors.effect import DEGREE, Effect, law, rounded, sign, signed, size
from benchmarks.hidden_effects.worlds.floors.placing import (
    OnWall,
    Rebuilt,
    free_spot,
    legs,
    location_of,
    pick_obstacle,
    pick_wall,
)
from benchmarks.hidden_effects.worlds.floors.rooms import OUTLINE, Room
from benchmarks.hidden_effects.worlds.floors.scene import (
    PHI,
    BaseState,
    Rays,
    Scene,
    V,
    X,
    meet_discs,
    meet_moving_discs,
    meet_walls,
)

law(
    "wheel_radius",
    lambda scene: {"s": signed(scene, 0.005)},
    "odometry",
    ground=lambda p, state, left, right: (left / (1 + p["s"]), right / (1 + p["s"])),
)
law(
    "wheel_radius_diff",
    lambda scene: {"s": signed(scene, 0.003)},
    "odometry",
    ground=lambda p, state, left, right: (left / (1 - p["s"] / 2), right / (1 + p["s"] / 2)),
)
law(
    "wheel_base",
    lambda scene: {"s": signed(scene, 0.006)},
    "odometry",
    true_track=lambda p, track: track / (1 + p["s"]),
)


class WheelSlip(Effect, name="wheel_slip", channel="odometry"):
    """Each wheel slips where it stands on a slippery patch."""

    def draw(self, scene: Scene) -> None:
        radius = scene.rng.uniform(0.45, 0.9)
        track = scene.run[::50]
        track = track[np.abs(track[:, V]) > 0.15 * scene.robot.v][:, X:PHI]
        n_near = np.array([(np.hypot(*(track - place).T) < radius).sum() for place in track])
        x, y = track[scene.rng.choice(np.flatnonzero(n_near >= np.quantile(n_near, 0.6)))]
        self.parameters = rounded(s=size(scene, 0.05), x=x, y=y, r=radius)
        self.location = {"name": None, "xy": [self.parameters["x"], self.parameters["y"]]}

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        half = state.setup.robot.wheel_base / 2
        grip = 1 - self.parameters["s"]
        return (
            left * (grip if self._is_on(state, half) else 1),
            right * (grip if self._is_on(state, -half) else 1),
        )

    def _is_on(self, state: BaseState, off: float) -> bool:
        """Return whether a wheel [m] left of the middle stands on the patch."""
        dx = state.x - math.sin(state.phi) * off - self.parameters["x"]
        dy = state.y + math.cos(state.phi) * off - self.parameters["y"]
        return bool(math.hypot(dx, dy) < self.parameters["r"])


law(
    "pose_clock_offset",
    lambda scene: {"tau": (1 if scene.rng.random() < 0.8 else -1) * size(scene, 0.005, 2.5)},
    "odometry",
    read_times=lambda p, t: np.clip(t - p["tau"], 0, None),
)


class ActuatorLag(Effect, name="actuator_lag", channel="drive"):
    """Motors follow more slowly."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(tau=size(scene, 0.015, 2.5))
        second = scene.background.second_lag
        self.lags = (follow(scene.robot.tau + self.parameters["tau"]), follow(second) if second else 1.0)

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        return lagged(state, left, right, self.lags)


def _draw_fastest(scene: Scene) -> Mapping[str, float]:
    fastest = np.abs(scene.commands[:, 1]).max()
    return {"v_max": min(fastest - 0.034, fastest * scene.rng.uniform(0.6, 0.88))}


law("dead_time", lambda scene: {"L": size(scene, 0.02, 2.2)}, "drive", command_age=lambda p, t: p["L"])
law(
    "speed_saturation",
    _draw_fastest,
    "drive",
    target=lambda p, state, v, omega: (max(-p["v_max"], min(p["v_max"], v)), omega),
)


class Glass(OnWall, name="glass"):
    """Rays that meet a pane obliquely go through it, to a wall at some depth or to what the room has behind."""

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
            skipped = np.full(rays.wall.shape, self.part.edge)
            behind = meet_walls(rays.starts, rays.directions, rays.walls, skipped).ranges
        rays.ranges = np.where(is_through, behind, rays.ranges)


class Mirror(OnWall, name="mirror"):
    """Rays are reflected."""

    def draw(self, scene: Scene) -> None:
        self.pick(scene, 0.6, 1.8)
        self.parameters = rounded(a=self.part.a, b=self.part.b)

    def ideal(self, rays: Rays) -> None:
        is_hit = self.part.hit_by(rays)
        ranges = rays.ranges.copy()
        ranges[is_hit] = rays.ranges[is_hit] + self.part.reflected(rays, is_hit)
        rays.ranges = ranges


class BlackSurface(OnWall, name="black_surface"):
    """Less comes back the farther and the more obliquely it is seen."""

    def draw(self, scene: Scene) -> None:
        self.pick(scene, 1.0, 2.6)
        self.parameters = rounded(a=self.part.a, b=self.part.b, r0=scene.rng.uniform(0.6, 2.2))

    def ideal(self, rays: Rays) -> None:
        near = (self.parameters["r0"] / np.maximum(rays.ranges, 1e-6)) ** 2
        chance = np.minimum(1, rays.cosine * near)
        is_lost = self.part.hit_by(rays) & (rays.rng.random(rays.ranges.shape) > chance)
        rays.ranges = np.where(is_lost, np.inf, rays.ranges)


class UnmappedObstacle(Effect, name="unmapped_obstacle"):
    """Something round stands where the map has nothing."""

    def draw(self, scene: Scene) -> None:
        radius = size(scene, 0.02, 2.5)
        x, y = free_spot(scene, radius)
        self.parameters = rounded(x=x, y=y, r=radius)
        self.location = {"name": None, "xy": [self.parameters["x"], self.parameters["y"]]}

    def ideal(self, rays: Rays) -> None:
        disc = np.array([[self.parameters[key] for key in ("x", "y", "r")]])
        rays.ranges = np.minimum(rays.ranges, meet_discs(rays.starts, rays.directions, disc))


class MovedObstacle(Rebuilt, name="moved_obstacle"):
    """A piece of furniture stands elsewhere."""

    def draw(self, scene: Scene) -> None:
        self.moved = pick_obstacle(scene, 0.025)
        shift, angle = size(scene, 0.01, 2), scene.rng.uniform(-math.pi, math.pi)
        self.parameters = rounded(dx=shift * math.cos(angle), dy=shift * math.sin(angle))
        self.location = location_of(scene, self.moved)

    def changed(self, room: Room) -> Room:
        shift = (self.parameters["dx"], self.parameters["dy"])
        return room.with_ring(self.moved, room.rings[self.moved] + shift)


class MissingObstacle(Rebuilt, name="missing_obstacle"):
    """A piece of furniture is gone."""

    def draw(self, scene: Scene) -> None:
        self.gone = pick_obstacle(scene, 0.02)
        self.location = location_of(scene, self.gone)

    def changed(self, room: Room) -> Room:
        return room.with_ring(self.gone, None)


class MovedWall(Rebuilt, name="moved_wall"):
    """A wall of the outline stands farther out or in."""

    def draw(self, scene: Scene) -> None:
        part = pick_wall(scene, least_share=0.06)
        self.edge = part.edge
        self.location = part.location
        self.parameters = rounded(d=sign(scene) * size(scene, 0.01))

    def changed(self, room: Room) -> Room:
        return room.with_ring(OUTLINE, with_edge_moved(room.outer, self.edge, self.parameters["d"]))


class MapScale(Rebuilt, name="map_scale"):
    """The map is of another scale, and a little off."""

    def draw(self, scene: Scene) -> None:
        scale = sign(scene) * size(scene, 0.002)
        dx, dy = scene.rng.normal(0, 0.003), scene.rng.normal(0, 0.003)
        self.parameters = rounded(s=scale, dx=dx, dy=dy)

    def changed(self, room: Room) -> Room:
        outline = self.scene.plan.outer
        middle = (outline.min(0) + outline.max(0)) / 2
        shift, scale = (self.parameters["dx"], self.parameters["dy"]), 1 + self.parameters["s"]
        return room.changed(lambda _, ring: middle + scale * (ring - middle) + shift)


class People(Effect, name="people"):
    """One to three people walk about for a while."""

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
