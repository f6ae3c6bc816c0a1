"""Effects that no library knows: the right answer to each is "something unknown, here"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    WALL_STAGE,
    HiddenEffect,
    SimulatedScan,
    stage,
)
from benchmarks.hidden_effects.world import ARENA, Floats, Walls

Draw = Callable[[np.random.Generator, Mapping[str, Any]], HiddenEffect]
DRAW: dict[str, Draw] = {}
POSE_EFFECTS: dict[str, Callable[[HiddenEffect, Floats, Floats, TrueDrive, Mapping[str, Any]], Floats]] = {}
FOREIGN_CHANNEL = {"odom_scale_jump": "odometry", "turn_deadband": "drive", "battery_sag": "drive"}


def _define(name: str, **limits: tuple[float, float]) -> None:
    """Say how the parameters of a placeless effect are drawn: uniform; b, s and k with a random sign."""

    def draw(rng: np.random.Generator, context: Mapping[str, Any]) -> HiddenEffect:
        values = {key: float(rng.uniform(*span)) for key, span in limits.items()}
        for key in ("b", "s", "k"):
            if key in values:
                values[key] *= float(rng.choice([-1, 1]))
        return HiddenEffect(name=name, parameters=values)

    DRAW[name] = draw


def _define_wall(name: str, **limits: tuple[float, float]) -> None:
    """The same for one that sits on a well seen outer wall."""

    def draw(rng: np.random.Generator, context: Mapping[str, Any]) -> HiddenEffect:
        wall = context["pick_wall"](rng)
        a, b = context["room"].edge(wall)
        values = {key: float(rng.uniform(*span)) for key, span in limits.items()}
        return HiddenEffect(name=name, parameters=values, place=wall, xy=tuple(map(float, (a + b) / 2)))

    DRAW[name] = draw


_define("range_quadratic", c=(0.004, 0.012))


@stage(RANGE_STAGE, "range_quadratic")
def _range_quadratic(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["c"] * scene.ranges**2


_define("bearing_cos2", b=(0.02, 0.05))


@stage(RANGE_STAGE, "bearing_cos2")
def _bearing_cos2(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["b"] * np.cos(2 * scene.stated)


_define("bias_jump", b=(0.02, 0.05), share=(0.3, 0.7))


@stage(RANGE_STAGE, "bias_jump")
def _bias_jump(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["b"] * (scene.clock > p["share"] * scene.stamps[-1])


_define("incidence_bias", k=(0.012, 0.03))


@stage(RANGE_STAGE, "incidence_bias")
def _incidence_bias(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["k"] * np.minimum(np.tan(scene.incidence) ** 2, 9.0)


_define("range_step", b=(0.025, 0.06), r1=(1.5, 2.8))


@stage(RANGE_STAGE, "range_step")
def _range_step(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.ranges = scene.ranges + p["b"] * (scene.ranges > p["r1"])


_define("range_cyclic", b=(0.02, 0.04), length=(0.5, 1.5))


@stage(RANGE_STAGE, "range_cyclic")
def _range_cyclic(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    finite = np.where(np.isfinite(scene.ranges), scene.ranges, 0.0)
    scene.ranges = scene.ranges + p["b"] * np.sin(2 * np.pi * finite / p["length"])


_define("bearing_scale", s=(0.012, 0.04))


@stage(RAY_STAGE, "bearing_scale")
def _bearing_scale(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    scene.bearings = scene.bearings * (1 + p["s"])


_define("pitch_acceleration", c=(0.12, 0.3))


@stage(RANGE_STAGE, "pitch_acceleration")
def _pitch_acceleration(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    gain = np.gradient(scene.driven.wheels[:, 0], scene.driven.stamps)
    pitch = -p["c"] * np.interp(scene.times.ravel(), scene.driven.stamps, gain)  # braking: nose down
    down = pitch * np.cos(scene.stated + scene.robot.mount[2])
    with np.errstate(divide="ignore"):
        floor = np.where(down > 1e-6, scene.robot.height / np.sin(np.maximum(down, 1e-6)), np.inf)
    scene.ranges = np.minimum(scene.ranges / np.cos(down), floor)


_define("crosstalk_rotating", turn=(0.7, 2.5), width=(0.06, 0.15), r0=(0.6, 1.5))


@stage(RANGE_STAGE, "crosstalk_rotating")
def _crosstalk_rotating(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    off = (scene.stated - p["turn"] * scene.clock + np.pi) % (2 * np.pi) - np.pi
    hit = (np.abs(off) < p["width"]) & (scene.rng(effect).random(len(off)) < 0.7)
    scene.ranges = np.where(hit, np.minimum(scene.ranges, p["r0"]), scene.ranges)


_define("sunlight", world=(-np.pi, np.pi), width=(0.25, 0.5))


@stage(DETECTION_STAGE, "sunlight")
def _sunlight(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    off = (scene.angles - p["world"] + np.pi) % (2 * np.pi) - np.pi
    lost = (np.abs(off) < p["width"]) & (scene.rng(effect).random(len(off)) < 0.75)
    scene.ranges = np.where(lost, np.inf, scene.ranges)


_define("dead_rays", count=(5, 10))


@stage(DETECTION_STAGE, "dead_rays")
def _dead_rays(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    dead = scene.rng(effect).choice(scene.robot.n_rays, size=round(p["count"]), replace=False)
    lost = np.isin(np.arange(len(scene.ranges)) % scene.robot.n_rays, dead)
    scene.ranges = np.where(lost, np.inf, scene.ranges)


_define("stuck_rays", count=(5, 10), hold=(4.0, 12.0))


@stage(FINAL_STAGE, "stuck_rays")
def _stuck_rays(scene: SimulatedScan, effect: HiddenEffect, z: Floats) -> Floats:
    n = scene.robot.n_rays
    stuck = scene.rng(effect).choice(n, size=round(float(effect.parameters["count"] or 0)), replace=False)
    grid = z.reshape(-1, n).copy()
    every = max(2, round(float(effect.parameters["hold"] or 0) * scene.robot.rate))
    held = (np.arange(len(grid)) // every) * every
    grid[:, stuck] = grid[held][:, stuck]
    return grid.ravel()


_define("stale_scans", share=(0.2, 0.4))


@stage(FINAL_STAGE, "stale_scans")
def _stale_scans(scene: SimulatedScan, effect: HiddenEffect, z: Floats) -> Floats:
    grid = z.reshape(-1, scene.robot.n_rays).copy()
    stale = scene.rng(effect).random(len(grid)) < float(effect.parameters["share"] or 0)
    for i in np.flatnonzero(stale):
        grid[i] = grid[max(i - 1, 0)]
    return grid.ravel()


_define("fog", p=(0.04, 0.10), depth=(0.5, 1.2))


@stage(FINAL_STAGE, "fog")
def _fog(scene: SimulatedScan, effect: HiddenEffect, z: Floats) -> Floats:
    rng = scene.rng(effect)
    back = rng.exponential(float(effect.parameters["depth"] or 1), len(z)) + 0.1
    hit = (rng.random(len(z)) < float(effect.parameters["p"] or 0)) & (back < z)
    return np.where(hit, back, z)


_define("burst_noise", factor=(3.0, 6.0), share=(0.25, 0.45), period=(6.0, 15.0))


@stage(NOISE_STAGE, "burst_noise")
def _burst_noise(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    loud = scene.clock % p["period"] < p["share"] * p["period"]
    scene.spread = scene.spread * np.where(loud, p["factor"], 1.0)


_define("multipath_corners", b=(0.08, 0.18), reach=(0.5, 0.8))


@stage(RANGE_STAGE, "multipath_corners")
def _multipath_corners(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    r = np.where(np.isfinite(scene.true), scene.true, 1e3)
    hit = scene.origins + r[:, None] * np.stack([np.cos(scene.angles), np.sin(scene.angles)], axis=1)
    near = np.full(len(r), np.inf)
    for corner in scene.room.rings[ARENA]:
        near = np.minimum(near, np.hypot(*(hit - corner).T))
    scene.ranges = scene.ranges + abs(p["b"]) * np.maximum(0.0, 1 - near / p["reach"])


def _bend(scene: SimulatedScan, wall: str, shape: Callable[[Floats, float], Floats]) -> None:
    """Replace a wall by a polyline that leaves it by shape(way along, length) [m]."""
    i = int(scene.walls.index(wall)[0])
    a, b = scene.walls.a[i], scene.walls.b[i]
    length = float(np.linalg.norm(b - a))
    along = np.linspace(0, length, 25)
    normal = np.array([(b - a)[1], -(b - a)[0]]) / length
    points = a + along[:, None] * (b - a) / length + shape(along, length)[:, None] * normal
    keep = np.arange(len(scene.walls.a)) != i
    scene.walls = Walls(
        a=np.concatenate([scene.walls.a[keep], points[:-1]]),
        b=np.concatenate([scene.walls.b[keep], points[1:]]),
        names=(*[n for n, k in zip(scene.walls.names, keep, strict=True) if k], *[wall] * (len(points) - 1)),
    )


_define_wall("bowed_wall", d=(0.05, 0.12))


@stage(WALL_STAGE, "bowed_wall")
def _bowed_wall(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    _bend(scene, str(effect.place), lambda s, length: 4 * p["d"] * s * (length - s) / length**2)


_define_wall("wavy_wall", d=(0.03, 0.06), length=(0.5, 1.2))


@stage(WALL_STAGE, "wavy_wall")
def _wavy_wall(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    _bend(scene, str(effect.place), lambda s, length: p["d"] * np.sin(2 * np.pi * s / p["length"]))


_define_wall("reflectivity_stripes", b=(0.025, 0.05), length=(0.3, 0.7))


@stage(RANGE_STAGE, "reflectivity_stripes")
def _reflectivity_stripes(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    sign = np.where((scene.along // p["length"]) % 2 == 0, 1.0, -1.0)
    scene.ranges = scene.ranges + np.where(scene.on(effect), p["b"] * sign, 0.0)


_define_wall("door_opens", share=(0.3, 0.6), middle=(0.35, 0.65), width=(0.8, 1.2), depth=(0.8, 2.0))


@stage(SURFACE_STAGE, "door_opens")
def _door_opens(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    a, b = scene.room.edge(str(effect.place))
    centre = p["middle"] * float(np.linalg.norm(b - a))
    gone = scene.on(effect) & (np.abs(scene.along - centre) < p["width"] / 2)
    gone &= scene.times.ravel() > p["share"] * scene.stamps[-1]
    scene.true = np.where(gone, scene.true + p["depth"] / np.cos(scene.incidence), scene.true)


def _draw_rotated(rng: np.random.Generator, context: Mapping[str, Any]) -> HiddenEffect:
    name = context["pick_obstacle"](rng)
    middle = context["room"].rings[name].mean(axis=0)
    turn = float(rng.choice([-1, 1]) * rng.uniform(0.15, 0.4))
    return HiddenEffect(
        name="rotated_obstacle", parameters={"turn": turn}, place=name, xy=tuple(map(float, middle))
    )


DRAW["rotated_obstacle"] = _draw_rotated


@stage(GEOMETRY_STAGE, "rotated_obstacle")
def _rotated_obstacle(scene: SimulatedScan, effect: HiddenEffect, p: Mapping[str, Any]) -> None:
    ring = scene.room.rings[str(effect.place)]
    c, s, middle = np.cos(p["turn"]), np.sin(p["turn"]), ring.mean(axis=0)
    scene.room = scene.room.with_ring(
        str(effect.place), middle + (ring - middle) @ np.array([[c, s], [-s, c]])
    )


_define("pose_clock_drift", tau=(0.15, 0.4))


def _pose_clock_drift(
    effect: HiddenEffect, stamps: Floats, poses: Floats, driven: TrueDrive, context: Mapping[str, Any]
) -> Floats:
    late = float(effect.parameters["tau"] or 0) * stamps / stamps[-1]
    return driven.at(stamps - late)


_define("camera_distortion", edge=(0.05, 0.10))


def _camera_distortion(
    effect: HiddenEffect, stamps: Floats, poses: Floats, driven: TrueDrive, context: Mapping[str, Any]
) -> Floats:
    room = context["room"]
    middle = room.centroid
    off = poses[:, :2] - middle
    reach = float(np.linalg.norm(room.rings[ARENA] - middle, axis=1).max()) * 0.7
    rho2 = (off**2).sum(axis=1, keepdims=True) / reach**2
    bent = poses.copy()
    bent[:, :2] += float(effect.parameters["edge"] or 0) * off / reach * rho2
    return bent


_define("pose_yaw_by_place", s=(0.02, 0.045))


def _pose_yaw_by_place(
    effect: HiddenEffect, stamps: Floats, poses: Floats, driven: TrueDrive, context: Mapping[str, Any]
) -> Floats:
    x0, y0 = context["room"].rings[ARENA].min(axis=0)
    bent = poses.copy()
    wave = np.sin(2 * np.pi * (poses[:, 0] - x0) / 2.6) * np.cos(2 * np.pi * (poses[:, 1] - y0) / 3.1)
    bent[:, 2] += float(effect.parameters["s"] or 0) * wave
    return bent


POSE_EFFECTS |= {
    "pose_clock_drift": _pose_clock_drift,
    "camera_distortion": _camera_distortion,
    "pose_yaw_by_place": _pose_yaw_by_place,
}


def _draw_odom_jump(rng: np.random.Generator, context: Mapping[str, Any]) -> HiddenEffect:
    s = float(rng.choice([-1, 1]) * rng.uniform(0.05, 0.1))
    return HiddenEffect(name="odom_scale_jump", parameters={"s": s}, extra={"t0": float(rng.uniform(25, 55))})


DRAW["odom_scale_jump"] = _draw_odom_jump
_define("turn_deadband", rate=(0.12, 0.25))
_define("battery_sag", gain=(0.75, 0.9), t0=(25.0, 55.0))

KINDS = {
    "dev": (
        "range_quadratic", "bias_jump", "range_step", "bearing_scale", "crosstalk_rotating", "dead_rays", "stale_scans",
        "fog", "bowed_wall", "door_opens", "pose_clock_drift", "camera_distortion", "turn_deadband", "rotated_obstacle",
    ),
    "report": (
        "bearing_cos2", "incidence_bias", "range_cyclic", "pitch_acceleration", "sunlight", "stuck_rays", "burst_noise",
        "multipath_corners", "wavy_wall", "reflectivity_stripes", "pose_yaw_by_place", "odom_scale_jump", "battery_sag",
    ),
}  # fmt: skip
"""Kinds for development and kinds for the report. Until November 2026 both had served the development of `sensorgraph
diagnose`; since then only the first may."""
