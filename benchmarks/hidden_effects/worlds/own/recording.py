"""A room, a robot in it, what is not quite as the papers say, and what the robot logs: each with its noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.hidden_effects.geometry import Room, lasting
from benchmarks.hidden_effects.log import Floats, Log, Odometry
from benchmarks.hidden_effects.worlds.own import foreign
from benchmarks.hidden_effects.worlds.own.drive import Errand, TrueDrive, TrueMotors, drive, wrap
from benchmarks.hidden_effects.worlds.own.robot import BaseLoop, RobotSpec
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, SimulatedScan, observe, odometry
from benchmarks.hidden_effects.worlds.own.strengths import Context
from benchmarks.hidden_effects.worlds.own.world import cast, walls_of

RUN_DURATION = 81.0
"""[s]"""


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


def draw_background(kind: str, rng: np.random.Generator) -> Background:
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
class CaseSetup:
    """A room, a robot in it, and what is not quite as the papers say."""

    room: Room
    robot: RobotSpec
    background: Background
    seed: int
    path_seed: int
    back_seed: int

    def drive(self, effects: Sequence[HiddenEffect]) -> TrueDrive:
        """Drive the errand; effects of wheels and motors change the trip."""
        errand = Errand(room=self.room, rng=np.random.default_rng(self.path_seed))
        return drive(errand, self.robot, motors_of(self.robot, effects), RUN_DURATION)

    def true_room(self) -> Room:
        """Return the room as built: every vertex a little off the map."""
        rng, size = np.random.default_rng([self.back_seed, 1]), self.background.vertices
        if size == 0:
            return self.room

        def built(_: str, ring: Floats) -> Floats:
            if self.background.uniform:
                return ring + size * rng.uniform(-1, 1, ring.shape)
            return ring + size * np.clip(rng.normal(size=ring.shape), -2, 2)

        return self.room.changed(built)

    def true_mount(self) -> Floats:
        """Return the mount (3,) as built."""
        rng, one = np.random.default_rng([self.back_seed, 2]), self.background
        off = rng.uniform(-1, 1, 3) * [one.mount_xy, one.mount_xy, one.mount_yaw]
        return np.array(self.robot.mount) + off

    def scene(self, driven: TrueDrive, stamps: Floats) -> SimulatedScan:
        """Return what a scan passes through."""
        return SimulatedScan(
            room=self.true_room(),
            robot=self.robot,
            driven=driven,
            mount=self.true_mount(),
            stamps=stamps,
            seed=self.seed,
        )


def motors_of(robot: RobotSpec, effects: Sequence[HiddenEffect]) -> TrueMotors:
    """Return the motors with the effects that change them."""
    motors = TrueMotors(tau=robot.tau, base_loop=robot.base_loop)
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


def context_of(setup: CaseSetup, driven: TrueDrive) -> Context:
    stamps = scan_stamps(setup.robot)[::5]
    poses = np.repeat(driven.at(stamps), setup.robot.n_rays, axis=0)
    mount, phi = setup.robot.mount, poses[:, 2]
    c, s = np.cos(phi), np.sin(phi)
    origins = poses[:, :2] + np.stack([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1)
    walls = walls_of(setup.room)
    hits = cast(walls, origins, phi + mount[2] + np.tile(setup.robot.bearings, len(stamps)))
    hits = replace(hits, ranges=np.where(hits.ranges > setup.robot.range_max, np.inf, hits.ranges))
    return Context(room=setup.room, robot=setup.robot, driven=driven, hits=hits, wall_names=walls.names)


def scan_stamps(robot: RobotSpec) -> Floats:
    return 0.5 + np.arange(round((RUN_DURATION - 1.0) * robot.scan_rate)) / robot.scan_rate


def record(setup: CaseSetup, driven: TrueDrive, effects: Sequence[HiddenEffect], noise_seed: int) -> Log:
    """Return the log of a drive with these effects."""
    robot, background = setup.robot, setup.background
    scan_rng, pose_rng, wheel_rng = (np.random.default_rng([noise_seed, i]) for i in range(3))
    stamps = scan_stamps(robot)
    shape = (len(stamps), robot.n_rays)
    normal = scan_rng.normal(size=shape)
    normal = np.where(scan_rng.random(shape) < background.tail, 3.0 * normal, normal)
    lost = (scan_rng.random(shape) < background.lost).astype(np.float64)
    taken = stamps + background.jitter * scan_rng.normal(size=len(stamps))
    ranges = observe(setup.scene(driven, taken), effects, (normal, lost))
    pose_stamps, poses = _reference(setup, driven, effects, pose_rng)
    odom_stamps = np.arange(1 / robot.odom_rate, RUN_DURATION - 1e-9, 1 / robot.odom_rate)
    twists = odometry(driven, effects, odom_stamps, robot.wheel_base)
    twists += wheel_rng.normal(size=twists.shape) * [robot.sigma_v, robot.sigma_omega]
    if robot.base_loop is not None:
        twists = ticked(twists, robot.base_loop, robot.wheel_base)
    return Log(
        epoch_ns=0,
        **robot.of_log(),
        scan_stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=poses,
        odometry=Odometry(stamps=odom_stamps, poses=integrated(twists, robot), twists=twists),
        cmd_stamps=driven.cmd_stamps,
        commands=driven.commands,
    )


def _reference(
    setup: CaseSetup, driven: TrueDrive, effects: Sequence[HiddenEffect], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    robot, background = setup.robot, setup.background
    stamps = np.arange(0.0, RUN_DURATION, 1 / robot.pose_rate)
    poses = reported_poses(driven, stamps, effects, setup.room)
    noise = lasting(rng.normal(size=poses.shape), background.memory)
    poses = poses + background.camera * noise * [robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw]
    poses[:, 2] = wrap(poses[:, 2])
    return stamps, poses


def reported_poses(driven: TrueDrive, stamps: Floats, effects: Sequence[HiddenEffect], room: Room) -> Floats:
    poses = driven.at(stamps)
    for effect in effects:
        if effect.name in foreign.POSE_EFFECTS:
            law = foreign.POSE_EFFECTS[effect.name]
            poses = law(effect.parameters, stamps, poses, driven, room)
    return poses


def ticked(twists: Floats, loop: BaseLoop, base: float) -> Floats:
    """Return twists (n, 2) as encoders count them: each wheel's way in whole ticks."""
    v, omega = twists.T / loop.odom_rate
    wheels = np.cumsum(np.stack([v - omega * base / 2, v + omega * base / 2], axis=1), axis=0)
    counted = loop.tick * np.floor(wheels / loop.tick)
    left, right = np.diff(counted, axis=0, prepend=np.zeros((1, 2))).T * loop.odom_rate
    return np.stack([(left + right) / 2, (right - left) / base], axis=1)


def integrated(twists: Floats, robot: RobotSpec) -> Floats:
    """Add twists (n, 2) up to poses (n, 3), in one of the ways that drivers do."""
    kind = "exact" if robot.base_loop is None else robot.base_loop.integration
    turn = twists[:, 1] / robot.odom_rate
    phi = np.cumsum(turn)
    heading = phi - turn if kind == "rectangle" else phi - turn / 2
    way = twists[:, 0] / robot.odom_rate
    if kind == "exact":
        way = way * np.sinc(turn / (2 * np.pi))
    xy = np.cumsum(way[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.concatenate([xy, wrap(phi)[:, None]], axis=1)
