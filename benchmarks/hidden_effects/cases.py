"""Cases of every suite, made from seeds: the run as the robot logs it, and the truth beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects import foreign
from benchmarks.hidden_effects.physics import CHANNEL, LIBRARY, SMOOTH, Effect, Scene, observe, odometry
from benchmarks.hidden_effects.robot import (
    PERIOD,
    STEP,
    Driven,
    Errand,
    Motors,
    RobotSpec,
    drive,
    make_robot,
    wrap,
)
from benchmarks.hidden_effects.strengths import MATERIALITY, Context, draw, ratio_of
from benchmarks.hidden_effects.world import Floats, Room, cast, make_room, walls_of
from logs import RangeSensor, Run

SUITES = ("none", "singles", "pairs", "triples", "foreign")
BACKGROUNDS = ("clean", "dirty", "wrong_tolerances")
STREAMS = {"dev": 0, "report": 1}
ROOT = 20261121
DURATION = 81.0
"""[s]"""
STRATA = (1, 4, 2, 5, 0, 3)
LEAST_CHANGED, LEAST_RMSE = 0.01, 1.02
"""A mark: this share of rays changed, or this RMS over the noise."""
APART = [
    {"range_bias", "range_drift", "map_scale", "range_scale"},
    {"range_scale", "map_scale", "moved_wall"},
    {"latency", "scan_skew"},
    {"moved_obstacle", "missing_obstacle"},
    {"people", "random_outliers"},
    {"max_range", "tilt"},
    {"glass", "mirror", "black_surface", "incidence_dropout"},
    {"min_range", "self_occlusion"},
    {"dead_time", "actuator_lag"},
    {"wheel_radius", "wheel_slip"},
]
"""Effects that may not be hidden together: each explains most of the other."""
LONELY = {
    "sonar_cone": {
        "mixed_pixels",
        "glass",
        "mirror",
        "black_surface",
        "incidence_dropout",
        "tilt",
        "people",
        "moved_obstacle",
        "missing_obstacle",
        "unmapped_obstacle",
        "mount_yaw",
        "scan_skew",
        "max_range",
    }
}


@dataclass(frozen=True, kw_only=True)
class CaseSpec:
    """Which case: everything else follows from it."""

    suite: str
    stream: str
    index: int
    background: str
    second: bool = False
    effect: str | None = None
    """A single or foreign effect by name, instead of the suite's turn."""
    strength: float | None = None
    """0...1 instead of the suite's turn."""

    @property
    def seed(self) -> int:
        """A seed from the stream of the suite; development and report never meet."""
        key = [ROOT, STREAMS[self.stream], SUITES.index(self.suite), self.index]
        return int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0] >> 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Background:
    """The imperfections of a set-up, as multiples of what a careful one has; 0 = none."""

    level: float = 0.0
    uniform: bool = False
    vertices: float = 0.0
    mount_xy: float = 0.0
    mount_yaw: float = 0.0
    camera: float = 1.0
    memory: float = 0.0
    tail: float = 0.0
    jitter: float = 0.0
    lost: float = 0.0


def make_specs(
    suite: str, stream: str, n: int, *, background: str | None = None, second: bool = False
) -> list[CaseSpec]:
    """Return the first n cases of a suite; without a background, every other one is dirty."""
    every = [background] if background else ["clean", "dirty"]
    return [
        CaseSpec(suite=suite, stream=stream, index=k, background=every[k % len(every)], second=second)
        for k in range(n)
    ]


