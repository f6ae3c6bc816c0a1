"""A scan as it is simulated, stage by stage from the room to the reading, and the physics of every effect of the library.

Geometry, walls, time, ray, look, range, detection, spread, final: an effect is a name, its parameters and a function
at one of these stages, registered by `at` or `laws`; `foreign.py` holds those that the library lacks. Everything random in an
effect has a stream of its own: a twin without the effect differs in nothing else. The wheels' odometry is here as well.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.hidden_effects.geometry import Room, interpolated
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive
from benchmarks.hidden_effects.worlds.own.robot import RobotSpec
from benchmarks.hidden_effects.worlds.own.world import Walls, cast, centroid, disc_range, shift_edge, walls_of

N_SUBRAYS = 31


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """One hidden effect."""

    name: str
    parameters: Mapping[str, float | None]
    place: str | None = None
    """Wall or obstacle it sits on."""
    xy: tuple[float, float] | None = None
    """[m] where it is."""
    extra: Mapping[str, Any] = field(default_factory=dict)
    """What the physics needs beyond the parameters."""


@dataclass(eq=False)
class SimulatedScan:
    """Everything a scan passes through; effects change it in place."""

    room: Room
    robot: RobotSpec
    driven: TrueDrive
    mount: Floats
    """(3,) [m, m, rad] true mount."""
    stamps: Floats
    """(n_scans,) [s] true time of the first ray, as far as the clocks are right."""
    seed: int
    walls: Walls = field(init=False)
    discs: list[tuple[float, float, float]] = field(default_factory=list)
    walkers: list[tuple[Floats, Floats, float]] = field(default_factory=list)
    """(times (k,), centres (k, 2), radius) of moving discs."""
    times: Floats = field(init=False)
    """(n_scans, n_rays) [s] when each ray was truly taken."""
    poses: Floats = field(init=False)
    """(n, 3) true base_link of each ray, n = n_scans * n_rays."""
    bearings: Floats = field(init=False)
    """(n,) [rad] true, in the laser frame."""
    origins: Floats = field(init=False)
    angles: Floats = field(init=False)
    true: Floats = field(init=False)
    """(n,) [m] distance to what the ray sees."""
    ranges: Floats = field(init=False)
    incidence: Floats = field(init=False)
    along: Floats = field(init=False)
    wall: np.ndarray[Any, np.dtype[np.intp]] = field(init=False)
    spread: Floats = field(init=False)
    """(n,) [m] standard deviation of the noise."""
    measured: Floats = field(init=False)
    """(n,) [m] with noise."""

    def rng(self, effect: HiddenEffect) -> np.random.Generator:
        """Return the stream of an effect, the same in every simulation of a case."""
        return np.random.default_rng([self.seed, zlib.crc32(effect.name.encode())])

    @property
    def stated(self) -> Floats:
        """(n,) [rad] bearings as the robot file states them."""
        return np.tile(self.robot.bearings, len(self.stamps))

    @property
    def clock(self) -> Floats:
        """(n,) [s] stamp of each ray's scan."""
        return np.repeat(self.stamps, self.robot.n_rays)

    def on(self, effect: HiddenEffect) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(n,) rays that end on the effect's wall, between a and b where it has them."""
        assert effect.place is not None
        here = np.isin(self.wall, self.walls.index(effect.place))
        if "a" in effect.parameters:
            here &= (self.along >= effect.parameters["a"]) & (self.along <= effect.parameters["b"])
        return here

    def in_sector(self, p: Mapping[str, Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(n,) rays between theta1 and theta2, as stated."""
        return (self.stated >= p["theta1"]) & (self.stated <= p["theta2"])

    def lost(self, rays: np.ndarray[Any, np.dtype[np.bool_]]) -> Floats:
        """Return ranges with some rays lost."""
        return np.where(rays, np.inf, self.ranges)


Physics = Callable[[SimulatedScan, Mapping[str, Any], HiddenEffect], None]
Law = Callable[[SimulatedScan, Mapping[str, Any], Any], Any]
"""(scan, parameters, effect) -> new value of what the law is about."""
STAGES: dict[str, dict[str, Physics]] = {
    name: {}
    for name in ("geometry", "wall", "time", "ray", "surface", "range", "detection", "noise", "final")
}


def at(stage: str, name: str) -> Callable[[Physics], Physics]:
    """Register a function as an effect's physics at a stage."""

    def keep(physics: Physics) -> Physics:
        STAGES[stage][name] = physics
        return physics

    return keep


def laws(stage: str, attribute: str, **of_effects: Law) -> None:
    """Register laws of effects, by their names, for one attribute of a scan at a stage."""

    def physics(law: Law) -> Physics:
        return lambda scene, p, effect: setattr(scene, attribute, law(scene, p, effect))

    for name, law in of_effects.items():
        STAGES[stage][name] = physics(law)


def observe(
    scene: SimulatedScan, effects: Sequence[HiddenEffect], noise: tuple[Floats, Floats] | None = None
) -> Floats:
    """Return ranges (n_scans, n_rays): measured with noise (standard normals, lost 0/1), or expected."""
    robot, shape = scene.robot, (len(scene.stamps), scene.robot.n_rays)

    def run(stage: str) -> None:
        for name, physics in STAGES[stage].items():
            for effect in effects:
                if effect.name == name:
                    physics(scene, effect.parameters, effect)

    run("geometry")
    scene.walls = walls_of(scene.room)
    run("wall")
    scene.times = scene.stamps[:, None] + robot.sweep_time * np.arange(robot.n_rays) / robot.n_rays
    run("time")
    scene.poses = scene.driven.at(scene.times).reshape(-1, 3)
    scene.bearings = scene.stated
    run("ray")
    mount, phi = scene.mount, scene.poses[:, 2]
    c, s = np.cos(phi), np.sin(phi)
    scene.origins = scene.poses[:, :2] + np.stack(
        [c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1
    )
    scene.angles = phi + mount[2] + scene.bearings
    _look_around(scene, effects)
    scene.ranges = scene.true.copy()
    run("range")
    scene.spread = np.full(len(scene.ranges), robot.sigma)
    run("detection")
    run("noise")
    scene.measured = scene.ranges
    if noise is not None:
        scene.measured = scene.measured + scene.spread * noise[0].ravel()
        scene.measured[noise[1].ravel() > 0] = np.inf
    for effect in effects:
        if effect.name in STAGES["final"]:
            STAGES["final"][effect.name](scene, effect.parameters, effect)
    z = scene.measured
    if noise is not None and robot.resolution > 0:
        with np.errstate(invalid="ignore"):
            z = robot.resolution * np.round(z / robot.resolution)
    z = np.where(z > robot.range_max, np.inf, z)
    return np.where(z < robot.range_min, -np.inf, z).reshape(shape)


def _look_around(scene: SimulatedScan, effects: Sequence[HiddenEffect]) -> None:
    """Look along every ray; a wide beam looks along several."""
    wide = next((e for e in effects if e.name in ("mixed_pixels", "sonar_cone")), None)
    if wide is None:
        scene.true = _look(scene, effects)
        return
    gamma = float(wide.parameters["gamma"] or 0.0)
    middle, total, best = scene.angles, np.zeros(len(scene.angles)), np.full(len(scene.angles), np.inf)
    count = np.zeros(len(middle))
    for offset in gamma * np.linspace(-1, 1, N_SUBRAYS):
        scene.angles = middle + offset
        r = _look(scene, effects)
        seen = np.isfinite(r) & (r < 1.5 * scene.robot.range_max)
        count += seen
        total += np.where(seen, r, 0.0)
        if wide.name == "sonar_cone":
            # a facet answers only if it faces the sonar
            facing = seen & (scene.incidence <= float(wide.parameters["alpha_max"] or 0.0))
            best = np.where(facing, np.minimum(best, r), best)
    scene.angles = middle
    centre = _look(scene, effects)
    if wide.name == "sonar_cone":
        scene.true = best
    else:
        scene.true = np.where(np.isfinite(centre) & (count > 0), total / np.maximum(count, 1), centre)


def _look(scene: SimulatedScan, effects: Sequence[HiddenEffect]) -> Floats:
    """Cast against walls and discs, then let surfaces act; sets wall, incidence and along."""
    hits = cast(scene.walls, scene.origins, scene.angles)
    scene.true, scene.wall = hits.ranges, hits.wall.copy()
    scene.incidence, scene.along = hits.incidence, hits.along
    for effect in effects:
        if effect.name in STAGES["surface"]:
            STAGES["surface"][effect.name](scene, effect.parameters, effect)
    discs = [disc_range(scene.origins, scene.angles, np.array([x, y]), r) for x, y, r in scene.discs]
    clock = scene.times.ravel()
    for stamps, centres, radius in scene.walkers:
        at = interpolated(clock, stamps, centres)
        away = at - scene.poses[:, :2]
        far = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
        at = scene.poses[:, :2] + away / far * np.maximum(far, 0.45 + radius)  # people do not run into robots
        discs.append(disc_range(scene.origins, scene.angles, at, radius))
    for r in discs:
        nearer = r < scene.true
        scene.true = np.where(nearer, r, scene.true)
        scene.wall[nearer] = -1
        scene.incidence = np.where(nearer, 0.0, scene.incidence)
    return scene.true


def _moved_wall(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Room:
    name, i = str(effect.place).split("/edge_")
    return scene.room.with_ring(name, shift_edge(scene.room.rings[name], int(i), p["d"]))


def _scaled(room: Room, s: float) -> Room:
    c = centroid(room)
    return room.changed(lambda _, ring: c + (1 + s) * (ring - c))


laws(
    "geometry",
    "room",
    map_scale=lambda scene, p, effect: _scaled(scene.room, p["s"]),
    moved_wall=_moved_wall,
    moved_obstacle=lambda scene, p, effect: scene.room.with_ring(
        effect.place, scene.room.rings[effect.place] + np.array([p["dx"], p["dy"]])
    ),
    missing_obstacle=lambda scene, p, effect: scene.room.with_ring(effect.place, None),
)
laws("geometry", "discs", unmapped_obstacle=lambda scene, p, effect: [*scene.discs, (p["x"], p["y"], p["r"])])
laws("geometry", "walkers", people=lambda scene, p, effect: scene.walkers + effect.extra["walkers"])
laws(
    "time",
    "times",
    latency=lambda scene, p, effect: scene.times - p["tau"],
    scan_skew=lambda scene, p, effect: (
        scene.times + p["T"] * np.arange(scene.robot.n_rays) / scene.robot.n_rays
    ),
)
laws("ray", "mount", mount_xy=lambda scene, p, effect: scene.mount + np.array([p["dx"], p["dy"], 0.0]))


def _dipped(bearings: Floats, p: Mapping[str, Any]) -> tuple[Any, Floats]:
    """Return the horizontal part of unit rays of a dipped plane, as complex numbers, and how far down they point."""
    towards = np.exp(1j * p["theta0"])
    ray = np.exp(1j * bearings) / towards
    return (ray.real * np.cos(p["beta"]) + 1j * ray.imag) * towards, ray.real * np.sin(p["beta"])


def _dip(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    """Look where rays of the dipped plane go as seen from above."""
    level, _ = _dipped(scene.stated, p)
    return np.asarray(scene.bearings + np.angle(level * np.exp(-1j * scene.stated)))


laws("ray", "bearings", mount_yaw=lambda scene, p, effect: scene.bearings + p["delta"], tilt=_dip)


def _glass(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    through = scene.on(effect) & (scene.incidence > p["alpha_ret"])
    behind = np.inf if p["depth"] is None else p["depth"]
    return np.where(through, scene.true + behind / np.cos(scene.incidence), scene.true)


laws("surface", "true", glass=_glass)


@at("surface", "mirror")
def _mirror(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> None:
    on = np.flatnonzero(scene.on(effect) & np.isfinite(scene.true))
    if len(on) == 0:
        return
    w = scene.wall[on]
    e = scene.walls.b[w] - scene.walls.a[w]
    wall_angle = np.arctan2(e[:, 1], e[:, 0])
    out = scene.angles[on]
    first = scene.true[on]
    hit = scene.origins[on] + first[:, None] * np.stack([np.cos(out), np.sin(out)], axis=1)
    bounced = 2 * wall_angle - out
    start = hit + 1e-6 * np.stack([np.cos(bounced), np.sin(bounced)], axis=1)
    hits = cast(scene.walls, start, bounced)
    second = hits.ranges
    for x, y, r in scene.discs:
        second = np.minimum(second, disc_range(start, bounced, np.array([x, y]), r))
    true, incidence = scene.true.copy(), scene.incidence.copy()
    true[on], incidence[on] = first + second, hits.incidence
    scene.true, scene.incidence = true, incidence


def _tilt(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    level, down = _dipped(scene.stated, p)
    with np.errstate(divide="ignore"):
        floor = np.where(down > 1e-6, scene.robot.height / np.maximum(down, 1e-6), np.inf)
    return np.minimum(scene.ranges / np.abs(level), floor)


def _drift(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    t, whole = scene.clock - scene.stamps[0], scene.stamps[-1] - scene.stamps[0]
    share = 1 - np.exp(-t / p["tau"]) if "tau" in p else t / whole
    return np.asarray(scene.ranges + p["b1"] * share)


laws(
    "range",
    "ranges",
    tilt=_tilt,
    self_occlusion=lambda scene, p, effect: np.where(
        scene.in_sector(p), np.minimum(scene.ranges, p["r0"]), scene.ranges
    ),
    range_scale=lambda scene, p, effect: scene.ranges * (1 + p["s"]),
    range_bias=lambda scene, p, effect: scene.ranges + p["b"],
    sector_bias=lambda scene, p, effect: scene.ranges + np.where(scene.in_sector(p), p["b"], 0.0),
    range_drift=_drift,
)


def _black_surface(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    chance = np.minimum(1.0, np.cos(scene.incidence) * (p["r0"] / np.maximum(scene.true, 1e-6)) ** 2)
    return scene.lost(scene.on(effect) & (scene.rng(effect).random(len(chance)) > chance))


laws(
    "detection",
    "ranges",
    black_surface=_black_surface,
    incidence_dropout=lambda scene, p, effect: scene.lost(scene.incidence > p["alpha_max"]),
    max_range=lambda scene, p, effect: scene.lost(scene.true > p["R"]),
    min_range=lambda scene, p, effect: np.where(scene.true < p["r_min"], effect.extra["reads"], scene.ranges),
)
laws(
    "noise",
    "spread",
    range_noise=lambda scene, p, effect: np.sqrt(
        scene.spread**2 + (p["k"] * np.where(np.isfinite(scene.true), scene.true, 0.0)) ** 2
    ),
)


def _random_outliers(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    rng, n = scene.rng(effect), len(scene.measured)
    return np.where(rng.random(n) < p["p"], rng.uniform(0, scene.robot.range_max, n), scene.measured)


def _quantisation(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    with np.errstate(invalid="ignore"):
        return np.asarray(p["q"] * np.round(scene.measured / p["q"]))


laws("final", "measured", random_outliers=_random_outliers, quantisation=_quantisation)


def odometry(driven: TrueDrive, effects: Sequence[HiddenEffect], stamps: Floats, base: float) -> Floats:
    """Return twists (n, 2) [m/s, rad/s]: mean wheel motion over the interval before each stamp, no noise."""
    late = sum(float(e.parameters["tau"] or 0.0) for e in effects if e.name == "pose_clock_offset")
    step = float(stamps[1] - stamps[0])
    twists = (driven.travelled(stamps - late) - driven.travelled(stamps - late - step)) / step
    v, omega = twists[:, 0].copy(), twists[:, 1].copy()
    for effect in effects:
        s = float(effect.parameters.get("s") or 0.0)
        if effect.name == "wheel_radius":
            v, omega = v * (1 + s), omega * (1 + s)
        elif effect.name == "wheel_radius_diff":
            omega = omega + s * v / base
        elif effect.name == "wheel_base":
            omega = omega / (1 + s)
        elif effect.name == "odom_scale_jump":
            late_part = stamps > effect.extra["t0"]
            v, omega = np.where(late_part, v * (1 + s), v), np.where(late_part, omega * (1 + s), omega)
    return np.stack([v, omega], axis=1)
