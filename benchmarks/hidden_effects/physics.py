"""The physics of every effect of the library, and of the wheels' odometry; `foreign.py` holds what the library lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.hidden_effects.drive import TrueDrive
from benchmarks.hidden_effects.simulated_scan import (
    DETECTION_STAGE,
    FINAL_STAGE,
    GEOMETRY_STAGE,
    NOISE_STAGE,
    RANGE_STAGE,
    RAY_STAGE,
    SURFACE_STAGE,
    TIME_STAGE,
    HiddenEffect,
    SimulatedScan,
    stage,
)
from benchmarks.hidden_effects.world import ARENA, Floats, Room, cast, disc_range, shift_edge

# geometry


@stage(GEOMETRY_STAGE, "map_scale")
def _map_scale(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    c = scene.room.centroid
    scene.room = Room(rings={name: c + (1 + p["s"]) * (ring - c) for name, ring in scene.room.rings.items()})


@stage(GEOMETRY_STAGE, "moved_wall")
def _moved_wall(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    name, i = str(effect.place).split("/edge_")
    scene.room = scene.room.with_ring(name, shift_edge(scene.room.rings[name], int(i), p["d"]))


@stage(GEOMETRY_STAGE, "moved_obstacle")
def _moved_obstacle(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    name = str(effect.place)
    scene.room = scene.room.with_ring(name, scene.room.rings[name] + np.array([p["dx"], p["dy"]]))


@stage(GEOMETRY_STAGE, "missing_obstacle")
def _missing_obstacle(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.room = scene.room.with_ring(str(effect.place), None)


@stage(GEOMETRY_STAGE, "unmapped_obstacle")
def _unmapped_obstacle(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.discs.append((p["x"], p["y"], p["r"]))


@stage(GEOMETRY_STAGE, "people")
def _people(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.walkers += effect.extra["walkers"]


# time and ray


@stage(TIME_STAGE, "latency")
def _latency(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.times = scene.times - p["tau"]


@stage(TIME_STAGE, "scan_skew")
def _scan_skew(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    n = scene.robot.n_rays
    scene.times = scene.times + p["T"] * np.arange(n) / n


@stage(RAY_STAGE, "mount_yaw")
def _mount_yaw(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.bearings = scene.bearings + p["delta"]


@stage(RAY_STAGE, "mount_xy")
def _mount_xy(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.mount = scene.mount + np.array([p["dx"], p["dy"], 0.0])


# surfaces


@stage(SURFACE_STAGE, "glass")
def _glass(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    through = scene.on(effect) & (scene.incidence > p["alpha_ret"])
    behind = np.inf if p["depth"] is None else p["depth"]
    scene.true = np.where(through, scene.true + behind / np.cos(scene.incidence), scene.true)


@stage(SURFACE_STAGE, "mirror")
def _mirror(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    on = np.flatnonzero(scene.on(effect) & np.isfinite(scene.true))
    if len(on) == 0:
        return
    w = scene.wall[on]
    e = scene.walls.b[w] - scene.walls.a[w]
    wall_angle = np.arctan2(e[:, 1], e[:, 0])
    out = scene.angles[on]
    first = scene.true[on]
    hit = scene.origins[on] + first[:, None] * np.stack([np.cos(out), np.sin(out)], axis=1)
    bounced = 2 * wall_angle - out
    start = hit + 1e-6 * np.stack([np.cos(bounced), np.sin(bounced)], axis=1)
    hits = cast(scene.walls, start, bounced)
    second = hits.ranges
    for x, y, r in scene.discs:
        second = np.minimum(second, disc_range(start, bounced, np.array([x, y]), r))
    true, incidence = scene.true.copy(), scene.incidence.copy()
    true[on], incidence[on] = first + second, hits.incidence
    scene.true, scene.incidence = true, incidence


# range


@stage(RAY_STAGE, "tilt")
def _dip(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    """Look where rays of the dipped plane go as seen from above."""
    level, _ = _dipped(scene.stated, p)
    scene.bearings = scene.bearings + np.angle(level * np.exp(-1j * scene.stated))


@stage(RANGE_STAGE, "tilt")
def _tilt(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    level, down = _dipped(scene.stated, p)
    with np.errstate(divide="ignore"):
        floor = np.where(down > 1e-6, scene.robot.height / np.maximum(down, 1e-6), np.inf)
    scene.ranges = np.minimum(scene.ranges / np.abs(level), floor)


def _dipped(bearings: Floats, p: Mapping[str, Any]) -> tuple[Any, Floats]:
    """Return the horizontal part of unit rays of a dipped plane, as complex numbers, and how far down they point."""
    towards = np.exp(1j * p["theta0"])
    ray = np.exp(1j * bearings) / towards
    return (ray.real * np.cos(p["beta"]) + 1j * ray.imag) * towards, ray.real * np.sin(p["beta"])


@stage(RANGE_STAGE, "self_occlusion")
def _self_occlusion(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    inside = (scene.stated >= p["theta1"]) & (scene.stated <= p["theta2"])
    scene.ranges = np.where(inside, np.minimum(scene.ranges, p["r0"]), scene.ranges)


@stage(RANGE_STAGE, "range_scale")
def _range_scale(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges * (1 + p["s"])


@stage(RANGE_STAGE, "range_bias")
def _range_bias(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["b"]


@stage(RANGE_STAGE, "sector_bias")
def _sector_bias(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    inside = (scene.stated >= p["theta1"]) & (scene.stated <= p["theta2"])
    scene.ranges = scene.ranges + np.where(inside, p["b"], 0.0)


@stage(RANGE_STAGE, "range_drift")
def _range_drift(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    t = scene.clock - scene.stamps[0]
    whole = scene.stamps[-1] - scene.stamps[0]
    share = 1 - np.exp(-t / p["tau"]) if "tau" in p else t / whole
    scene.ranges = scene.ranges + p["b1"] * share


# detection


@stage(DETECTION_STAGE, "black_surface")
def _black_surface(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    chance = np.minimum(1.0, np.cos(scene.incidence) * (p["r0"] / np.maximum(scene.true, 1e-6)) ** 2)
    lost = scene.on(effect) & (scene.rng(effect).random(len(chance)) > chance)
    scene.ranges = np.where(lost, np.inf, scene.ranges)


@stage(DETECTION_STAGE, "incidence_dropout")
def _incidence_dropout(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = np.where(scene.incidence > p["alpha_max"], np.inf, scene.ranges)


@stage(DETECTION_STAGE, "max_range")
def _max_range(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = np.where(scene.true > p["R"], np.inf, scene.ranges)


@stage(DETECTION_STAGE, "min_range")
def _min_range(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = np.where(scene.true < p["r_min"], effect.extra["reads"], scene.ranges)


# noise


@stage(NOISE_STAGE, "range_noise")
def _range_noise(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    r = np.where(np.isfinite(scene.true), scene.true, 0.0)
    scene.spread = np.sqrt(scene.spread**2 + (p["k"] * r) ** 2)


@stage(FINAL_STAGE, "random_outliers")
def _random_outliers(scene: SimulatedScan, effect: HiddenEffect, z: Floats) -> Floats:
    rng = scene.rng(effect)
    stray = rng.random(len(z)) < effect.parameters["p"]  # type: ignore[operator]
    return np.where(stray, rng.uniform(0, scene.robot.range_max, len(z)), z)


@stage(FINAL_STAGE, "quantisation")
def _quantisation(scene: SimulatedScan, effect: HiddenEffect, z: Floats) -> Floats:
    q = float(effect.parameters["q"] or 0.0)
    with np.errstate(invalid="ignore"):
        return q * np.round(z / q)


SCAN_EFFECTS = [
    "range_bias",
    "range_scale",
    "range_noise",
    "sector_bias",
    "mount_yaw",
    "mount_xy",
    "latency",
    "scan_skew",
    "mixed_pixels",
    "glass",
    "mirror",
    "black_surface",
    "incidence_dropout",
    "max_range",
    "min_range",
    "quantisation",
    "unmapped_obstacle",
    "moved_obstacle",
    "missing_obstacle",
    "moved_wall",
    "map_scale",
    "people",
    "range_drift",
    "sonar_cone",
    "self_occlusion",
    "tilt",
    "random_outliers",
]
ODOMETRY_EFFECTS = ["wheel_radius", "wheel_radius_diff", "wheel_base", "wheel_slip", "pose_clock_offset"]
DRIVE_EFFECTS = ["actuator_lag", "dead_time", "speed_saturation"]
LIBRARY = [*SCAN_EFFECTS, *ODOMETRY_EFFECTS, *DRIVE_EFFECTS]
CHANNEL = {
    **dict.fromkeys(SCAN_EFFECTS, "scan"),
    **dict.fromkeys(ODOMETRY_EFFECTS, "odometry"),
    **dict.fromkeys(DRIVE_EFFECTS, "drive"),
}
DETERMINISTIC = {
    "range_bias",
    "range_scale",
    "sector_bias",
    "mount_yaw",
    "mount_xy",
    "latency",
    "scan_skew",
    "unmapped_obstacle",
    "moved_obstacle",
    "missing_obstacle",
    "moved_wall",
    "map_scale",
    "range_drift",
    "self_occlusion",
    "tilt",
}
"""Deterministic effects whose gap in metres means something (drop-outs and mixtures are measured in nats)."""


def odometry(driven: TrueDrive, effects: Sequence[HiddenEffect], stamps: Floats, base: float) -> Floats:
    """Return twists (n, 2) [m/s, rad/s]: mean wheel motion over the interval before each stamp, no noise."""
    late = sum(float(e.parameters["tau"] or 0.0) for e in effects if e.name == "pose_clock_offset")
    step = float(stamps[1] - stamps[0])
    twists = (driven.travelled(stamps - late) - driven.travelled(stamps - late - step)) / step
    v, omega = twists[:, 0].copy(), twists[:, 1].copy()
    for effect in effects:
        s = float(effect.parameters.get("s") or 0.0)
        if effect.name == "wheel_radius":
            v, omega = v * (1 + s), omega * (1 + s)
        elif effect.name == "wheel_radius_diff":
            omega = omega + s * v / base
        elif effect.name == "wheel_base":
            omega = omega / (1 + s)
        elif effect.name == "odom_scale_jump":
            late_part = stamps > effect.extra["t0"]
            v, omega = np.where(late_part, v * (1 + s), v), np.where(late_part, omega * (1 + s), omega)
    return np.stack([v, omega], axis=1)


def outer_walls(room: Room) -> list[str]:
    """Return the names of the outer walls."""
    return [f"{ARENA}/edge_{i}" for i in range(len(room.rings[ARENA]))]
