"""Scene: the state of a run in the simulator, and the rays cast in it.

A scene passes through stages: geometry, time, mount, cast, surface, optics, range, detection, noise. Each
effect of `sensorgraph.effects` changes one of them, so that any subset can be combined. `draw_readings` samples
the resulting `Beams`; `sensorgraph.diagnose` evaluates the likelihood of readings with the same physics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np
from scipy.special import ndtr

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.cast_memory import CastMemory, RayPaths
from sensorgraph.world.ray_intersection import nearest_from_each
from sensorgraph.world.raycast import cast_laser, directions, laser_poses, ray_starts
from sensorgraph.world.sensor_parts import check_parts, part_names, part_of, sensor_of_rays

STAGES = ("geometry", "time", "mount", "surface", "optics", "range", "detection", "noise")
MAX_DISTANCE = 1e4  # [m] of a cast; the limits of the sensor apply later, to the reading
CONE_STEP = np.radians(1.05)  # [rad] maximum step between the rays that fill a cone
RIGHT_ANGLE = 1.5707963  # [rad] an effect that starts at this incidence never acts
DISC_WALL = -2  # `wall` of a hit on a disc; that of a mover is one less


class Transform(Protocol):
    """A physical effect with its parameters, ready to be applied (see `sensorgraph.effects`)."""

    @property
    def stage(self) -> str:
        """One of STAGES."""
        ...

    @property
    def key(self) -> tuple[object, ...]:
        """Sort key within a stage, so that the result is independent of the order in which effects are given."""
        ...

    def __call__(self, scene: Scene, /) -> None:
        """Change the scene in place."""
        ...


Caster = Callable[[Floats, Floats, Floats, Floats], Floats]
"""Origins and unit directions (n_scans, n_rays) of rays, x and y [m, map] -> ranges [m]; inf without a hit."""


@dataclass(eq=False)
class Scene:
    """Walls, sensor, and times and poses of the scans; effects change it stage by stage."""

    arena: Arena
    sensor: RangeSensor
    stamps: Floats
    """(n_scans,) [s]"""
    motion: Callable[[Floats], Floats]
    """Times (...) [s] -> poses (..., 3) of base_link in map."""
    span: float
    """[s] Length of the whole run; drifts are relative to it."""
    begin: float = 0.0
    """[s] Start of the run."""
    casts: CastMemory | None = None
    """Cache of casts; None: no cache."""
    seed: int | None = None
    """Seed of objects that move at random (people); None: they are only a probability of a short reading."""
    caster: Caster | None = None
    """Another simulator that returns the ranges; the walls only identify what was hit. None: walls are cast."""
    wanted: Bools | None = None
    """(n_scans, n_rays) Thin rays to be cast, the others have no hit; cones are complete. None: all rays."""
    walls: Floats = field(init=False)
    """(n_walls, 2, 2) [m]"""
    discs: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """(n_discs, 3) [m] x, y and radius of round obstacles."""
    movers: Floats = field(default_factory=lambda: np.zeros((0, 0, 3)))
    """(n_scans, n_movers, 3) [m] Round obstacles that move."""
    mount: Floats = field(init=False)
    """(3,) [m, m, rad] Laser in base_link."""
    bearings: Floats = field(init=False)
    """(n_rays,) [rad]"""
    delay: Floats = field(init=False)
    """(n_rays,) [s] Time of each ray after the stamp of the scan."""
    dip: tuple[float, float] = (0.0, 0.0)
    """[rad, rad] Tilt of the laser plane, and the bearing of its steepest descent."""
    surfaces: list[Callable[[Scene, Beams], None]] = field(default_factory=list)
    """Effects of walls on the rays that hit them."""
    outliers: float = 0.0
    """Share of readings that are uniform over (0, range_max)."""
    shorts: float = 0.0
    """Share of readings that stop before the expected range."""
    lattice: float = 0.0
    """[m] Returns are multiples of this; 0: of the sensor's resolution."""
    beams: Beams = field(init=False)

    def __post_init__(self) -> None:
        self.walls = self.arena.walls.copy()
        self.mount = self.sensor.mount.copy()
        self.bearings = self.sensor.bearings
        self.delay = self.sensor.ray_delays

    def shoot(self, offset: float = 0.0, *, bearings: Floats | None = None) -> Beams:
        """Cast every ray or cone, rotated by `offset` [rad], at walls, discs and movers, and apply the surfaces.

        `bearings` are of a single laser, each at the time of the sensor's neighbouring rays; None: the sensor's.
        """
        if bearings is not None:
            return self._shoot_rays(offset, bearings)
        is_cone = self.sensor.cones.any()
        if self.casts is None or (is_cone and self.surfaces):  # surfaces act on each ray of a cone
            return self._shoot_cones(offset) if is_cone else self._shoot_rays(offset, self.bearings)
        surfaces, self.surfaces = self.surfaces, []
        key = self._key_of_rays(offset) + b"".join(p.tobytes() for p in (self.walls, self.discs, self.movers))
        kept = self.casts.beams(
            key,
            lambda: self._shoot_cones(offset) if is_cone else self._shoot_rays(offset, self.bearings),
        )
        self.surfaces = surfaces
        beams = copy(kept)
        for act in self.surfaces:
            act(self, beams)
        return beams

    def _key_of_rays(self, offset: float | Floats) -> bytes:
        """Return the bytes that determine the sensor's rays, for given scans and motion."""
        parts = (self.mount, self.delay, np.array(self.dip), np.asarray(offset, np.float64))
        return b"|".join(part.tobytes() for part in parts) + b"|"

    def _shoot_rays(self, offset: float | Floats, bearings: Floats) -> Beams:
        """Cast thin rays with these bearings (n,), rotated by `offset` [rad] or (n,)."""
        if self.casts is None or bearings is not self.bearings:
            rays = self._rays(offset, bearings)
            ranges, wall = self._hit(rays, self.wanted if bearings is self.bearings else None)
        else:
            key = self._key_of_rays(offset)
            rays = self.casts.rays(key, lambda: self._rays(offset, bearings))
            hits = self.casts.hits(key, rays, self.walls, lambda: self._hit(rays))
            ranges, wall = hits.ranges, hits.wall
        ranges = self._recast(ranges, rays.ox, rays.oy, rays.ux, rays.uy)
        beams = _beams(self.walls, rays.ox, rays.oy, rays.ux, rays.uy, ranges, wall, self.sensor.sigma)
        return self._stop_at_discs(beams)

    def _rays(self, offset: float | Floats, bearings: Floats) -> RayPaths:
        """Return origins and directions of rays with these bearings (n,)."""
        bearings = self.levelled(bearings + offset)
        delay, spread = self.delay, self.sensor.is_composite
        if len(bearings) != self.sensor.n_rays:
            delay, spread = np.interp(bearings, self.bearings, self.delay), False
        if np.ptp(delay) == 0.0 and not spread:
            lasers = laser_poses(self.motion(self.stamps + delay[0]), self.mount)  # (n_scans, 3)
            ux, uy = directions(lasers[:, 2], bearings)
            return RayPaths(
                ox=lasers[:, :1], oy=lasers[:, 1:2], ux=ux, uy=uy, lasers=lasers, bearings=bearings
            )
        poses = self.motion(self.stamps[:, None] + delay)  # (n_scans, n_rays, 3)
        lasers = laser_poses(poses, self.mount)
        if spread:
            lasers = ray_starts(lasers, self.sensor)
        phi = lasers[..., 2] + bearings
        return RayPaths(
            ox=lasers[..., 0],
            oy=lasers[..., 1],
            ux=np.cos(phi),
            uy=np.sin(phi),
            lasers=None,
            bearings=bearings,
        )

    def _hit(self, rays: RayPaths, some: Bools | None = None) -> tuple[Floats, Ints]:
        """Return range and wall of the rays; only of `some` of them (n_scans, n_rays), if given."""
        if some is not None:
            ranges, wall = np.full(some.shape, np.inf), np.full(some.shape, -1, dtype=np.intp)
            x, y = (np.broadcast_to(o, some.shape)[some] for o in (rays.ox, rays.oy))
            ranges[some], wall[some] = nearest_from_each(self.walls, x, y, rays.ux[some], rays.uy[some])
            return ranges, wall
        if rays.lasers is not None:
            return cast_laser(self.walls, rays.lasers, rays.bearings, MAX_DISTANCE)
        return nearest_from_each(self.walls, rays.ox, rays.oy, rays.ux, rays.uy)

    def levelled(self, bearings: Floats) -> Floats:
        """Return the bearings [rad] in the horizontal plane of rays of a tilted laser."""
        beta, deepest = self.dip
        if beta == 0.0:
            return bearings
        along, aside = np.cos(bearings - deepest) * np.cos(beta), np.sin(bearings - deepest)
        spread = np.arctan2(aside, along) - np.arctan2(aside, np.cos(bearings - deepest))
        return np.asarray(bearings + spread)

    def _apply_tilt(self) -> None:
        """Convert horizontal distances to readings of a tilted laser, and stop rays at the floor."""
        beams, (beta, deepest) = self.beams, self.dip
        sine = np.sin(beta) * np.cos(
            self.bearings - deepest
        )  # (n_rays,) sine of the angle below the horizontal
        with np.errstate(divide="ignore"):
            floor = np.where(sine > 0, self.sensor.height / np.maximum(sine, 1e-12), np.inf)
        stretch = 1 / np.sqrt(1 - sine**2)
        down = beams.reading * stretch > floor
        beams.reading = np.where(down, floor, beams.reading * stretch)
        beams.slope = np.where(down, 0.0, stretch) * beams.slope
        beams.bent()[down] = False

    def _recast(self, ranges: Floats, ox: Floats, oy: Floats, ux: Floats, uy: Floats) -> Floats:
        """Return the ranges of the external caster, if there is one."""
        if self.caster is None:
            return ranges
        return self.caster(*(np.broadcast_to(part, ux.shape) for part in (ox, oy, ux, uy)))

    def _stop_at_discs(self, beams: Beams) -> Beams:
        """Stop rays at discs and movers in front of walls, and apply the surfaces."""
        for centres, index in ((self.discs[None], DISC_WALL), (self.movers, DISC_WALL - 1)):
            if centres.shape[1]:
                _meet_discs(beams, centres, index)
        for act in self.surfaces:
            act(self, beams)
        return beams

    def _shoot_cones(self, offset: float) -> Beams:
        """Cast rays that fill the cone of each ray; the reading is the nearest surface in the cone."""
        cones, n_scans = self.sensor.cones, len(self.stamps)
        n = 2 * int(np.ceil(cones.max() / CONE_STEP / 2)) + 1
        lasers = laser_poses(self.motion(self.stamps[:, None] + self.delay), self.mount)
        lasers = ray_starts(lasers, self.sensor) if self.sensor.is_composite else lasers
        middle = self.levelled(self.bearings + offset)
        fan = middle + np.linspace(-0.5, 0.5, n)[:, None] * cones  # (n, n_rays)
        phi = (lasers[:, None, :, 2] + fan).reshape(n_scans, -1)
        ox, oy = (np.tile(lasers[..., axis], (1, n)) for axis in (0, 1))  # (n_scans, n * n_rays)
        ux, uy = np.cos(phi), np.sin(phi)
        ranges, wall = nearest_from_each(self.walls, ox, oy, ux, uy)
        ranges = self._recast(ranges, ox, oy, ux, uy)
        filled = self._stop_at_discs(_beams(self.walls, ox, oy, ux, uy, ranges, wall, self.sensor.sigma))
        nearest = filled.ranges.reshape(n_scans, n, -1).argmin(axis=1)
        at = nearest * len(cones) + np.arange(len(cones))
        out: dict[str, Any] = {}
        for name in (f.name for f in fields(Beams)):
            table = getattr(filled, name)
            is_table = isinstance(table, np.ndarray) and table.shape == filled.ranges.shape
            out[name] = np.take_along_axis(table, at, 1) if is_table else table
        return Beams(**{**out, "within": (nearest > 0) & (nearest < n - 1)})

    def run(self, effects: Iterable[Transform] = ()) -> Beams:
        """Apply effects stage by stage, cast, and return the beams.

        Effects located at one of several sensors act on its rays alone.

        Raises
        ------
        SensorgraphError : An effect is located at a sensor that does not exist, or cannot apply to one sensor
            alone.
        """
        ordered = sorted(effects, key=lambda effect: (STAGES.index(effect.stage), effect.key))
        owner = sensor_of_rays(self.sensor)
        names = part_names(self.sensor)
        check_parts([getattr(effect, "place", "") for effect in ordered], names)
        parts = {
            k: self._part(np.flatnonzero(owner == k))
            for k, name in enumerate(names)
            if _is_located_at(ordered, name)
        }
        self._apply([effect for effect in ordered if not _is_located_at([effect], *names)])
        for k, part in parts.items():
            part._apply(
                [effect for effect in ordered if not _is_located_at([effect], *names[:k], *names[k + 1 :])]
            )
            if (part.outliers, part.shorts, part.lattice) != (self.outliers, self.shorts, self.lattice):
                raise SensorgraphError(
                    f"an effect on all readings is located at {names[k]} alone; remove its location"
                )
            self.beams = _with_rays(self.beams, part.beams, np.flatnonzero(owner == k))
        return self.beams

    def _apply(self, ordered: Sequence[Transform]) -> None:
        """Apply effects in this order, with the cast between the stages surface and optics."""
        cast_after = STAGES.index("optics")
        for effect in (e for e in ordered if STAGES.index(e.stage) < cast_after):
            effect(self)
        self.beams = self.shoot()
        for effect in (e for e in ordered if STAGES.index(e.stage) == cast_after):
            effect(self)
        if self.dip[0]:
            self._apply_tilt()
        for effect in (e for e in ordered if STAGES.index(e.stage) > cast_after):
            effect(self)

    def _part(self, rays: Ints) -> Scene:
        """Return the scene of one of several sensors, given its rays."""
        return Scene(
            arena=self.arena,
            sensor=part_of(self.sensor, rays),
            stamps=self.stamps,
            motion=self.motion,
            span=self.span,
            begin=self.begin,
            seed=self.seed,
            caster=self.caster,
        )


