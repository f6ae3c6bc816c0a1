"""A case: a set-up, what is hidden, the mark that it leaves, the log and the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from benchmarks.hidden_effects.case import Case, Redraw, Spec, truth_of
from benchmarks.hidden_effects.library import DETERMINISTIC, LIBRARY, materiality_ratio
from benchmarks.hidden_effects.log import Floats, Log, Odometry
from benchmarks.hidden_effects.worlds.floors.base import drive
from benchmarks.hidden_effects.worlds.floors.effect import EFFECTS, Effect
from benchmarks.hidden_effects.worlds.floors.effects import FOREIGN, note_of
from benchmarks.hidden_effects.worlds.floors.logged import Scans, count, observe, scan
from benchmarks.hidden_effects.worlds.floors.rooms import FOLDER, Room, floor_files
from benchmarks.hidden_effects.worlds.floors.scene import (
    OMEGA,
    PHI,
    RIM_LEFT,
    RIM_RIGHT,
    Scene,
    V,
    X,
    Y,
    pose_at,
)
from benchmarks.hidden_effects.worlds.floors.setups import SEED, distances, draw_scene

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


SUITES = ("none", "singles", "foreign")
STREAM = "w3"
"""Name of this world in its files."""
FIRST_EPOCH = 1_760_000_000
"""[s] of case 0; each other begins 1000 s after the one before."""
ORDER_SEED = 5
MOST_ATTEMPTS = 60
MOST_TOUCH = 0.06
"""[m] that the footprint of a disturbed robot may overlap with a wall of the map."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Runs:
    """What is logged with an effect and without it."""

    effect: Effect
    run: Floats
    commands: Floats
    """As in `Scene`."""
    scans: Scans
    plain_scans: Scans
    """Of the same drive without the effect."""
    odometry: Odometry
    plain_odometry: Odometry
    """Of the drive without the effect."""
    pose_stamps: Floats
    poses: Floats
    """(n,) [s], (n, 3) [m, m, rad]"""
    plain_poses: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Mark:
    """What the effect has left."""

    channel: str
    changed_share: float = 0.0
    """Of the rays."""
    size: float
    """Of the change, over the noise."""
    growth: float = 1.0
    """Of the error of odometry or drive."""

    @property
    def told(self) -> dict[str, float]:
        """As the truth tells it."""
        return {
            "changed_share": round(self.changed_share, 5),
            "rmse_over_sigma": round(self.size, 4 if self.channel == "scan" else 3),
            "growth": round(self.growth, 3),
        }


def turns(suite: str) -> list[str]:
    """Return the names of the effects of a suite in their turn."""
    rng = np.random.default_rng(ORDER_SEED)
    shuffled = {"none": [""], "singles": list(LIBRARY), "foreign": list(FOREIGN)}
    for effects in shuffled.values():
        rng.shuffle(effects)
    return shuffled[suite]


def make(spec: Spec) -> Case:
    """Draw a case until its effect leaves a mark."""
    names = turns(spec.suite)
    kind = EFFECTS.get(spec.effect or names[spec.index % len(names)], Effect)
    is_dirty = spec.background_in_turn(len(names)) == "dirty"
    floors = floor_files(spec.floors or FOLDER)
    for attempt in range(1, MOST_ATTEMPTS + 1):
        try:
            scene = draw_scene(spec.suite, spec.index, is_dirty, attempt, floors)
            runs = _hide(scene, kind())
        except (Redraw, IndexError, ValueError):  # the latter two: no place for the effect
            continue
        mark = _mark(scene, runs)
        if _is_strong(spec.suite, runs, mark, attempt):
            return _case(spec, scene, runs, mark, attempt)
    raise RuntimeError(f"{kind.name}: no strong draw")


def _case(spec: Spec, scene: Scene, runs: Runs, mark: Mark, attempt: int) -> Case:
    robot, effect, kept = scene.robot, runs.effect, runs.scans.kept
    hidden = {
        "name": effect.name,
        "channel": effect.channel,
        "parameters": effect.parameters,
        "location": effect.location,
        "materiality_ratio": _rounded(materiality_ratio(effect.name, effect.parameters)),
        "mark": mark.told,
        "material": True,
        "deterministic": effect.name in DETERMINISTIC
        or (effect.name in LIBRARY and effect.channel != "scan"),
    }
    return Case(
        log=Log(
            epoch_ns=(FIRST_EPOCH + 1000 * spec.index) * 10**9,
            **robot.of_log(),
            twist_sigmas=(robot.sigma_v, robot.sigma_omega),
            scan_stamps=runs.scans.stamps[kept],
            ranges=runs.scans.ranges[kept],
            pose_stamps=runs.pose_stamps,
            poses=runs.poses,
            odometry=runs.odometry,
            cmd_stamps=runs.commands[:, 0],
            commands=runs.commands[:, 1:],
            arrival_seed=(SEED, spec.index),
        ),
        map={"arena.geojson": scene.plan.geojson()},
        robot=robot.yaml(),
        truth=truth_of(
            spec,
            [] if spec.suite == "none" else [hidden],
            is_foreign=spec.suite == "foreign",
            seed=SEED,
            stream=STREAM,
            background="dirty" if scene.background.is_dirty else "clean",
            n_rays=int(runs.scans.ranges[kept].size),
            note=note_of(effect),
            made=_made(scene, runs, attempt),
        ),
        world=STREAM,
        facts={"scene": scene, "runs": runs},
    )


