"""The physics of every effect of the library, and of the wheels' odometry; `foreign.py` holds what the library lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.hidden_effects.geometry import Room
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, SimulatedScan, at, laws
from benchmarks.hidden_effects.worlds.own.world import cast, centroid, disc_range, shift_edge


def _moved_wall(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Room:
    name, i = str(effect.place).split("/edge_")
    return scene.room.with_ring(name, shift_edge(scene.room.rings[name], int(i), p["d"]))


def _scaled(room: Room, s: float) -> Room:
    c = centroid(room)
    return room.changed(lambda _, ring: c + (1 + s) * (ring - c))


laws(
    "geometry",
    "room",
    map_scale=lambda scene, p, effect: _scaled(scene.room, p["s"]),
    moved_wall=_moved_wall,
    moved_obstacle=lambda scene, p, effect: scene.room.with_ring(
        effect.place, scene.room.rings[effect.place] + np.array([p["dx"], p["dy"]])
    ),
    missing_obstacle=lambda scene, p, effect: scene.room.with_ring(effect.place, None),
)
laws("geometry", "discs", unmapped_obstacle=lambda scene, p, effect: [*scene.discs, (p["x"], p["y"], p["r"])])
laws("geometry", "walkers", people=lambda scene, p, effect: scene.walkers + effect.extra["walkers"])
laws(
    "time",
    "times",
    latency=lambda scene, p, effect: scene.times - p["tau"],
    scan_skew=lambda scene, p, effect: (
        scene.times + p["T"] * np.arange(scene.robot.n_rays) / scene.robot.n_rays
    ),
)
laws("ray", "mount", mount_xy=lambda scene, p, effect: scene.mount + np.array([p["dx"], p["dy"], 0.0]))


def _dipped(bearings: Floats, p: Mapping[str, Any]) -> tuple[Any, Floats]:
    """Return the horizontal part of unit rays of a dipped plane, as complex numbers, and how far down they point."""
    towards = np.exp(1j * p["theta0"])
    ray = np.exp(1j * bearings) / towards
    return (ray.real * np.cos(p["beta"]) + 1j * ray.imag) * towards, ray.real * np.sin(p["beta"])


def _dip(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    """Look where rays of the dipped plane go as seen from above."""
    level, _ = _dipped(scene.stated, p)
    return np.asarray(scene.bearings + np.angle(level * np.exp(-1j * scene.stated)))


laws("ray", "bearings", mount_yaw=lambda scene, p, effect: scene.bearings + p["delta"], tilt=_dip)


def _glass(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    through = scene.on(effect) & (scene.incidence > p["alpha_ret"])
    behind = np.inf if p["depth"] is None else p["depth"]
    return np.where(through, scene.true + behind / np.cos(scene.incidence), scene.true)


laws("surface", "true", glass=_glass)


@at("surface", "mirror")
def _mirror(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> None:
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


def _tilt(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    level, down = _dipped(scene.stated, p)
    with np.errstate(divide="ignore"):
        floor = np.where(down > 1e-6, scene.robot.height / np.maximum(down, 1e-6), np.inf)
    return np.minimum(scene.ranges / np.abs(level), floor)


def _drift(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    t, whole = scene.clock - scene.stamps[0], scene.stamps[-1] - scene.stamps[0]
    share = 1 - np.exp(-t / p["tau"]) if "tau" in p else t / whole
    return np.asarray(scene.ranges + p["b1"] * share)


laws(
    "range",
    "ranges",
    tilt=_tilt,
    self_occlusion=lambda scene, p, effect: np.where(
        scene.in_sector(p), np.minimum(scene.ranges, p["r0"]), scene.ranges
    ),
    range_scale=lambda scene, p, effect: scene.ranges * (1 + p["s"]),
    range_bias=lambda scene, p, effect: scene.ranges + p["b"],
    sector_bias=lambda scene, p, effect: scene.ranges + np.where(scene.in_sector(p), p["b"], 0.0),
    range_drift=_drift,
)


def _black_surface(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    chance = np.minimum(1.0, np.cos(scene.incidence) * (p["r0"] / np.maximum(scene.true, 1e-6)) ** 2)
    return scene.lost(scene.on(effect) & (scene.rng(effect).random(len(chance)) > chance))


laws(
    "detection",
    "ranges",
    black_surface=_black_surface,
    incidence_dropout=lambda scene, p, effect: scene.lost(scene.incidence > p["alpha_max"]),
    max_range=lambda scene, p, effect: scene.lost(scene.true > p["R"]),
    min_range=lambda scene, p, effect: np.where(scene.true < p["r_min"], effect.extra["reads"], scene.ranges),
)
laws(
    "noise",
    "spread",
    range_noise=lambda scene, p, effect: np.sqrt(
        scene.spread**2 + (p["k"] * np.where(np.isfinite(scene.true), scene.true, 0.0)) ** 2
    ),
)


def _random_outliers(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    rng, n = scene.rng(effect), len(scene.measured)
    return np.where(rng.random(n) < p["p"], rng.uniform(0, scene.robot.range_max, n), scene.measured)


def _quantisation(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    with np.errstate(invalid="ignore"):
        return np.asarray(p["q"] * np.round(scene.measured / p["q"]))


laws("final", "measured", random_outliers=_random_outliers, quantisation=_quantisation)


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
