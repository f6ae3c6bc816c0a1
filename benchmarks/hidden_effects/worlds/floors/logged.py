"""What is logged: odometry, the pose reference, and scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.geometry import lasting, wrapped
from benchmarks.hidden_effects.log import Booleans, Floats, Odometry
from benchmarks.hidden_effects.worlds.floors.effect import Effect
from benchmarks.hidden_effects.worlds.floors.scene import (
    RIM_LEFT,
    RIM_RIGHT,
    STEP,
    TIME,
    Rays,
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
    noise = lasting(rng.normal(size=(len(t), 3)), background.pose_correlation)
    poses = poses + noise * (robot.sigma_xy, robot.sigma_xy, robot.sigma_yaw)
    jitter = rng.normal(size=len(t)) * background.pose_jitter
    poses[:, 2] = wrapped(poses[:, 2])
    return t + np.clip(jitter, -MOST_POSE_JITTER, MOST_POSE_JITTER), poses


MARGIN = 0.6
"""[s] without a scan at the beginning and at the end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scans:
    """What the laser tells, and the rays behind it."""

    stamps: Floats
    """(n_scans,) [s]"""
    ranges: Floats
    """(n_scans, n_rays) [m]; +inf nothing came back, -inf too near."""
    kept: Booleans
    """(n_scans,) whether it is logged."""
    rays: Rays


def aim(setup: Setup, run: Floats, effect: Effect | None = None) -> Rays:
    """Return the rays of all scans, and what they meet."""
    effect = effect or Effect()
    robot, background = setup.robot, setup.background
    scan_times = np.arange(MARGIN + 0.3 * background.phase, setup.duration - MARGIN, 1 / robot.scan_rate)
    sweep = robot.sweep_time * np.arange(robot.n_rays)[None] / robot.n_rays
    taken = effect.times(scan_times[:, None] + sweep)
    x, y, yaw = (
        np.full(taken.shape, told + off) for told, off in zip(robot.mount, background.mount, strict=True)
    )
    mount_x, mount_y, mount_yaw = effect.mount(taken, (x, y, yaw))
    nominal = np.broadcast_to(robot.bearings, taken.shape)
    bearings = effect.bearing(taken, nominal)
    x, y, phi = pose_at(run, taken)
    c, s = np.cos(phi), np.sin(phi)
    rays = Rays(
        nominal=nominal,
        taken=taken,
        scan_times=scan_times,
        bearings=bearings,
        starts=np.stack([x + c * mount_x - s * mount_y, y + s * mount_x + c * mount_y], -1),
        directions=phi + mount_yaw + bearings,
        walls=setup.room.walls,
        rng=np.random.default_rng((*setup.seed, 5)),
    )
    effect.meet(rays)
    return rays


def scan(setup: Setup, run: Floats, effect: Effect | None = None) -> Scans:
    """Take all scans of a drive."""
    effect = effect or Effect()
    robot, background = setup.robot, setup.background
    rng = np.random.default_rng((*setup.seed, 4))
    rays = aim(setup, run, effect)
    n_scans = len(rays.scan_times)
    if background.is_jitter_normal:
        jitter = np.clip(rng.normal(size=n_scans), -2, 2)
    else:
        jitter = rng.uniform(-1.8, 1.8, n_scans)
    effect.ideal(rays)
    is_hit = np.isfinite(rays.ranges)
    true = np.where(is_hit, rays.ranges, 0.0)
    noise = rng.normal(size=true.shape)
    is_wide = rng.random(true.shape) < background.wide_share
    noise = np.where(is_wide, rng.normal(size=true.shape) * 3, noise)
    is_lost = rng.random(true.shape) < background.lost_share
    rays.spare_noise = rng.normal(size=true.shape)
    sigma = robot.sigma * np.sqrt(1 + (background.noise_growth * true / robot.sigma) ** 2)
    ranges = effect.noisy(rays, np.where(is_hit, true + sigma * noise, np.inf))
    ranges[is_lost] = np.inf
    ranges = np.where(ranges > robot.range_max, np.inf, ranges)
    ranges = np.where(ranges < robot.range_min, -np.inf, ranges)
    ranges = np.round(ranges / robot.resolution) * robot.resolution
    return Scans(
        ranges=effect.driver(rays, ranges),
        stamps=rays.scan_times + background.stamp_jitter * jitter,
        kept=effect.outages(np.ones(n_scans, bool)),
        rays=rays,
    )