def make_case(spec: CaseSpec) -> tuple[Run, Run | None, str, str, dict[str, Any]]:
    """Return (run, second run or None, arena GeoJSON, robot YAML, truth)."""
    seeds = np.random.SeedSequence(spec.seed).spawn(6)
    room_rng, robot_rng, path_rng, back_rng, effect_rng, noise_rng = map(np.random.default_rng, seeds)
    room, robot = make_room(room_rng), make_robot(robot_rng)
    background = _background(spec.background, back_rng)
    path_seed = int(path_rng.integers(2**62))
    setup = _Setup(
        room=room,
        robot=robot,
        background=background,
        seed=spec.seed,
        path_seed=path_seed,
        back_seed=int(back_rng.integers(2**62)),
    )
    nominal = setup.drive([])
    context = _context(setup, nominal)
    effects = _effects(spec, context, setup, nominal, effect_rng)
    run, truths = _record(setup, effects, context, int(noise_rng.integers(2**62)))
    second = None
    if spec.second:
        other = replace(setup, path_seed=int(path_rng.integers(2**62)))
        second, _ = _record(other, effects, context, int(noise_rng.integers(2**62)), marks=False)
    hidden = [effect.name for effect in effects if effect.name not in CHANNEL]
    truth = {
        "suite": spec.suite,
        "stream": spec.stream,
        "index": spec.index,
        "seed": spec.seed,
        "background": spec.background,
        "background_values": dict(vars(background)),
        "effects": [t for t in truths if t["name"] in CHANNEL],
        "foreign": hidden[0] if hidden else None,
        "foreign_effect": next((t for t in truths if t["name"] not in CHANNEL), None),
        "channel": next((_channel(e.name) for e in effects), None),
        "n_rays": int(run.ranges.size),
        "robot": {"n_rays": robot.n_rays, "rate": robot.rate, "sigma": robot.sigma, "fov": robot.fov},
    }
    return run, second, room.geojson(), robot.yaml(), truth


def _channel(name: str) -> str:
    return CHANNEL.get(name) or foreign.CHANNEL.get(name, "scan")


