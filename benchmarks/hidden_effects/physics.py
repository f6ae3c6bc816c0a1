"""The physics of every effect, stage by stage.

Geometry, walls, time, ray, look, range, detection, spread, final: an effect is a name, its parameters and
a function at one of these stages. Effects outside the library (`foreign.py`) enter by the same stages.
Everything random in an effect has a stream of its own: a twin without the effect differs in nothing else.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.hidden_effects.robot import Driven, RobotSpec
from benchmarks.hidden_effects.world import ARENA, Floats, Room, Walls, cast, disc_range, shift_edge, walls_of

N_SUBRAYS = 31


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
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
class Scene:
    """Everything a scan passes through; effects change it in place."""

    room: Room
    robot: RobotSpec
    driven: Driven
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

    def rng(self, effect: Effect) -> np.random.Generator:
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

    def on(self, effect: Effect) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(n,) rays that end on the effect's wall, between a and b where it has them."""
        assert effect.place is not None
        here = np.isin(self.wall, self.walls.index(effect.place))
        if "a" in effect.parameters:
            here &= (self.along >= effect.parameters["a"]) & (self.along <= effect.parameters["b"])
        return here


Stage = Callable[[Scene, Effect, Mapping[str, Any]], None]
GEOMETRY: dict[str, Stage] = {}
WALLS: dict[str, Stage] = {}
TIME: dict[str, Stage] = {}
RAY: dict[str, Stage] = {}
LOOK: dict[str, Stage] = {}
RANGE: dict[str, Stage] = {}
DETECTION: dict[str, Stage] = {}
SPREAD: dict[str, Stage] = {}
FINAL: dict[str, Callable[[Scene, Effect, Floats], Floats]] = {}


def stage(table: dict[str, Any], name: str) -> Callable[[Any], Any]:
    """Register a function as an effect's physics at a stage."""

    def keep(function: Any) -> Any:
        table[name] = function
        return function

    return keep


