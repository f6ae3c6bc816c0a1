"""A laser in a room of MuJoCo: walls are boxes and prisms, rays are `mj_multiRay`, faults come after the cast."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.geometry import Room, interpolated, outward, spot_in, wrapped
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.simulators.hidden import PARTS, Secrets
from benchmarks.hidden_effects.worlds.simulators.mujoco_drive import LASER_HEIGHT, Driven
from benchmarks.hidden_effects.worlds.simulators.rooms import OUTER

THICKNESS, HEIGHT = 0.1, 1.2
SOLID, PART = 0, 1
"""Geom groups: walls, and the part of one that an effect covers."""
PERSON = 0.22
"""[m] radius."""
Casts = tuple[Floats, Floats, NDArray[np.int32]]


@dataclass(frozen=True, kw_only=True)
class Laser:
    """A laser as robot.yaml describes it, and its true place."""

    mount: tuple[float, float, float] = (0.10, 0.0, 0.0)
    off: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """By how much the mount is not as stated."""
    n_rays: int = 181
    fov: float = 4.0
    range_min: float = 0.05
    range_max: float = 8.0
    sigma: float = 0.01
    resolution: float = 0.001
    rate: float = 5.0

    @property
    def bearings(self) -> Floats:
        """(n_rays,) [rad]"""
        return np.linspace(-self.fov / 2, self.fov / 2, self.n_rays)


class World:
    """Walls of a room as geoms, with a body for each person."""

    def __init__(self, room: Room, secrets: Secrets, people: int = 0) -> None:
        self.part = next((one for one in secrets.all if one.name in PARTS), None)
        spec = mujoco.MjSpec()
        for name in room.wall_names:
            if name.startswith(OUTER):
                self._wall(spec, name, *room.edge(name))
        for name in room.obstacles:
            ring = room.rings[name]
            ends = [np.column_stack([ring, np.full(len(ring), z)]) for z in (0.0, HEIGHT)]
            spec.add_mesh(name=name, uservert=np.concatenate(ends).ravel())
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, group=SOLID)
        for k in range(people):
            body = spec.worldbody.add_body(name=f"person_{k}", mocap=True)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[PERSON, HEIGHT / 2, 0], group=SOLID)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.part_geoms = np.flatnonzero(self.model.geom_group == PART)

    def _wall(self, spec: mujoco.MjSpec, name: str, a: Floats, b: Floats) -> None:
        if self.part is None or self.part.place != name:
            self._box(spec, a, b, SOLID)
            return
        along = (b - a) / np.hypot(*(b - a))
        first, last = a + self.part["a"] * along, a + self.part["b"] * along
        self._box(spec, a, first, SOLID)
        self._box(spec, first, last, PART)
        self._box(spec, last, b, SOLID)
        if "depth" in self.part.parameters:
            behind = outward(a, b) * self.part["depth"]
            self._box(spec, first + behind - 4 * along, last + behind + 4 * along, SOLID)

    @staticmethod
    def _box(spec: mujoco.MjSpec, a: Floats, b: Floats, group: int) -> None:
        along, middle = b - a, (a + b) / 2
        length = float(np.hypot(*along))
        x, y = middle + outward(a, b) * THICKNESS / 2
        yaw = float(np.arctan2(along[1], along[0]))
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[float(x), float(y), HEIGHT / 2],
            quat=[np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)],
            size=[length / 2, THICKNESS / 2, HEIGHT / 2],
            group=group,
        )

    def place_people(self, spots: Floats) -> None:
        """Put the people (n, 2) [m] where they are now."""
        self.data.mocap_pos[:] = np.column_stack([spots, np.full(len(spots), HEIGHT / 2)])
        mujoco.mj_kinematics(self.model, self.data)

    def cast(self, origin: Floats, angles: Floats, *, with_part: bool = True) -> Casts:
        """Cast rays from a point (2,) at angles (n,) [rad, map]; return ranges, incidences and geoms."""
        n = len(angles)
        aim = np.stack([np.cos(angles), np.sin(angles), np.zeros(n)], axis=1)
        groups = np.array([1, int(with_part), 0, 0, 0, 0], dtype=np.uint8)
        geoms, ranges, normals = np.full(n, -1, dtype=np.int32), np.zeros(n), np.zeros(3 * n)
        mujoco.mj_multiRay(
            self.model, self.data, np.array([*origin, LASER_HEIGHT]), aim.ravel(), groups, True, -1,
            geoms, ranges, normals, n, 100.0,
        )  # fmt: skip
        cosine = np.abs((aim * normals.reshape(n, 3)).sum(axis=1))
        return np.where(ranges < 0, np.inf, ranges), np.arccos(np.clip(cosine, 0, 1)), geoms

    def on_part(self, geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Tell which rays met the part of a wall that an effect covers."""
        return np.isin(geoms, self.part_geoms)


