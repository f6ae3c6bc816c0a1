"""What the robot logs: scans, reference poses, odometry and commands, each with its noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmarks.hidden_effects.log import Floats, Log
from benchmarks.hidden_effects.worlds.own import foreign
from benchmarks.hidden_effects.worlds.own.case_setup import RUN_DURATION, CaseSetup, scan_stamps
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive, wrap
from benchmarks.hidden_effects.worlds.own.physics import odometry
from benchmarks.hidden_effects.worlds.own.robot import BaseLoop, RobotSpec
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, observe
from benchmarks.hidden_effects.worlds.own.world import Room


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
        bearings=robot.bearings,
        range_limits=(robot.range_min, robot.range_max),
        sweep_time=robot.sweep_time,
        scan_period=1 / robot.scan_rate,
        mount=(*robot.mount[:2], robot.height, robot.mount[2]),
        scan_stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=poses,
        odom_stamps=odom_stamps,
        odometry=integrated(twists, robot),
        twists=twists,
        cmd_stamps=driven.cmd_stamps,
        commands=driven.commands,
    )


def _reference(
    setup: CaseSetup, driven: TrueDrive, effects: Sequence[HiddenEffect], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    robot, background = setup.robot, setup.background
    stamps = np.arange(0.0, RUN_DURATION, 1 / robot.pose_rate)
    poses = reported_poses(driven, stamps, effects, setup.room)
    white = rng.normal(size=poses.shape)
    if background.memory > 0:
        rho = background.memory
        for i in range(1, len(white)):
            white[i] = rho * white[i - 1] + math.sqrt(1 - rho**2) * white[i]
    poses = poses + background.camera * white * [robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw]
    poses[:, 2] = wrap(poses[:, 2])
    return stamps, poses


def reported_poses(driven: TrueDrive, stamps: Floats, effects: Sequence[HiddenEffect], room: Room) -> Floats:
    poses = driven.at(stamps)
    for effect in effects:
        if effect.name in foreign.POSE_EFFECTS:
            poses = foreign.POSE_EFFECTS[effect.name](
                effect.parameters, stamps, poses, driven, {"room": room}
            )
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
