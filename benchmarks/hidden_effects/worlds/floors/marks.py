"""What an effect leaves in the log, in units of the robot's noise."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.floors.base import drive
from benchmarks.hidden_effects.worlds.floors.scans import Scans
from benchmarks.hidden_effects.worlds.floors.scene import (
    RIM_LEFT,
    RIM_RIGHT,
    Odometry,
    Scene,
    pose_at,
)

WINDOW = 2.0
"""[s] over which odometry is compared with the truth."""
MOST_WINDOWS = 1500


def changed_rays(scene: Scene, plain: Scans, scans: Scans) -> tuple[float, float]:
    """Return the share of the rays changed by more than 3 sigma, and the rms change in sigma, each 10 at most."""
    sigma = scene.robot.sigma
    one, other = plain.ranges[scans.kept], scans.ranges[scans.kept]
    is_both = np.isfinite(one) & np.isfinite(other)
    off = np.where(is_both, np.where(is_both, one, 0.0) - np.where(is_both, other, 0.0), 0.0)
    is_lost = np.isfinite(one) != np.isfinite(other)
    share = float(((np.abs(off) > 3 * sigma) | is_lost).mean())
    return share, float(np.sqrt(np.mean(np.clip(off / sigma, -10, 10) ** 2)))


def odometry_error(scene: Scene, run: Floats, odometry: Odometry) -> float:
    """Return the rms error of the motion in windows of 2 s, in sigma of clean poses and wheels."""
    robot = scene.robot
    t = odometry.stamps[:: max(1, len(odometry.stamps) // MOST_WINDOWS)]
    t = t[(t > 0.5) & (t < scene.duration - 3)]

    def told(at: Floats) -> Floats:
        return np.column_stack([np.interp(at, odometry.stamps, odometry.poses[:, k]) for k in range(3)])

    def true(at: Floats) -> Floats:
        return np.column_stack(pose_at(run, at))

    error = _moved(told, t) - _moved(true, t)
    n = WINDOW * robot.odometry_rate
    wheel = robot.wheel_sigma / math.sqrt(2) / robot.odometry_rate * math.sqrt(n)
    turn = robot.wheel_sigma * math.sqrt(2) / robot.wheel_base / robot.odometry_rate * math.sqrt(n)
    sigma = math.hypot(math.sqrt(2) * robot.sigma_xy, wheel)
    sigma_turn = math.hypot(math.sqrt(2) * robot.sigma_yaw, turn)
    return float(np.sqrt(np.mean((error / (sigma, sigma, sigma_turn)) ** 2)))


def _moved(poses: Callable[[Floats], Floats], t: Floats) -> Floats:
    """Return the motion (n, 3) [m, m, rad] in the windows that begin at some times [s], in the frame of their first pose."""
    first, last = poses(t), poses(t + WINDOW)
    off = last - first
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    return np.column_stack([c * off[:, 0] + s * off[:, 1], -s * off[:, 0] + c * off[:, 1], off[:, 2]])


def drive_error(scene: Scene, run: Floats, commands: Floats) -> float:
    """Return how much larger than their noise errors of the speeds are, had the commands been given to a plain base."""
    robot = scene.robot
    plain, _ = drive(scene, None, commands)
    rims, plain_rims = (one[::10, RIM_LEFT : RIM_RIGHT + 1] for one in (run, plain))
    speed = rims.mean(1) - plain_rims.mean(1)
    turn = (np.diff(rims)[:, 0] - np.diff(plain_rims)[:, 0]) / robot.wheel_base
    off = np.column_stack([speed, turn])
    return float(np.sqrt(1 + np.mean((off / (robot.sigma_v, robot.sigma_omega)) ** 2)))


def pose_error(scene: Scene, poses: Floats, plain: Floats) -> float:
    """Return the rms change of the poses, in sigma."""
    robot = scene.robot
    off = poses - plain
    off[:, 2] = (off[:, 2] + math.pi) % (2 * math.pi) - math.pi
    return float(np.sqrt(np.mean((off / (robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw)) ** 2)))