def walkers(room: Room, count: int, stamps: Floats, rng: np.random.Generator) -> Floats:
    """Let people walk between random points at 0.7 m/s, (n_stamps, count, 2) [m]."""
    free = room.free().buffer(-(PERSON + 0.05))
    tracks = []
    for _ in range(count):
        corners = np.array([spot_in(free, rng) for _ in range(40)])
        when = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T)) / 0.7])
        tracks.append(interpolated(stamps, when, corners))
    return np.stack(tracks, axis=1)


def raw_ranges(
    world: World, origin: Floats, angles: Floats, secrets: Secrets, share: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return ranges and incidences of one scan before the laser's own errors; `share` of the run has passed."""
    ranges, incidence, geoms = world.cast(origin, angles)
    part, on = world.part, world.on_part(geoms)
    if part is None or not on.any():
        return ranges, incidence
    if part.name == "glass":
        through = on & (incidence > part["alpha_ret"])
        ranges = np.where(through, world.cast(origin, angles, with_part=False)[0], ranges)
    elif part.name == "door_opens" and share > part["when"]:
        ranges = np.where(on, world.cast(origin, angles, with_part=False)[0], ranges)
    elif part.name == "black_surface":
        chance = np.minimum(1.0, np.cos(incidence) * (part["r0"] / np.maximum(ranges, 1e-3)) ** 2)
        ranges = np.where(on & (rng.random(len(ranges)) > chance), np.inf, ranges)
    elif part.name == "mirror":
        ranges = np.where(on, _reflected(world, origin, angles, ranges, on), ranges)
    return ranges, incidence


def _reflected(world: World, origin: Floats, angles: Floats, ranges: Floats, on: NDArray[np.bool_]) -> Floats:
    assert world.part is not None
    k = int(world.part_geoms[0])
    yaw = 2 * np.arctan2(world.model.geom_quat[k, 3], world.model.geom_quat[k, 0])
    out = ranges.copy()
    for i in np.flatnonzero(on):
        hit = origin + (ranges[i] - 1e-4) * np.array([np.cos(angles[i]), np.sin(angles[i])])
        out[i] = ranges[i] + world.cast(hit, np.array([2 * yaw - angles[i]]))[0][0]
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Scanner:
    """The laser on its way through a room."""

    driven: Driven
    room: Room
    laser: Laser
    secrets: Secrets
    dirty: bool
    """Stamps jitter by 3 ms, a tenth of the noise has 2.5 times the width, 0.1 % of the rays are lost."""
    rng: np.random.Generator

    def scans(self, stamps: Floats) -> Floats:
        """Return what the laser logs (n_scans, n_rays) [m], a little off the stamps (n_scans,) [s] of the scans."""
        laser, secrets, rng = self.laser, self.secrets, self.rng
        count = round(secrets.value("people", "count"))
        world = World(self.room, secrets, count)
        people = walkers(self.room, count, stamps, rng) if count else None
        taken = stamps - secrets.value("latency", "tau")
        if self.dirty:
            taken = taken + 0.003 * rng.normal(size=len(stamps))
        late = secrets.get("late_stamps")
        if late is not None:
            taken = taken - late["late"] * (rng.random(len(stamps)) < late["share"])
        mount = np.array(laser.mount) + laser.off + secrets.mount
        curtain, knocked = secrets.get("curtain"), secrets.get("laser_knocked")
        bearings = laser.bearings * (1 + secrets.value("bearing_stretch", "s"))
        out = np.zeros((len(stamps), laser.n_rays))
        for k, when in enumerate(taken):
            if people is not None:
                world.place_people(people[k])
            at = mount.copy()
            if knocked is not None and when / self.driven.times[-1] > knocked["when"]:
                at[2] += knocked["yaw"]
            z, incidence = self._sweep(world, at, bearings, when)
            origin, angles = self._rays(at, bearings, when)
            if curtain is not None:
                on = world.on_part(world.cast(origin, angles)[2])
                sway = curtain["sway"] * np.sin(2 * np.pi * when / curtain["period"])
                z = z + on * sway / np.cos(incidence)
            out[k] = self._measured(z, incidence, when, angles)
        return out

    def _rays(self, mount: Floats, bearings: Floats, when: float) -> tuple[Floats, Floats]:
        """Return the origin (2,) [m] and the angles (n,) [rad] of rays in the map."""
        x, y, phi = self.driven.pose_at(np.array(when))
        c, s = np.cos(phi), np.sin(phi)
        origin = np.array([x + c * mount[0] - s * mount[1], y + s * mount[0] + c * mount[1]])
        return origin, phi + mount[2] + bearings

    def _sweep(self, world: World, mount: Floats, bearings: Floats, when: float) -> tuple[Floats, Floats]:
        """Cast one scan, in one shot or, where the laser sweeps, ray after ray."""
        share = when / float(self.driven.times[-1])
        late = self.secrets.value("scan_skew", "T") * np.arange(self.laser.n_rays) / (self.laser.n_rays - 1)
        if late[-1] == 0:
            return raw_ranges(world, *self._rays(mount, bearings, when), self.secrets, share, self.rng)
        one_by_one = [
            raw_ranges(world, *self._rays(mount, bearings[i : i + 1], t), self.secrets, share, self.rng)
            for i, t in enumerate(when + late)
        ]
        return np.array([z[0] for z, _ in one_by_one]), np.array([a[0] for _, a in one_by_one])

    def _measured(self, z: Floats, incidence: Floats, when: float, angles: Floats) -> Floats:
        """Return what the laser makes of true ranges."""
        laser, secrets, rng, n = self.laser, self.secrets, self.rng, len(z)
        value, bearings = secrets.value, laser.bearings
        finite = np.where(np.isfinite(z), z, 0.0)
        z = z * (1 + value("range_scale", "s")) + value("range_bias", "b")
        z = z + value("range_drift", "b1") * when / self.driven.times[-1]
        sector = secrets.get("sector_bias")
        if sector is not None:
            z = z + sector["b"] * ((bearings >= sector["theta1"]) & (bearings <= sector["theta2"]))
        cycle = secrets.get("phase_cycle")
        if cycle is not None:
            z = z + cycle["b"] * np.sin(2 * np.pi * finite / cycle["length"])
        normal = rng.normal(size=n)
        if self.dirty:
            normal = np.where(rng.random(n) < 0.1, 2.5, 1.0) * normal
        z = z + normal * np.hypot(laser.sigma, value("range_noise", "k") * finite)
        z = self._lost_and_stray(z, incidence, when, angles)
        q = value("quantisation", "q") or laser.resolution
        z = np.where(np.isfinite(z), q * np.round(np.where(np.isfinite(z), z, 0.0) / q), z)
        low = max(laser.range_min, value("min_range", "r_min"))
        high = min(laser.range_max, value("max_range", "R", 99.0))
        z = np.where(np.isfinite(z) & (z < low), np.inf if value("min_range", "r_min") else -np.inf, z)
        return np.where(z > high, np.inf, z)

    def _lost_and_stray(self, z: Floats, incidence: Floats, when: float, angles: Floats) -> Floats:
        """Let rays be lost, or come back from somewhere else."""
        laser, secrets, rng, n = self.laser, self.secrets, self.rng, len(z)
        value, bearings = secrets.value, laser.bearings
        if self.dirty:
            z = np.where(rng.random(n) < 0.001, np.inf, z)
        z = np.where(incidence > value("incidence_dropout", "alpha_max", 9.0), np.inf, z)
        sun = secrets.get("sunlight")
        if sun is not None:
            off = wrapped(angles - sun["towards"])
            z = np.where((np.abs(off) < sun["width"]) & (rng.random(n) < 0.75), np.inf, z)
        p = value("random_outliers", "p")
        z = np.where(rng.random(n) < p, rng.uniform(0, laser.range_max, n), z) if p else z
        dust = secrets.get("dust")
        if dust is not None:
            echo = 0.1 + rng.exponential(dust["depth"], n)
            z = np.where((rng.random(n) < dust["p"]) & (echo < z), echo, z)
        ghost = secrets.get("crosstalk")
        if ghost is not None:
            off = wrapped(bearings - ghost["turn"] * when)
            seen = (np.abs(off) < ghost["width"]) & (rng.random(n) < 0.7)
            z = np.where(seen, np.minimum(z, ghost["r0"] + 0.02 * rng.normal(size=n)), z)
        post = secrets.get("self_occlusion")
        if post is not None:
            covered = (bearings >= post["theta1"]) & (bearings <= post["theta2"])
            z = np.where(covered, post["r0"] + laser.sigma * rng.normal(size=n), z)
        return z
