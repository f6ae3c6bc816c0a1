"""What the robot logs: scans, reference poses, odometry and commands, each with its noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmarks.hidden_effects import foreign
from benchmarks.hidden_effects.case_setup import RUN_DURATION, CaseSetup, scan_stamps
from benchmarks.hidden_effects.physics import odometry
from benchmarks.hidden_effects.robot import COMMAND_PERIOD, TrueDrive, wrap
from benchmarks.hidden_effects.simulated_scan import HiddenEffect, observe
from benchmarks.hidden_effects.world import Floats, Room
from logs import RangeSensor, Run


def record(setup: CaseSetup, driven: TrueDrive, effects: Sequence[HiddenEffect], noise_seed: int) -> Run:
    """Return the run of a drive with these effects."""
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
    odom_stamps = np.arange(COMMAND_PERIOD, RUN_DURATION - 1e-9, COMMAND_PERIOD)
    twists = odometry(driven, effects, odom_stamps, robot.base)
    twists += wheel_rng.normal(size=twists.shape) * [robot.sigma_v, robot.sigma_omega]
    return Run(
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
            poses = foreign.POSE_EFFECTS[effect.name](effect, stamps, poses, driven, {"room": room})
    return poses


def _integrate(twists: Floats) -> Floats:
    turn = twists[:, 1] * COMMAND_PERIOD
    phi = np.cumsum(turn)
    middle = phi - turn / 2
    way = (twists[:, 0] * COMMAND_PERIOD * np.sinc(turn / (2 * np.pi)))[:, None]
    xy = np.cumsum(way * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)
    return np.concatenate([xy, wrap(phi)[:, None]], axis=1)
