"""The scans of a drive: when and whereto each ray leaves, what it meets, and what the laser makes of that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.log import Booleans, Floats, Ints
from benchmarks.hidden_effects.worlds.blind.base import OMEGA, PHI, X, Y
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import Secrets
from benchmarks.hidden_effects.worlds.blind.readings import BIASES, LOSSES, SCAN_FAULTS, Readings
from benchmarks.hidden_effects.worlds.blind.robots import Robot
from benchmarks.hidden_effects.worlds.blind.scene import Hits, Leg, Rays, Scene, incidence

FIRST_STAMP = 0.3
"""[s] of the first scan; the last begins twice this before the end of the drive."""
MOST_STAMP_JITTER = 0.0035
"""[s]"""
N_SUBRAYS = 25
"""A wide beam is so many rays."""


@dataclass(frozen=True, kw_only=True)
class Flaws:
    """What every careful set-up has; off at the defaults, and then the stamps are exact."""

    stamp_sigma: float = 0.0
    """[s]"""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """[m, m, rad] beyond robot.yaml."""
    range_bias: float = 0.0
    """[m]"""
    range_scale: float = 0.0
    wide_share: float = 0.0
    """Share of the readings with 2.5 times the noise."""
    lost_share: float = 0.0
    """Share of the readings that are lost."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scans:
    """What is logged, and what the rays truly met."""

    stamps: Floats
    """(n_scans,) [s]"""
    bearings: Floats
    """(n_rays,) [rad]"""
    ranges: Floats
    """(n_scans, n_rays) [m] as logged."""
    true_ranges: Floats
    """(n_scans, n_rays) [m]"""
    wall: Ints
    """(n_scans, n_rays) index of the wall met, -1: none."""
    along: Floats
    """(n_scans, n_rays) [m] from the wall's first end."""
    person_share: float
    """Share of the rays that ended at somebody."""


def scan(
    robot: Robot,
    driven: Driven,
    walls: Floats,
    secrets: Secrets,
    seed: int,
    flaws: Flaws | None,
    legs: tuple[Leg, ...] = (),
    corners: Floats | None = None,
) -> Scans:
    """Take all scans of a drive.

    Parameters
    ----------
    walls : (n_walls, 4) [m] of the true room
    seed : the same seed gives the same noise, whatever is hidden
    flaws : of a dirty set-up
    corners : (n, 2) [m] where readings are long, for `f_multipath`
    """
    n, n_scans = robot.n_rays, int((driven.duration - 2 * FIRST_STAMP) * robot.scan_rate)
    stamps = FIRST_STAMP + np.arange(n_scans) / robot.scan_rate
    taken = _taken(robot, driven, stamps, secrets, seed, flaws)
    index = np.arange(n)
    bearings = np.asarray(-robot.fov / 2 + robot.ray_step * index, dtype=np.float64)
    base = np.stack([driven.at(taken, column) for column in (X, Y, PHI)])  # (3, n_scans n_rays)
    mount_x, mount_y, mount_yaw = _mount(robot, taken, secrets, flaws)
    c, s = np.cos(base[2]), np.sin(base[2])
    readings = Readings(
        robot=robot,
        duration=driven.duration,
        stamps=np.repeat(stamps, n),
        taken=taken,
        bearings=np.tile(bearings, n_scans),
        x=base[0] + c * mount_x - s * mount_y,
        y=base[1] + s * mount_x + c * mount_y,
        corners=corners,
        seed=seed,
        n_scans=n_scans,
    )
    leaves = _leaves(readings, driven.at(taken, OMEGA), secrets)
    dip = _dip(base, mount_yaw, secrets, readings)
    if dip is not None:
        leaves, stretch, floor = _tilted(leaves, dip, robot.height)
    readings.direction = base[2] + mount_yaw + leaves
    hits = _meet(Scene(walls, secrets, legs), readings, secrets)
    readings.hits, true_ranges, ranges = hits, hits.ranges.copy(), hits.ranges
    for name, law in LOSSES.items():
        if name in secrets:
            ranges = law(readings, ranges, secrets[name])
    if dip is not None:
        ranges = np.minimum(ranges * stretch, floor)
    if "range_scale" in secrets:
        ranges = ranges * (1 + secrets["range_scale"]["s"])
    if flaws is not None:
        ranges = ranges * (1 + flaws.range_scale) + flaws.range_bias
    for name, law in BIASES.items():
        if name in secrets:
            ranges = law(readings, ranges, secrets[name])
    ranges = _told(readings, ranges, secrets, flaws).reshape(n_scans, n)
    for name, fault in SCAN_FAULTS.items():
        if name in secrets:
            fault(readings, ranges, secrets[name])
    return Scans(
        stamps=stamps,
        bearings=bearings,
        ranges=ranges,
        true_ranges=true_ranges.reshape(n_scans, n),
        wall=hits.wall.reshape(n_scans, n),
        along=hits.along.reshape(n_scans, n),
        person_share=float(hits.is_person.mean()),
    )


