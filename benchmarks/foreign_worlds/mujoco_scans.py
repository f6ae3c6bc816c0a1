"""Scans of a drive: where the laser truly is at each ray, what it meets, and what the laser makes of that."""

from __future__ import annotations

import numpy as np

from benchmarks.foreign_worlds.hidden import Secrets
from benchmarks.foreign_worlds.mujoco_drive import Driven
from benchmarks.foreign_worlds.mujoco_laser import Laser, World, raw_ranges, walkers
from benchmarks.foreign_worlds.rooms import Floats, Room


def scans(
    driven: Driven,
    room: Room,
    laser: Laser,
    secrets: Secrets,
    stamps: Floats,
    *,
    dirty: bool,
    rng: np.random.Generator,
) -> Floats:
    """Return what the laser logs, (n_scans, n_rays) [m].

    Parameters
    ----------
    stamps : (n_scans,) [s] that the scans will carry; they are taken a little off these
    dirty : stamps jitter by 3 ms, a tenth of the noise has 2.5 times the width, 0.1 % of the rays are lost
    """
    duration = float(driven.times[-1])
    count = round(secrets.value("people", "count"))
    world = World(room, secrets, count)
    people = walkers(room, count, stamps, rng) if count else None
    taken = stamps - secrets.value("latency", "tau")
    if dirty:
        taken = taken + 0.003 * rng.normal(size=len(stamps))
    late = secrets.get("late_stamps")
    if late is not None:
        taken = taken - late["late"] * (rng.random(len(stamps)) < late["share"])
    sweep = secrets.value("scan_skew", "T") * np.arange(laser.n_rays) / (laser.n_rays - 1)
    mount = np.array(laser.mount) + laser.off
    mount += [
        secrets.value("mount_xy", "dx"),
        secrets.value("mount_xy", "dy"),
        secrets.value("mount_yaw", "delta"),
    ]
    curtain = secrets.get("curtain")
    out = np.zeros((len(stamps), laser.n_rays))
    for k, when in enumerate(taken):
        share = when / duration
        if people is not None:
            world.place_people(people[k])
        at = mount.copy()
        knocked = secrets.get("laser_knocked")
        if knocked is not None and share > knocked["when"]:
            at[2] += knocked["yaw"]
        bearings = laser.bearings * (1 + secrets.value("bearing_stretch", "s"))
        z, incidence = _sweep(world, driven, at, bearings, when, sweep, secrets, share, rng)
        if curtain is not None:
            on = world.on_part(world.cast(_origin(driven, at, when), _aim(driven, at, bearings, when))[2])
            z = z + on * curtain["sway"] * np.sin(2 * np.pi * when / curtain["period"]) / np.cos(incidence)
        out[k] = _measured(z, incidence, laser, secrets, when, duration, dirty=dirty, rng=rng, angles=_aim(driven, at, bearings, when))  # fmt: skip
    return out


def _origin(driven: Driven, mount: Floats, when: float) -> Floats:
    x, y, phi = driven.pose_at(np.array(when))
    c, s = np.cos(phi), np.sin(phi)
    return np.array([x + c * mount[0] - s * mount[1], y + s * mount[0] + c * mount[1]])


def _aim(driven: Driven, mount: Floats, bearings: Floats, when: float) -> Floats:
    return driven.pose_at(np.array(when))[2] + mount[2] + bearings


def _sweep(
    world: World,
    driven: Driven,
    mount: Floats,
    bearings: Floats,
    when: float,
    sweep: Floats,
    secrets: Secrets,
    share: float,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Cast one scan, in one shot or, where the laser sweeps, ray after ray."""
    if sweep[-1] == 0:
        angles = _aim(driven, mount, bearings, when)
        return raw_ranges(world, _origin(driven, mount, when), angles, secrets, share, rng)
    one_by_one = [
        raw_ranges(
            world, _origin(driven, mount, t), _aim(driven, mount, bearings[i : i + 1], t), secrets, share, rng
        )
        for i, t in enumerate(when + sweep)
    ]
    return np.array([z[0] for z, _ in one_by_one]), np.array([a[0] for _, a in one_by_one])


def _measured(
    z: Floats,
    incidence: Floats,
    laser: Laser,
    secrets: Secrets,
    when: float,
    duration: float,
    *,
    dirty: bool,
    rng: np.random.Generator,
    angles: Floats,
) -> Floats:
    """Return what the laser makes of true ranges."""
    value, bearings, n = secrets.value, laser.bearings, len(z)
    finite = np.where(np.isfinite(z), z, 0.0)
    z = (
        z * (1 + value("range_scale", "s"))
        + value("range_bias", "b")
        + value("range_drift", "b1") * when / duration
    )
    sector = secrets.get("sector_bias")
    if sector is not None:
        z = z + sector["b"] * ((bearings >= sector["theta1"]) & (bearings <= sector["theta2"]))
    cycle = secrets.get("phase_cycle")
    if cycle is not None:
        z = z + cycle["b"] * np.sin(2 * np.pi * finite / cycle["length"])
    normal = rng.normal(size=n)
    if dirty:
        normal = np.where(rng.random(n) < 0.1, 2.5, 1.0) * normal
    z = z + normal * np.hypot(laser.sigma, value("range_noise", "k") * finite)
    z = _lost_and_stray(z, incidence, laser, secrets, when, dirty=dirty, rng=rng, angles=angles)
    q = value("quantisation", "q") or laser.resolution
    z = np.where(np.isfinite(z), q * np.round(np.where(np.isfinite(z), z, 0.0) / q), z)
    low, high = (
        max(laser.range_min, value("min_range", "r_min")),
        min(laser.range_max, value("max_range", "R", 99.0)),
    )
    z = np.where(np.isfinite(z) & (z < low), np.inf if value("min_range", "r_min") else -np.inf, z)
    return np.where(z > high, np.inf, z)


def _lost_and_stray(
    z: Floats,
    incidence: Floats,
    laser: Laser,
    secrets: Secrets,
    when: float,
    *,
    dirty: bool,
    rng: np.random.Generator,
    angles: Floats,
) -> Floats:
    """Let rays be lost, or come back from somewhere else."""
    value, bearings, n = secrets.value, laser.bearings, len(z)
    if dirty:
        z = np.where(rng.random(n) < 0.001, np.inf, z)
    z = np.where(incidence > value("incidence_dropout", "alpha_max", 9.0), np.inf, z)
    sun = secrets.get("sunlight")
    if sun is not None:
        off = (angles - sun["towards"] + np.pi) % (2 * np.pi) - np.pi
        z = np.where((np.abs(off) < sun["width"]) & (rng.random(n) < 0.75), np.inf, z)
    p = value("random_outliers", "p")
    z = np.where(rng.random(n) < p, rng.uniform(0, laser.range_max, n), z) if p else z
    dust = secrets.get("dust")
    if dust is not None:
        echo = 0.1 + rng.exponential(dust["depth"], n)
        z = np.where((rng.random(n) < dust["p"]) & (echo < z), echo, z)
    ghost = secrets.get("crosstalk")
    if ghost is not None:
        off = (bearings - ghost["turn"] * when + np.pi) % (2 * np.pi) - np.pi
        seen = (np.abs(off) < ghost["width"]) & (rng.random(n) < 0.7)
        z = np.where(seen, np.minimum(z, ghost["r0"] + 0.02 * rng.normal(size=n)), z)
    post = secrets.get("self_occlusion")
    if post is not None:
        covered = (bearings >= post["theta1"]) & (bearings <= post["theta2"])
        z = np.where(covered, post["r0"] + laser.sigma * rng.normal(size=n), z)
    return z
