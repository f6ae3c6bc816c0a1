"""The scans of a drive: when and whereto each ray leaves, what it meets, and what the laser makes of that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.log import Booleans, Floats
from benchmarks.hidden_effects.worlds.floors.effect import Effect
from benchmarks.hidden_effects.worlds.floors.scene import Rays, Setup, pose_at

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
    walls, names = setup.room.walls()
    rays = Rays(
        nominal=nominal,
        taken=taken,
        scan_times=scan_times,
        bearings=bearings,
        starts=np.stack([x + c * mount_x - s * mount_y, y + s * mount_x + c * mount_y], -1),
        directions=phi + mount_yaw + bearings,
        walls=walls,
        wall_names=names,
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