def _taken(
    robot: Robot, driven: Driven, stamps: Floats, secrets: Secrets, seed: int, flaws: Flaws | None
) -> Floats:
    """Return when each ray was truly taken (n_scans n_rays,) [s]."""
    taken = stamps
    if flaws is not None:
        jitter = np.random.default_rng([seed, 77, 1]).normal(0, flaws.stamp_sigma, stamps.size)
        taken = taken + np.clip(jitter, -MOST_STAMP_JITTER, MOST_STAMP_JITTER)
    if "latency" in secrets:
        taken = taken - secrets["latency"]["tau"]
    jump = secrets.get("f_clockjump")
    if jump is not None:
        taken = taken - jump["jump"] * ((stamps % jump["period"]) < jump["on"])
    if "f_clockdrift" in secrets:
        taken = taken - secrets["f_clockdrift"]["end"] * stamps / driven.duration
    sweep = robot.sweep_time + (secrets["scan_skew"]["T"] if "scan_skew" in secrets else 0)
    return np.asarray((taken[:, None] + sweep * np.arange(robot.n_rays) / robot.n_rays).ravel())


def _mount(
    robot: Robot, taken: Floats, secrets: Secrets, flaws: Flaws | None
) -> tuple[Floats | float, Floats | float, Floats | float]:
    x: Floats | float
    y: Floats | float
    yaw: Floats | float
    x, y, yaw = (one + off for one, off in zip(robot.mount, (flaws or Flaws()).mount, strict=True))
    if "mount_xy" in secrets:
        x, y = x + secrets["mount_xy"]["dx"], y + secrets["mount_xy"]["dy"]
    if "mount_yaw" in secrets:
        yaw = yaw + secrets["mount_yaw"]["delta"]
    knock = secrets.get("f_knock")
    if knock is not None:
        after = (taken > knock["t0"]).astype(np.float64)
        x, y, yaw = x + knock["dx"] * after, y + knock["dy"] * after, yaw + knock["da"] * after
    return x, y, yaw


def _leaves(readings: Readings, omega: Floats, secrets: Secrets) -> Floats:
    """Return the bearing at which each ray truly leaves (n,) [rad], the laser level."""
    leaves = readings.bearings
    if "f_fovscale" in secrets:
        leaves = leaves * (1 + secrets["f_fovscale"]["s"])
    ripple = secrets.get("f_ripple")
    if ripple is not None:
        leaves = leaves + ripple["A"] * np.sin(2 * leaves + ripple["ph"])
    if "f_vibration" in secrets:
        shake = np.repeat(readings.rng(11).normal(0, 1, readings.n_scans), readings.robot.n_rays)
        leaves = leaves + shake * secrets["f_vibration"]["k"] * np.abs(omega)
    return leaves


def _dip(
    base: Floats, mount_yaw: Floats | float, secrets: Secrets, readings: Readings
) -> tuple[Floats, Floats | float] | None:
    """Return how far the laser's plane dips (n,) [rad] and at which bearing [rad], or None if it is level."""
    if "f_ramp" in secrets:
        ramp = secrets["f_ramp"]
        off = np.hypot(base[0] - ramp["x"], base[1] - ramp["y"]) - ramp["r"]
        share = np.clip(1 - off / 0.25, 0, 1)
        return ramp["beta"] * share * share * (3 - 2 * share), ramp["dir"] - base[2] - mount_yaw
    if "tilt" in secrets:
        tilt = secrets["tilt"]
        return np.full(readings.taken.size, tilt["beta"]), tilt["theta0"]
    return None