def _is_located_at(effects: Iterable[Transform], *places: str) -> bool:
    return any(getattr(effect, "place", "") in places for effect in effects)


def _with_rays(beams: Beams, part: Beams, rays: Ints) -> Beams:
    """Return beams in which some rays are replaced by those of a part."""
    out: dict[str, Any] = {}
    for name in (f.name for f in fields(Beams)):
        whole, some = (
            _DEFAULTS.get(name) if v is None else v for v in (getattr(beams, name), getattr(part, name))
        )
        table = np.broadcast_to(np.asarray(whole), beams.ranges.shape).copy()
        table[:, rays] = some
        out[name] = table
    return Beams(**out)


_DEFAULTS = {"straight": True, "within": False}
"""Value of a field of `Beams` that is None."""


def draw_readings(scene: Scene, rng: np.random.Generator) -> Floats:
    """Sample readings (n_scans, n_rays) [m] from an evaluated scene: noise, lattice, limits (REP-117)."""
    beams, sensor = scene.beams, scene.sensor
    shape = beams.reading.shape
    hit = np.isfinite(beams.reading)
    readings = np.where(hit, beams.reading + rng.normal(size=shape) * beams.sigma, beams.reading)
    if scene.shorts:
        short = rng.random(shape) < scene.shorts
        top = np.minimum(np.where(hit, beams.reading, sensor.range_max), sensor.range_max)
        readings = np.where(short, rng.random(shape) * top, readings)
    if (np.asarray(beams.p_return) < 1.0).any():
        readings = np.where(rng.random(shape) < np.asarray(beams.p_return), readings, np.inf)
    if scene.outliers:
        stray = rng.random(shape) < scene.outliers
        readings = np.where(stray, rng.random(shape) * sensor.range_max, readings)
    return apply_range_limits(readings, sensor, scene.lattice)