def observe(scene: Scene, effects: Sequence[Effect], noise: tuple[Floats, Floats] | None = None) -> Floats:
    """Return ranges (n_scans, n_rays): measured with noise (standard normals, lost 0/1), or expected."""
    robot, shape = scene.robot, (len(scene.stamps), scene.robot.n_rays)

    def run(table: dict[str, Stage]) -> None:
        for name, function in table.items():
            for effect in effects:
                if effect.name == name:
                    function(scene, effect, effect.parameters)

    run(GEOMETRY)
    scene.walls = walls_of(scene.room)
    run(WALLS)
    scene.times = scene.stamps[:, None] + robot.sweep_time * np.arange(robot.n_rays) / robot.n_rays
    run(TIME)
    scene.poses = scene.driven.at(scene.times).reshape(-1, 3)
    scene.bearings = scene.stated
    run(RAY)
    mount, phi = scene.mount, scene.poses[:, 2]
    c, s = np.cos(phi), np.sin(phi)
    scene.origins = scene.poses[:, :2] + np.stack(
        [c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1
    )
    scene.angles = phi + mount[2] + scene.bearings
    _look_around(scene, effects)
    scene.ranges = scene.true.copy()
    run(RANGE)
    scene.spread = np.full(len(scene.ranges), robot.sigma)
    run(DETECTION)
    run(SPREAD)
    z = scene.ranges
    if noise is not None:
        z = z + scene.spread * noise[0].ravel()
        z[noise[1].ravel() > 0] = np.inf
    for effect in effects:
        if effect.name in FINAL:
            z = FINAL[effect.name](scene, effect, z)
    if noise is not None and robot.resolution > 0:
        with np.errstate(invalid="ignore"):
            z = robot.resolution * np.round(z / robot.resolution)
    z = np.where(z > robot.range_max, np.inf, z)
    return np.where(z < robot.range_min, -np.inf, z).reshape(shape)


def _look_around(scene: Scene, effects: Sequence[Effect]) -> None:
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


def _look(scene: Scene, effects: Sequence[Effect]) -> Floats:
    """Cast against walls and discs, then let surfaces act; sets wall, incidence and along."""
    hits = cast(scene.walls, scene.origins, scene.angles)
    scene.true, scene.wall, scene.incidence, scene.along = (
        hits.ranges,
        hits.wall.copy(),
        hits.incidence,
        hits.along,
    )
    for effect in effects:
        if effect.name in LOOK:
            LOOK[effect.name](scene, effect, effect.parameters)
    discs = [disc_range(scene.origins, scene.angles, np.array([x, y]), r) for x, y, r in scene.discs]
    clock = scene.times.ravel()
    for stamps, centres, radius in scene.walkers:
        at = np.stack([np.interp(clock, stamps, column) for column in centres.T], axis=1)
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


# geometry


@stage(GEOMETRY, "map_scale")
def _map_scale(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    c = scene.room.centroid
    scene.room = Room(rings={name: c + (1 + p["s"]) * (ring - c) for name, ring in scene.room.rings.items()})


@stage(GEOMETRY, "moved_wall")
def _moved_wall(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    name, i = str(effect.place).split("/edge_")
    scene.room = scene.room.with_ring(name, shift_edge(scene.room.rings[name], int(i), p["d"]))


@stage(GEOMETRY, "moved_obstacle")
def _moved_obstacle(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    name = str(effect.place)
    scene.room = scene.room.with_ring(name, scene.room.rings[name] + np.array([p["dx"], p["dy"]]))


@stage(GEOMETRY, "missing_obstacle")
def _missing_obstacle(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.room = scene.room.with_ring(str(effect.place), None)


@stage(GEOMETRY, "unmapped_obstacle")
def _unmapped_obstacle(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.discs.append((p["x"], p["y"], p["r"]))


@stage(GEOMETRY, "people")
def _people(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.walkers += effect.extra["walkers"]


# time and ray


@stage(TIME, "latency")
def _latency(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.times = scene.times - p["tau"]


@stage(TIME, "scan_skew")
def _scan_skew(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    n = scene.robot.n_rays
    scene.times = scene.times + p["T"] * np.arange(n) / n


@stage(RAY, "mount_yaw")
def _mount_yaw(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.bearings = scene.bearings + p["delta"]


@stage(RAY, "mount_xy")
def _mount_xy(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.mount = scene.mount + np.array([p["dx"], p["dy"], 0.0])


# surfaces


@stage(LOOK, "glass")
def _glass(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    through = scene.on(effect) & (scene.incidence > p["alpha_ret"])
    behind = np.inf if p["depth"] is None else p["depth"]
    scene.true = np.where(through, scene.true + behind / np.cos(scene.incidence), scene.true)


@stage(LOOK, "mirror")
def _mirror(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
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


# range


@stage(RANGE, "tilt")
def _tilt(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    down = p["beta"] * np.cos(scene.stated - p["theta0"])
    slant = scene.ranges / np.cos(down)
    with np.errstate(divide="ignore"):
        floor = np.where(down > 1e-6, scene.robot.height / np.sin(np.maximum(down, 1e-6)), np.inf)
    scene.ranges = np.minimum(slant, floor)


@stage(RANGE, "self_occlusion")
def _self_occlusion(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    inside = (scene.stated >= p["theta1"]) & (scene.stated <= p["theta2"])
    scene.ranges = np.where(inside, np.minimum(scene.ranges, p["r0"]), scene.ranges)


@stage(RANGE, "range_scale")
def _range_scale(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges * (1 + p["s"])


@stage(RANGE, "range_bias")
def _range_bias(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["b"]


@stage(RANGE, "sector_bias")
def _sector_bias(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    inside = (scene.stated >= p["theta1"]) & (scene.stated <= p["theta2"])
    scene.ranges = scene.ranges + np.where(inside, p["b"], 0.0)


@stage(RANGE, "range_drift")
def _range_drift(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    t = scene.clock - scene.stamps[0]
    whole = scene.stamps[-1] - scene.stamps[0]
    share = 1 - np.exp(-t / p["tau"]) if "tau" in p else t / whole
    scene.ranges = scene.ranges + p["b1"] * share


# detection


@stage(DETECTION, "black_surface")
def _black_surface(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    chance = np.minimum(1.0, np.cos(scene.incidence) * (p["r0"] / np.maximum(scene.true, 1e-6)) ** 2)
    lost = scene.on(effect) & (scene.rng(effect).random(len(chance)) > chance)
    scene.ranges = np.where(lost, np.inf, scene.ranges)


@stage(DETECTION, "incidence_dropout")
def _incidence_dropout(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.ranges = np.where(scene.incidence > p["alpha_max"], np.inf, scene.ranges)


@stage(DETECTION, "max_range")
def _max_range(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.ranges = np.where(scene.true > p["R"], np.inf, scene.ranges)


@stage(DETECTION, "min_range")
def _min_range(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    scene.ranges = np.where(scene.true < p["r_min"], effect.extra["reads"], scene.ranges)


# noise


@stage(SPREAD, "range_noise")
def _range_noise(scene: Scene, effect: Effect, p: Mapping[str, Any]) -> None:
    r = np.where(np.isfinite(scene.true), scene.true, 0.0)
    scene.spread = np.sqrt(scene.spread**2 + (p["k"] * r) ** 2)


@stage(FINAL, "random_outliers")
def _random_outliers(scene: Scene, effect: Effect, z: Floats) -> Floats:
    rng = scene.rng(effect)
    stray = rng.random(len(z)) < effect.parameters["p"]  # type: ignore[operator]
    return np.where(stray, rng.uniform(0, scene.robot.range_max, len(z)), z)


@stage(FINAL, "quantisation")
def _quantisation(scene: Scene, effect: Effect, z: Floats) -> Floats:
    q = float(effect.parameters["q"] or 0.0)
    with np.errstate(invalid="ignore"):
        return q * np.round(z / q)


SCAN_EFFECTS = [
    "range_bias",
    "range_scale",
    "range_noise",
    "sector_bias",
    "mount_yaw",
    "mount_xy",
    "latency",
    "scan_skew",
    "mixed_pixels",
    "glass",
    "mirror",
    "black_surface",
    "incidence_dropout",
    "max_range",
    "min_range",
    "quantisation",
    "unmapped_obstacle",
    "moved_obstacle",
    "missing_obstacle",
    "moved_wall",
    "map_scale",
    "people",
    "range_drift",
    "sonar_cone",
    "self_occlusion",
    "tilt",
    "random_outliers",
]
ODOMETRY_EFFECTS = ["wheel_radius", "wheel_radius_diff", "wheel_base", "wheel_slip", "pose_clock_offset"]
DRIVE_EFFECTS = ["actuator_lag", "dead_time", "speed_saturation"]
LIBRARY = [*SCAN_EFFECTS, *ODOMETRY_EFFECTS, *DRIVE_EFFECTS]
CHANNEL = {
    **dict.fromkeys(SCAN_EFFECTS, "scan"),
    **dict.fromkeys(ODOMETRY_EFFECTS, "odometry"),
    **dict.fromkeys(DRIVE_EFFECTS, "drive"),
}
SMOOTH = {
    "range_bias",
    "range_scale",
    "sector_bias",
    "mount_yaw",
    "mount_xy",
    "latency",
    "scan_skew",
    "unmapped_obstacle",
    "moved_obstacle",
    "missing_obstacle",
    "moved_wall",
    "map_scale",
    "range_drift",
    "self_occlusion",
    "tilt",
}
"""Deterministic effects whose gap in metres means something (drop-outs and mixtures are measured in nats)."""


def odometry(driven: Driven, effects: Sequence[Effect], stamps: Floats, base: float) -> Floats:
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


def outer_walls(room: Room) -> list[str]:
    """Return the names of the outer walls."""
    return [f"{ARENA}/edge_{i}" for i in range(len(room.rings[ARENA]))]