def _tilted(
    leaves: Floats, dip: tuple[Floats, Floats | float], height: float
) -> tuple[Floats, Floats, Floats]:
    """Return bearings in the map's plane [rad], the stretch of ranges, and the range of the floor [m]."""
    beta, deepest = dip
    u, w = np.cos(leaves - deepest), np.sin(leaves - deepest)
    level = np.hypot(u * np.cos(beta), w)
    down = u * np.sin(beta)
    floor = np.where(down > 1e-6, height / np.maximum(down, 1e-6), np.inf)
    return deepest + np.arctan2(w, u * np.cos(beta)), 1 / level, floor


def _meet(scene: Scene, readings: Readings, secrets: Secrets) -> Hits:
    """Return what each beam meets; a wide one by the mean or the nearest of its rays."""
    chance = readings.rng(2).random(readings.taken.size)

    def meet(off: float) -> Hits:
        angle = readings.direction + off
        return scene.meet(
            Rays(
                x=readings.x,
                y=readings.y,
                dx=np.cos(angle),
                dy=np.sin(angle),
                stamps=readings.taken,
                chance=chance,
            )
        )

    cone, beam = secrets.get("sonar_cone"), secrets.get("mixed_pixels")
    wide = cone or beam
    if wide is None:
        return meet(0.0)
    total, nearest = np.zeros(readings.taken.size), np.full(readings.taken.size, np.inf)
    n_returns = np.zeros(readings.taken.size)
    for k, off in enumerate(np.linspace(-wide["gamma"], wide["gamma"], N_SUBRAYS)):
        hits = meet(off)
        ranges = hits.ranges
        if cone is not None:
            ranges = np.where(incidence(hits) > cone["alpha_max"], np.inf, ranges)
        returns = np.isfinite(ranges)
        total[returns] += ranges[returns]
        n_returns += returns
        nearest = np.minimum(nearest, ranges)
        if k == N_SUBRAYS // 2:
            middle = hits
    mean = np.where(n_returns > N_SUBRAYS // 2, total / np.maximum(n_returns, 1), np.inf)
    middle.ranges = nearest if cone is not None else mean
    return middle


def _told(readings: Readings, ranges: Floats, secrets: Secrets, flaws: Flaws | None) -> Floats:
    """Add noise and outliers, round, and keep to what the laser can see."""
    robot, n = readings.robot, ranges.size
    noise = readings.rng(4).normal(0, 1, n) * robot.sigma
    if flaws is not None:
        noise = noise * np.where(readings.rng(5).random(n) < flaws.wide_share, 2.5, 1.0)
    if "range_noise" in secrets:
        grown = np.where(np.isfinite(ranges), ranges, 0)
        noise = noise + readings.rng(6).normal(0, 1, n) * secrets["range_noise"]["k"] * grown
    told = ranges + noise
    if "random_outliers" in secrets:
        is_outlier = readings.rng(7).random(n) < secrets["random_outliers"]["p"]
        told = np.where(is_outlier, readings.rng(8).uniform(0, robot.range_max, n), told)
    if "max_range" in secrets:
        told = np.where(told > secrets["max_range"]["R"], np.inf, told)
    too_near: Booleans = np.zeros(n, dtype=bool)
    if "min_range" in secrets:
        too_near = told < secrets["min_range"]["r_min"]
    step = secrets["quantisation"]["q"] if "quantisation" in secrets else robot.resolution
    is_finite = np.isfinite(told)
    told = np.where(is_finite, np.round(np.where(is_finite, told, 0) / step) * step, told)
    told = np.where(told > robot.range_max, np.inf, told)
    told = np.where(told < robot.range_min, -np.inf, told)
    if "min_range" in secrets:
        told = np.where(too_near, float(secrets["min_range"].shapes["missing"]), told)
    if flaws is not None:
        told = np.where(readings.rng(9).random(n) < flaws.lost_share, np.inf, told)
    return told
