"""What encoders count and how the base adds it up, and the pose reference: an overhead camera."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.floors.effect import Effect
from benchmarks.hidden_effects.worlds.floors.scene import (
    RIM_LEFT,
    RIM_RIGHT,
    STEP,
    TIME,
    Odometry,
    Setup,
    pose_at,
)

FIRST_STAMP = 0.02
"""[s]"""
LAST_STAMP = 0.25
"""[s] before the end of the run."""
MOST_JITTER = 0.002
"""[s]"""
STANDS_BELOW = 0.03
"""[m/s] of the rim below which a wheel's noise fades."""


def count(setup: Setup, run: Floats, effect: Effect | None = None) -> Odometry:
    """Return the odometry of a drive."""
    effect = effect or Effect()
    robot, background = setup.robot, setup.background
    rng = np.random.default_rng((*setup.seed, 2))
    period = 1 / robot.odometry_rate
    t = np.arange(FIRST_STAMP, setup.duration - LAST_STAMP, period)
    rims = run[:-1, RIM_LEFT : RIM_RIGHT + 1]
    turned = np.vstack([np.zeros(2), np.cumsum(rims * STEP, axis=0)])
    read = effect.read_times(t - background.odometry_age)
    travel = np.column_stack([np.interp(read, run[:, TIME], turned[:, k]) for k in (0, 1)])
    speed = np.abs(np.diff(travel, axis=0, prepend=travel[:1])) / period
    moving = np.minimum(1.0, speed / STANDS_BELOW)
    travel = travel + np.cumsum(rng.normal(size=travel.shape) * robot.wheel_sigma * period * moving, axis=0)
    travel = effect.encoders(t, travel)
    tick = robot.tick if background.is_dirty else robot.tick * 0.1
    counted = np.round(travel / tick) * tick
    steps = np.diff(counted, axis=0, prepend=counted[:1])
    way, turn = effect.increments(steps.mean(1), (steps[:, 1] - steps[:, 0]) / robot.wheel_base)
    heading = np.cumsum(turn)
    ahead = heading - turn if background.integration == "rect" else heading - turn / 2
    chord = np.sinc(turn / 2 / np.pi) if background.integration == "exact" else 1.0
    poses = np.column_stack(
        [np.cumsum(way * chord * np.cos(ahead)), np.cumsum(way * chord * np.sin(ahead)), heading]
    )
    jitter = rng.normal(size=len(t)) * background.odometry_jitter
    return effect.odometry(
        Odometry(
            stamps=t + np.clip(jitter, -MOST_JITTER, MOST_JITTER),
            poses=poses,
            twists=np.column_stack([way, turn]) / period,
        )
    )


FIRST_POSE = 0.01
"""[s]"""
LAST_POSE = 0.2
"""[s] before the end of the run."""
MOST_POSE_JITTER = 0.001
"""[s]"""


def observe(setup: Setup, run: Floats, effect: Effect | None = None) -> tuple[Floats, Floats]:
    """Return stamps (n,) [s] and poses (n, 3) [m, m, rad] of a drive."""
    effect = effect or Effect()
    robot, background = setup.robot, setup.background
    rng = np.random.default_rng((*setup.seed, 3))
    t = np.arange(FIRST_POSE, setup.duration - LAST_POSE, 1 / robot.pose_rate)
    poses = effect.poses(t, np.column_stack(pose_at(run, t)), run)
    noise = rng.normal(size=(len(t), 3))
    kept = background.pose_correlation
    if kept:
        for i in range(1, len(noise)):
            noise[i] = kept * noise[i - 1] + math.sqrt(1 - kept * kept) * noise[i]
    poses = poses + noise * (robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw)
    jitter = rng.normal(size=len(t)) * background.pose_jitter
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return t + np.clip(jitter, -MOST_POSE_JITTER, MOST_POSE_JITTER), poses