def apply_range_limits(readings: Floats, sensor: RangeSensor, lattice: float = 0.0) -> Floats:
    """Round returns to the sensor's resolution and to a lattice [m]; values beyond the limits become +inf or -inf."""
    hit = np.isfinite(readings)
    for step in (lattice, sensor.resolution):
        if step > 0:
            readings = np.round(readings / step) * step
    readings = np.where(hit & (readings > sensor.range_max), np.inf, readings)
    return np.where(hit & (readings < sensor.range_min), -np.inf, readings)


def fade(margin: Floats, width: Floats | float) -> Floats:
    """Return a probability that rises from 0 to 1 where `margin` crosses 0, over a few `width`s (normal integral)."""
    return np.asarray(ndtr(np.asarray(margin) / width))


def _beams(
    walls: Floats, ox: Floats, oy: Floats, ux: Floats, uy: Floats, ranges: Floats, wall: Ints, sigma: float
) -> Beams:
    """Return beams with the normals of what is hit."""
    if len(walls):
        d = walls[:, 1] - walls[:, 0]
        d = d / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-12)[:, None]
        hit = wall >= 0
        nx, ny = d[wall, 1] * hit, -d[wall, 0] * hit
        flip = np.where(nx * ux + ny * uy > 0, -1.0, 1.0)
        nx, ny = nx * flip, ny * flip
    else:
        nx, ny = np.zeros(ux.shape), np.zeros(ux.shape)
    return Beams(
        ox=ox, oy=oy, ux=ux, uy=uy, ranges=ranges, wall=wall, nx=nx, ny=ny, reading=ranges.copy(), sigma=sigma
    )


def _meet_discs(beams: Beams, discs: Floats, index: int) -> None:
    """Stop rays at discs (n_scans or 1, n_discs, 3) that are nearer than what they hit so far."""
    for k in range(discs.shape[1]):
        cx, cy, radius = (discs[:, k, i][:, None] for i in range(3))  # (n_scans or 1, 1)
        ahead, aside = beams.towards(cx, cy)
        with np.errstate(invalid="ignore"):
            r = ahead - np.sqrt(radius**2 - aside**2)  # nan for a ray that misses the disc
        met = (r > 0) & (r < beams.ranges)
        if not met.any():
            continue
        at = np.where(met, r, 0.0)
        size = np.maximum(np.broadcast_to(radius, met.shape), 1e-9)
        beams.nx = np.where(met, (beams.ox + at * beams.ux - cx) / size, beams.nx)
        beams.ny = np.where(met, (beams.oy + at * beams.uy - cy) / size, beams.ny)
        beams.ranges = np.where(met, r, beams.ranges)
        beams.wall = np.where(met, index, beams.wall)
    beams.reading = beams.ranges.copy()
