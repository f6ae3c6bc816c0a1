"""The pose reference: an overhead camera that sees where the robot is."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.raycast import Floats
from benchmarks.blind_buildings.scene import Setup, pose_at

FIRST_STAMP = 0.01
"""[s]"""
LAST_STAMP = 0.2
"""[s] before the end of the run."""
MOST_JITTER = 0.001
"""[s]"""


def observe(setup: Setup, run: Floats, effect: Effect | None = None) -> tuple[Floats, Floats]:
    """Return stamps (n,) [s] and poses (n, 3) [m, m, rad] of a drive."""
    effect = effect or Effect()
    robot, background = setup.robot, setup.background
    rng = np.random.default_rng((*setup.seed, 3))
    t = np.arange(FIRST_STAMP, setup.duration - LAST_STAMP, 1 / robot.pose_rate)
    poses = effect.poses(t, np.column_stack(pose_at(run, t)), run)
    noise = rng.normal(size=(len(t), 3))
    kept = background.pose_correlation
    if kept:
        for i in range(1, len(noise)):
            noise[i] = kept * noise[i - 1] + math.sqrt(1 - kept * kept) * noise[i]
    poses = poses + noise * (robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw)
    jitter = rng.normal(size=len(t)) * background.pose_jitter
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return t + np.clip(jitter, -MOST_JITTER, MOST_JITTER), poses