def _rounded(ratio: float | None) -> float | None:
    return None if ratio is None else round(ratio, 4)


def _hide(scene: Scene, effect: Effect) -> Runs:
    """Log a run with an effect, and what it would have been without."""
    effect.setup(scene)
    run, commands = scene.run, scene.commands
    plain_odometry = count(scene, scene.run)
    if effect.channel in ("odometry", "drive"):
        run, commands = drive(scene, effect)
        if _least_clearance(scene.plan, run) < scene.robot.footprint - MOST_TOUCH:
            raise Redraw("touches")
    plain_scans, scans = scan(scene, run), scan(scene, run, effect)
    odometry = count(scene, run, effect)
    stamps, poses = observe(scene, run, effect)
    return Runs(
        effect=effect,
        run=run,
        commands=commands,
        scans=scans,
        plain_scans=plain_scans,
        odometry=odometry,
        plain_odometry=plain_odometry,
        pose_stamps=stamps,
        poses=poses,
        plain_poses=observe(scene, run)[1],
    )


def _least_clearance(room: Room, run: Floats) -> float:
    """Return how far the middle of the robot keeps from walls [m], less than nothing outside."""
    is_free = shapely.contains_xy(room.free(), run[::50, X], run[::50, Y])
    return float((distances(room, run) * np.where(is_free, 1, -1)).min())


def _mark(scene: Scene, runs: Runs) -> Mark:
    channel = runs.effect.channel
    if channel == "scan":
        share, size = changed_rays(scene, runs.plain_scans, runs.scans)
        return Mark(channel=channel, changed_share=share, size=size)
    if channel == "odometry":
        size = odometry_error(scene, runs.run, runs.odometry)
        plain = odometry_error(scene, scene.run, runs.plain_odometry)
        return Mark(channel=channel, size=size, growth=size / max(plain, 0.5))
    if channel == "drive":
        size = drive_error(scene, runs.run, runs.commands)
        return Mark(channel=channel, size=size, growth=size)
    return Mark(channel=channel, size=pose_error(scene, runs.poses, runs.plain_poses))


def _is_strong(suite: str, runs: Runs, mark: Mark, attempt: int) -> bool:
    """Return whether an effect is no fainter than it should be."""
    name, channel = runs.effect.name, runs.effect.channel
    if suite == "none":
        return True
    if suite == "singles":
        if name == "people":
            return bool(0.0034 <= runs.effect.parameters["p"] <= 0.04)
        if name == "unmapped_obstacle":
            return mark.changed_share >= 0.004
        if name == "moved_obstacle":
            return mark.changed_share >= 0.004 and mark.size > 0.35
        if channel == "scan":
            return mark.changed_share >= 0.008 or mark.size >= 0.45
        return mark.growth >= (1.8 if attempt < 20 else 1.4)
    if channel == "scan":
        return mark.changed_share >= 0.03 or mark.size >= 1.4
    if channel == "pose":
        return mark.size >= 3
    return mark.growth >= 2 and (channel == "drive" or mark.size >= 2.5)


def _made(scene: Scene, runs: Runs, attempt: int) -> dict[str, Any]:
    """Return the facts of the set-up and of its drive."""
    run, logged = runs.run, runs.scans.ranges[runs.scans.kept]
    turned = np.diff(run[:, PHI])
    is_turning = (np.abs(run[:, V]) < 0.02) & (np.abs(run[:, OMEGA]) > 0.1)
    with np.errstate(invalid="ignore"):  # what is lost less what is infinite
        noise = runs.plain_scans.ranges - runs.plain_scans.rays.ranges
    over_sigma = noise[np.isfinite(noise)] / scene.robot.sigma
    odometry = odometry_error(scene, scene.run, runs.plain_odometry)
    return {
        "room": scene.plan.floor,
        "robot": scene.robot.name,
        "style": scene.style,
        "duration": scene.duration,
        "way": round(scene.way, 1),
        "walls": len(runs.plain_scans.rays.walls),
        "furniture": len(scene.plan.furniture),
        "turned_left": round(float(turned[turned > 0].sum()), 1),
        "turned_right": round(float(-turned[turned < 0].sum()), 1),
        "share_turned_in_place": round(float(is_turning.mean()), 3),
        "reversed_share": round(float((run[:, V] < -0.02).mean()), 3),
        "control_period": scene.background.tick,
        "plain_residual_over_sigma": round(float(np.sqrt(np.mean(over_sigma**2))), 3),
        "odometry_2s_over_sigma": round(odometry, 3),
        "no_return_share": round(float((~np.isfinite(logged)).mean()), 4),
        "attempt": attempt,
        "least_clearance": round(scene.clearance, 3),
        "scans": len(logged),
        "odometry": {"integration": scene.background.integration, "age": scene.background.odometry_age},
    }
