"""A case: a room, a drive, perhaps something hidden, and what a careful user would write into robot.yaml."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.hidden_effects.case import KINDS, Case, Spec
from benchmarks.hidden_effects.geometry import Room
from benchmarks.hidden_effects.log import Floats, Log, Odometry
from benchmarks.hidden_effects.worlds.simulators.hidden import (
    EPOCH_NS,
    SIGMA_XY,
    SIGMA_YAW,
    Hidden,
    Secrets,
    as_built,
    bent_by_lens,
    case_of,
    changed_room,
    draw_hidden,
    hidden_of,
    seen_by_camera,
    truth,
)
from benchmarks.hidden_effects.worlds.simulators.mujoco_drive import Base, Driven, bench_test, drive
from benchmarks.hidden_effects.worlds.simulators.mujoco_laser import Laser, Scanner
from benchmarks.hidden_effects.worlds.simulators.rooms import Pilot, draw_room

DURATION = 80.0
"""[s]"""
ROOT_SEED = 20261122
SUITES = ("none", "singles", "foreign")


def make(spec: Spec) -> Case:
    """Make a case."""
    name, n = hidden_of("mujoco", spec)
    background = spec.background_in_turn(n)
    dirty = background == "dirty"
    seed = [ROOT_SEED, KINDS.index(spec.kinds), SUITES.index(spec.suite), spec.index, int(dirty)]
    rng = np.random.default_rng(seed)
    room, base = draw_room(rng), _draw_base(rng)
    laser = Laser(
        n_rays=int(rng.choice([121, 181, 241])),
        fov=float(rng.choice([np.pi, 4.0, 4.7])),
        rate=float(rng.choice([5.0, 6.0])),
        mount=(round(float(rng.uniform(0.0, 0.15)), 3), 0.0, 0.0),
    )
    one = draw_hidden(name, room, rng) if name else None
    secrets = Secrets(one)
    radius, track, tau, delay = bench_test(base)
    built, passable = as_built(room, secrets, rng, dirty=dirty)
    if dirty:
        off = rng.uniform(-1, 1, 3) * [0.0015, 0.0015, math.radians(0.03)]
        laser = replace(laser, off=(float(off[0]), float(off[1]), float(off[2])))
    driven = drive(base, Pilot(passable, rng), secrets, DURATION, rng)
    stamps = 0.5 + np.arange(round((DURATION - 1.0) * laser.rate)) / laser.rate
    scanner = Scanner(driven=driven, room=built, laser=laser, secrets=secrets, dirty=dirty, rng=rng)
    ranges = scanner.scans(stamps)
    pose_stamps = np.arange(0.0, DURATION - 0.05, 1 / 30)
    log = Log(
        epoch_ns=EPOCH_NS,
        bearings=laser.bearings,
        range_limits=(laser.range_min, laser.range_max),
        scan_stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=_camera(driven, room, pose_stamps, secrets, dirty=dirty, rng=rng),
        odometry=_odometry(driven, base, radius, track, secrets),
        cmd_stamps=driven.cmd_stamps,
        commands=driven.commands,
    )
    told = [] if one is None else [truth(one, _mark(driven, room, laser, one, stamps))]
    robot = _robot_yaml(laser, base, radius, track, tau, delay)
    return case_of(spec, room, log, robot, told, seed=ROOT_SEED, background=background, base=vars(base))


def _mark(
    driven: Driven, room: Room, laser: Laser, one: Hidden | None, stamps: Floats
) -> dict[str, float] | None:
    """Return what an effect of the scans does to readings without noise; None of other channels.

    `changed_share` are the readings that it moves by more than three sigmas, takes or adds; `rmse_over_sigma` counts a
    change as five sigmas at most, or a few rays at depth edges would be all of it.
    """
    if one is None or one.channel != "scan":
        return None
    quiet = replace(laser, sigma=0.0)
    plain = Scanner(
        driven=driven, room=room, laser=quiet, secrets=Secrets(), dirty=False, rng=np.random.default_rng(0)
    )
    changed = replace(
        plain, room=changed_room(room, (one,)), secrets=Secrets(one), rng=np.random.default_rng(0)
    )
    with_it, without = changed.scans(stamps), plain.scans(stamps)
    if one.name == "range_noise":  # it moves no reading by itself
        far = one["k"] * np.where(np.isfinite(without), without, 0.0) / laser.sigma
        return {"changed_share": float((far > 1).mean()), "rmse_over_sigma": float(np.sqrt((far**2).mean()))}
    both = np.isfinite(with_it) & np.isfinite(without)
    off = np.abs(np.where(both, with_it, 0.0) - np.where(both, without, 0.0)) / laser.sigma
    off = np.where(both | (np.isfinite(with_it) == np.isfinite(without)), off, np.inf)
    return {
        "changed_share": float((off > 3).mean()),
        "rmse_over_sigma": float(np.sqrt((np.minimum(off, 5.0) ** 2).mean())),
    }


def _draw_base(rng: np.random.Generator) -> Base:
    return Base(
        control_period=float(rng.choice([0.02, 0.04])),
        transport=float(rng.uniform(0.002, 0.006)),
        tick=float(rng.choice([0.0002, 0.001, 0.002, 0.005])),
        odom_rate=float(rng.choice([20.0, 50.0])),
        integration=str(rng.choice(["rectangle", "midpoint", "exact"])),
    )


def _odometry(driven: Driven, base: Base, radius: float, track: float, secrets: Secrets) -> Odometry:
    """Count ticks, and integrate them as one of three common drivers does; the twist is that of the last period."""
    stamps = np.arange(1 / base.odom_rate, DURATION - 0.1, 1 / base.odom_rate)
    angle = driven.wheels_at(stamps - secrets.value("pose_clock_offset", "tau"))
    angle = angle + np.array([1.0, 0.0]) * secrets.value("eccentric_wheel", "e") * np.sin(angle)
    missed = secrets.get("missed_ticks")
    if missed is not None:
        speed = np.abs(np.gradient(angle, 1 / base.odom_rate, axis=0))
        lost = np.where(speed > missed["above"] * speed.max(), missed["share"], 0.0)
        angle = np.cumsum(np.diff(angle, axis=0, prepend=angle[:1]) * (1 - lost * [1.0, 1.0]), axis=0)
    rim = base.tick * np.floor(angle * radius / base.tick)
    steps = np.diff(rim, axis=0, prepend=rim[:1])
    way, turn = steps.mean(axis=1), (steps[:, 1] - steps[:, 0]) / track
    phi = np.cumsum(turn)
    before = phi - turn
    middle = {"rectangle": before, "midpoint": before + turn / 2, "exact": before + turn / 2}[
        base.integration
    ]
    chord = way * np.sinc(turn / (2 * np.pi)) if base.integration == "exact" else way
    xy = np.cumsum(chord[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)
    poses = np.column_stack([xy, np.arctan2(np.sin(phi), np.cos(phi))])
    return Odometry(stamps=stamps, poses=poses, twists=np.column_stack([way, turn]) * base.odom_rate)


def _camera(
    driven: Driven, room: Room, stamps: Floats, secrets: Secrets, *, dirty: bool, rng: np.random.Generator
) -> Floats:
    """Return what the overhead camera logs; filters make its noise last for some ten frames."""
    poses = bent_by_lens(driven.pose_at(stamps), room, secrets.value("lens_distortion", "edge"))
    knocked = secrets.get("camera_knocked")
    if knocked is not None:
        moved = stamps > knocked["when"] * DURATION
        poses[moved] += [knocked["shift"], -0.5 * knocked["shift"], knocked["yaw"]]
    noise = rng.normal(size=poses.shape)
    return seen_by_camera(poses, noise, float(rng.uniform(0.75, 0.92)) if dirty else 0.0)


def _robot_yaml(laser: Laser, base: Base, radius: float, track: float, tau: float, delay: float) -> str:
    """Return the robot as its bench test and data sheets describe it."""
    # one wheel's travel between two readings of an encoder is off by the difference of two uniform errors
    rim = base.tick / math.sqrt(6) * base.odom_rate
    return f"""name: foreign
drive: diff
footprint_radius: 0.25
limits: {{v: 0.4, omega: 1.0, a: 0.5, alpha: 2.0}}
sensor: {{mount: [{laser.mount[0]}, 0.0, 0.0], n_rays: {laser.n_rays}, fov: {laser.fov}, range_min: {laser.range_min},
  range_max: {laser.range_max}, sigma: {laser.sigma}, resolution: {laser.resolution}, rate: {laser.rate}, height: 0.3}}
pose: {{rate: 30.0, sigma_xy: {SIGMA_XY}, sigma_yaw: {SIGMA_YAW}}}
wheels: {{radius: {radius:.5f}, base: {track:.5f}, sigma_v: {rim / math.sqrt(2):.5f},
  sigma_omega: {rim * math.sqrt(2) / track:.5f}, rate: {base.odom_rate}}}
actuators: {{tau: {tau:.4f}, delay: {delay:.4f}}}
tolerances: {{control_period: {base.control_period}, transport_jitter: {base.transport:.4f}}}
"""
