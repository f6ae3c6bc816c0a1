"""A room, a robot in it, and what is not quite as the papers say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.drive import Errand, TrueDrive, TrueMotors, drive
from benchmarks.hidden_effects.worlds.own.robot import RobotSpec
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, SimulatedScan
from benchmarks.hidden_effects.worlds.own.strengths import Context
from benchmarks.hidden_effects.worlds.own.world import Room, cast, walls_of

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