def _background(kind: str, rng: np.random.Generator) -> Background:
    if kind == "clean":
        return Background()
    levels = np.ones(7) if kind == "dirty" else rng.uniform(2.0, 3.0, size=7)
    return Background(
        level=float(levels.mean()),
        uniform=bool(rng.random() < 0.5),
        vertices=0.004 * float(levels[0]),
        mount_xy=0.0015 * float(levels[1]),
        mount_yaw=math.radians(0.03) * float(levels[2]),
        camera=float(levels[3]),
        memory=float(rng.uniform(0.6, 0.95)),
        tail=float(rng.uniform(0.02, 0.05) * levels[4]),
        jitter=0.003 * float(levels[5]),
        lost=0.001 * float(levels[6]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Setup:
    """A room, a robot in it, and what is not quite as the papers say."""

    room: Room
    robot: RobotSpec
    background: Background
    seed: int
    path_seed: int
    back_seed: int

    def drive(self, effects: Sequence[Effect]) -> Driven:
        """Drive the errand; effects of wheels and motors change the trip."""
        errand = Errand(room=self.room, rng=np.random.default_rng(self.path_seed))
        return drive(errand, self.robot, motors_of(self.robot, effects), DURATION)

    def true_room(self) -> Room:
        """Return the room as built: every vertex a little off the map."""
        rng, size = np.random.default_rng([self.back_seed, 1]), self.background.vertices
        if size == 0:
            return self.room
        rings = {}
        for name, ring in self.room.rings.items():
            off = (
                rng.uniform(-1, 1, ring.shape)
                if self.background.uniform
                else np.clip(rng.normal(size=ring.shape), -2, 2)
            )
            rings[name] = ring + size * off
        return Room(rings=rings)

    def true_mount(self) -> Floats:
        """Return the mount (3,) as built."""
        rng = np.random.default_rng([self.back_seed, 2])
        off = rng.uniform(-1, 1, 3) * [
            self.background.mount_xy,
            self.background.mount_xy,
            self.background.mount_yaw,
        ]
        return np.array(self.robot.mount) + off

    def scene(self, driven: Driven, stamps: Floats) -> Scene:
        """Return what a scan passes through."""
        return Scene(
            room=self.true_room(),
            robot=self.robot,
            driven=driven,
            mount=self.true_mount(),
            stamps=stamps,
            seed=self.seed,
        )


def motors_of(robot: RobotSpec, effects: Sequence[Effect]) -> Motors:
    """Return the motors with the effects that change them."""
    motors = Motors(tau=robot.tau)
    for effect in effects:
        p = {key: float(value or 0.0) for key, value in effect.parameters.items()}
        if effect.name == "actuator_lag":
            motors = replace(motors, tau=robot.tau + p["tau"])
        elif effect.name == "dead_time":
            motors = replace(motors, dead_time=p["L"])
        elif effect.name == "speed_saturation":
            motors = replace(motors, v_max=p["v_max"])
        elif effect.name == "wheel_slip":
            motors = replace(motors, slip=p["s"], slip_patch=(p["x"], p["y"], p["r"]))
        elif effect.name == "turn_deadband":
            motors = replace(motors, backlash=p["rate"])
        elif effect.name == "battery_sag":
            motors = replace(motors, late_gain=(p["t0"], p["gain"]))
    return motors


def _context(setup: _Setup, driven: Driven) -> Context:
    stamps = _scan_stamps(setup.robot)[::5]
    poses = np.repeat(driven.at(stamps), setup.robot.n_rays, axis=0)
    mount, phi = setup.robot.mount, poses[:, 2]
    c, s = np.cos(phi), np.sin(phi)
    origins = poses[:, :2] + np.stack([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1)
    walls = walls_of(setup.room)
    hits = cast(walls, origins, phi + mount[2] + np.tile(setup.robot.bearings, len(stamps)))
    hits = replace(hits, ranges=np.where(hits.ranges > setup.robot.range_max, np.inf, hits.ranges))
    return Context(room=setup.room, robot=setup.robot, driven=driven, hits=hits, wall_names=walls.names)


def _effects(
    spec: CaseSpec, context: Context, setup: _Setup, nominal: Driven, rng: np.random.Generator
) -> list[Effect]:
    if spec.suite == "none":
        return []
    if spec.suite == "foreign":
        order = np.random.default_rng([ROOT, STREAMS[spec.stream], 77]).permutation(foreign.FOREIGN)
        name = spec.effect or str(order[spec.index % len(order)])
        tools = {
            "room": context.room,
            "pick_wall": partial(context.pick_wall, least=0.08),
            "pick_obstacle": context.pick_obstacle,
        }
        return [foreign.DRAW[name](rng, tools)]
    if spec.suite == "singles":
        order = np.random.default_rng([ROOT, STREAMS[spec.stream], 78]).permutation(LIBRARY)
        name = spec.effect or str(order[spec.index % len(order)])
        row, turn = divmod(spec.index, len(order))
        # every block of 35 has all strengths; after 12 blocks every effect has had each, clean and dirty
        stratum = STRATA[(row + row // len(STRATA) + turn // 2) % len(STRATA)]
        strength = (
            spec.strength if spec.strength is not None else float((stratum + rng.random()) / len(STRATA))
        )
        return [draw(name, strength, context, rng)]
    return _several(2 if spec.suite == "pairs" else 3, context, setup, nominal, rng)


def are_compatible(names: Sequence[str]) -> bool:
    """Tell whether effects may be hidden together."""
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            if one == other or any({one, other} <= group for group in APART):
                return False
            if other in LONELY.get(one, ()) or one in LONELY.get(other, ()):
                return False
    return True


def _several(
    n: int, context: Context, setup: _Setup, nominal: Driven, rng: np.random.Generator
) -> list[Effect]:
    """Draw n compatible effects, each strong enough to leave a mark on its own."""
    chosen: list[Effect] = []
    for _ in range(60):
        name = str(rng.choice(LIBRARY))
        if not are_compatible([*(e.name for e in chosen), name]):
            continue
        effect = draw(name, float(rng.uniform(0.4, 1.0)), context, rng)
        if effect.place is not None and effect.place in {e.place for e in chosen}:
            continue
        truth = _truth(setup, effect, [effect], context, nominal)
        ratio = truth["materiality_ratio"]
        if truth["material"] and (ratio is None or ratio >= 1.5):
            chosen.append(effect)
        if len(chosen) == n:
            break
    return chosen


def _scan_stamps(robot: RobotSpec) -> Floats:
    return 0.5 + np.arange(round((DURATION - 1.0) * robot.rate)) / robot.rate


def _record(
    setup: _Setup, effects: Sequence[Effect], context: Context, noise_seed: int, *, marks: bool = True
) -> tuple[Run, list[dict[str, Any]]]:
    robot, background = setup.robot, setup.background
    scan_rng, pose_rng, wheel_rng = (np.random.default_rng([noise_seed, i]) for i in range(3))
    driven = setup.drive(effects)
    stamps = _scan_stamps(robot)
    shape = (len(stamps), robot.n_rays)
    normal = scan_rng.normal(size=shape)
    normal = np.where(scan_rng.random(shape) < background.tail, 3.0 * normal, normal)
    lost = (scan_rng.random(shape) < background.lost).astype(np.float64)
    taken = stamps + background.jitter * scan_rng.normal(size=len(stamps))
    ranges = observe(setup.scene(driven, taken), effects, (normal, lost))
    pose_stamps, poses = _reference(setup, driven, effects, pose_rng)
    odom_stamps = np.arange(PERIOD, DURATION - 1e-9, PERIOD)
    twists = odometry(driven, effects, odom_stamps, robot.base)
    twists += wheel_rng.normal(size=twists.shape) * [robot.sigma_v, robot.sigma_omega]
    run = Run(
        sensor=RangeSensor(
            bearings=robot.bearings,
            range_min=robot.range_min,
            range_max=robot.range_max,
            mount=np.array(robot.mount),
            sigma=robot.sigma,
            resolution=robot.resolution,
            rate=robot.rate,
            sweep_time=robot.sweep_time,
            height=robot.height,
        ),
        stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=poses,
        odom_stamps=odom_stamps,
        odometry=_integrate(twists),
        odom_twists=twists,
        cmd_stamps=driven.cmd_stamps,
        commands=driven.commands,
    )
    truths = [_truth(setup, effect, effects, context, driven) for effect in effects] if marks else []
    return run, truths


def _reference(
    setup: _Setup, driven: Driven, effects: Sequence[Effect], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    robot, background = setup.robot, setup.background
    stamps = np.arange(0.0, DURATION, 1 / robot.pose_rate)
    poses = _reported(driven, stamps, effects, setup.room)
    white = rng.normal(size=poses.shape)
    if background.memory > 0:
        rho = background.memory
        for i in range(1, len(white)):
            white[i] = rho * white[i - 1] + math.sqrt(1 - rho**2) * white[i]
    poses = poses + background.camera * white * [robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw]
    poses[:, 2] = wrap(poses[:, 2])
    return stamps, poses


def _reported(driven: Driven, stamps: Floats, effects: Sequence[Effect], room: Room) -> Floats:
    poses = driven.at(stamps)
    for effect in effects:
        if effect.name in foreign.POSES:
            poses = foreign.POSES[effect.name](effect, stamps, poses, driven, {"room": room})
    return poses


def _integrate(twists: Floats) -> Floats:
    turn = twists[:, 1] * PERIOD
    phi = np.cumsum(turn)
    middle = phi - turn / 2
    way = (twists[:, 0] * PERIOD * np.sinc(turn / (2 * np.pi)))[:, None]
    xy = np.cumsum(way * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)
    return np.concatenate([xy, wrap(phi)[:, None]], axis=1)


def _truth(
    setup: _Setup, effect: Effect, effects: Sequence[Effect], context: Context, driven: Driven
) -> dict[str, Any]:
    channel = _channel(effect.name)
    if channel == "scan":
        mark = _scan_mark(setup, effect, effects, driven)
    elif channel == "odometry":
        mark = _odometry_mark(setup, effect, effects, driven)
    else:
        mark = _drive_mark(setup, effect, effects, driven)
    parameters = dict(effect.parameters)
    ratio = ratio_of(effect, context)
    if effect.name == "people":
        parameters["p"] = mark["changed_share"]
        ratio = mark["changed_share"] / MATERIALITY["people"]
    if effect.name == "range_noise" or effect.name in ("people", "random_outliers"):
        is_marked = mark["changed_share"] >= 0.002 or mark["rmse_over_sigma"] >= LEAST_RMSE
    else:
        is_marked = mark["changed_share"] >= LEAST_CHANGED or mark["rmse_over_sigma"] >= LEAST_RMSE
    return {
        "name": effect.name,
        "channel": channel,
        "parameters": parameters,
        "location": {"name": effect.place, "xy": effect.xy} if effect.place or effect.xy else None,
        "materiality_ratio": ratio,
        "mark": mark,
        "material": bool(is_marked and (ratio is None or ratio >= 1.0)),
        "deterministic": effect.name in SMOOTH,
    }


def _mark(change: Floats, sigma: Any, flipped: Floats | None = None, extra: float = 0.0) -> dict[str, float]:
    """Summarise a change against the noise: share above half a sigma, RMS (extra: of a wider spread).

    `rmse_over_sigma` counts a change as five sigmas at most, or a few rays at depth edges would be all of it.
    """
    relative = change / sigma
    share = np.abs(relative) > 0.5 if flipped is None else (np.abs(relative) > 0.5) | flipped
    return {
        "changed_share": float(np.mean(share)),
        "rmse_over_sigma": float(np.sqrt(1 + np.mean(np.clip(relative, -5, 5) ** 2) + extra)),
        "raw_rmse_over_sigma": float(np.sqrt(1 + np.mean(relative**2) + extra)),
    }


def _scan_mark(setup: _Setup, effect: Effect, effects: Sequence[Effect], driven: Driven) -> dict[str, float]:
    stamps = _scan_stamps(setup.robot)[::2]  # every other scan: half the time
    rest = [e for e in effects if e is not effect]
    with_scene, without_scene = setup.scene(driven, stamps), setup.scene(driven, stamps)
    if effect.name in foreign.POSES:
        told = replace(driven, poses=_reported(driven, driven.stamps, effects, setup.room))
        without_scene = setup.scene(told, stamps)
    after, before = observe(with_scene, effects), observe(without_scene, rest)
    both = np.isfinite(after) & np.isfinite(before)
    change = np.where(both, np.where(both, after, 0.0) - np.where(both, before, 0.0), 0.0)
    flipped = np.isfinite(after) != np.isfinite(before)
    if effect.name == "quantisation":
        # the lattice itself is seen as soon as it is coarser than the stated one
        flipped = flipped | (np.abs(change) > setup.robot.resolution)
    wider = float(np.mean(with_scene.spread**2 / without_scene.spread**2)) - 1.0
    return _mark(change, setup.robot.sigma, flipped, extra=wider)


def _odometry_mark(
    setup: _Setup, effect: Effect, effects: Sequence[Effect], driven: Driven
) -> dict[str, float]:
    stamps = np.arange(PERIOD, DURATION - 1e-9, PERIOD)
    sigma = np.array([setup.robot.sigma_v, setup.robot.sigma_omega])
    if effect.name == "wheel_slip":
        inside = np.hypot(*(driven.at(stamps)[:, :2] - np.array(effect.xy)).T) < float(
            effect.parameters["r"] or 0
        )
        twists = odometry(driven, [], stamps, setup.robot.base)
        return _mark(twists * inside[:, None] * float(effect.parameters["s"] or 0), sigma)
    rest = [e for e in effects if e is not effect]
    change = odometry(driven, effects, stamps, setup.robot.base) - odometry(
        driven, rest, stamps, setup.robot.base
    )
    return _mark(change, sigma)


def _drive_mark(setup: _Setup, effect: Effect, effects: Sequence[Effect], driven: Driven) -> dict[str, float]:
    rest = [e for e in effects if e is not effect]
    change = _respond(driven, motors_of(setup.robot, effects)) - _respond(
        driven, motors_of(setup.robot, rest)
    )
    return _mark(change, np.array([setup.robot.sigma_v, setup.robot.sigma_omega]))


def _respond(driven: Driven, motors: Motors) -> Floats:
    """Return the wheel twists (n, 2) at the command rate for the commands given, open loop."""
    n = round(PERIOD / STEP)
    t = (np.arange(len(driven.stamps) - 1) + 0.5) * STEP
    held = np.floor((t - motors.dead_time) / PERIOD).astype(np.intp)
    u = np.where(held[:, None] >= 0, driven.commands[np.maximum(held, 0)], 0.0)
    u[:, 0] = np.clip(u[:, 0], -motors.v_max, motors.v_max)
    u[np.abs(u[:, 1]) < motors.backlash, 1] = 0.0
    u[t > motors.late_gain[0]] *= motors.late_gain[1]
    keep = math.exp(-STEP / motors.tau)
    out = lfilter([1 - keep], [1, -keep], u, axis=0)
    return np.asarray(out[::n], dtype=np.float64)
