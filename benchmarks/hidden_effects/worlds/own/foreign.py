"""Effects that no library knows: the right answer to each is "something unknown, here"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from benchmarks.hidden_effects.geometry import Room, turned, wrapped
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, SimulatedScan, at, laws
from benchmarks.hidden_effects.worlds.own.strengths import Context
from benchmarks.hidden_effects.worlds.own.world import ARENA, Walls, centroid

FOREIGN_CHANNEL = {"odom_scale_jump": "odometry", "turn_deadband": "drive", "battery_sag": "drive"}
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
SPANS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "range_quadratic": {"c": (0.004, 0.012)},
    "bearing_cos2": {"b": (0.02, 0.05)},
    "bias_jump": {"b": (0.02, 0.05), "share": (0.3, 0.7)},
    "incidence_bias": {"k": (0.012, 0.03)},
    "range_step": {"b": (0.025, 0.06), "r1": (1.5, 2.8)},
    "range_cyclic": {"b": (0.02, 0.04), "length": (0.5, 1.5)},
    "bearing_scale": {"s": (0.012, 0.04)},
    "pitch_acceleration": {"c": (0.12, 0.3)},
    "crosstalk_rotating": {"turn": (0.7, 2.5), "width": (0.06, 0.15), "r0": (0.6, 1.5)},
    "sunlight": {"world": (-np.pi, np.pi), "width": (0.25, 0.5)},
    "dead_rays": {"count": (5, 10)},
    "stuck_rays": {"count": (5, 10), "hold": (4.0, 12.0)},
    "stale_scans": {"share": (0.2, 0.4)},
    "fog": {"p": (0.04, 0.10), "depth": (0.5, 1.2)},
    "burst_noise": {"factor": (3.0, 6.0), "share": (0.25, 0.45), "period": (6.0, 15.0)},
    "multipath_corners": {"b": (0.08, 0.18), "reach": (0.5, 0.8)},
    "bowed_wall": {"d": (0.05, 0.12)},
    "wavy_wall": {"d": (0.03, 0.06), "length": (0.5, 1.2)},
    "reflectivity_stripes": {"b": (0.025, 0.05), "length": (0.3, 0.7)},
    "door_opens": {"share": (0.3, 0.6), "middle": (0.35, 0.65), "width": (0.8, 1.2), "depth": (0.8, 2.0)},
    "pose_clock_drift": {"tau": (0.15, 0.4)},
    "camera_distortion": {"edge": (0.05, 0.10)},
    "pose_yaw_by_place": {"s": (0.02, 0.045)},
    "turn_deadband": {"rate": (0.12, 0.25)},
    "battery_sag": {"gain": (0.75, 0.9), "t0": (25.0, 55.0)},
}
"""Between which sizes the parameters are drawn."""
LEAST_SEEN = 0.08
"""Share of the rays that end on such a wall."""
ON_WALLS = {"bowed_wall", "wavy_wall", "reflectivity_stripes", "door_opens"}
"""They sit on a well seen outer wall; b, s and k of the others have a random sign."""


def draw(name: str, rng: np.random.Generator, context: Context) -> HiddenEffect:
    """Draw size and place of an effect."""
    if name == "rotated_obstacle":
        place = context.pick_obstacle(rng)
        middle = context.room.rings[place].mean(axis=0)
        turn = float(rng.choice([-1, 1]) * rng.uniform(0.15, 0.4))
        return HiddenEffect(name=name, parameters={"turn": turn}, place=place, xy=tuple(map(float, middle)))
    if name == "odom_scale_jump":
        s = float(rng.choice([-1, 1]) * rng.uniform(0.05, 0.1))
        return HiddenEffect(name=name, parameters={"s": s}, extra={"t0": float(rng.uniform(25, 55))})
    wall = context.pick_wall(rng, least=LEAST_SEEN) if name in ON_WALLS else None
    values = {key: float(rng.uniform(*span)) for key, span in SPANS[name].items()}
    if wall is not None:
        a, b = context.room.edge(wall)
        return HiddenEffect(name=name, parameters=values, place=wall, xy=tuple(map(float, (a + b) / 2)))
    for key in ("b", "s", "k"):
        if key in values:
            values[key] *= float(rng.choice([-1, 1]))
    return HiddenEffect(name=name, parameters=values)


def _pitch(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    gain = np.gradient(scene.driven.wheels[:, 0], scene.driven.stamps)
    pitch = -p["c"] * np.interp(scene.times.ravel(), scene.driven.stamps, gain)  # braking: nose down
    down = pitch * np.cos(scene.stated + scene.robot.mount[2])
    with np.errstate(divide="ignore"):
        floor = np.where(down > 1e-6, scene.robot.height / np.sin(np.maximum(down, 1e-6)), np.inf)
    return np.minimum(scene.ranges / np.cos(down), floor)


def _crosstalk(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    off = wrapped(scene.stated - p["turn"] * scene.clock)
    hit = (np.abs(off) < p["width"]) & (scene.rng(effect).random(len(off)) < 0.7)
    return np.where(hit, np.minimum(scene.ranges, p["r0"]), scene.ranges)


def _multipath(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    r = np.where(np.isfinite(scene.true), scene.true, 1e3)
    hit = scene.origins + r[:, None] * np.stack([np.cos(scene.angles), np.sin(scene.angles)], axis=1)
    near = np.full(len(r), np.inf)
    for corner in scene.room.rings[ARENA]:
        near = np.minimum(near, np.hypot(*(hit - corner).T))
    return np.asarray(scene.ranges + abs(p["b"]) * np.maximum(0.0, 1 - near / p["reach"]))


def _stripes(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    sign = np.where((scene.along // p["length"]) % 2 == 0, 1.0, -1.0)
    return np.asarray(scene.ranges + np.where(scene.on(effect), p["b"] * sign, 0.0))


def _cyclic(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    finite = np.where(np.isfinite(scene.ranges), scene.ranges, 0.0)
    return np.asarray(scene.ranges + p["b"] * np.sin(2 * np.pi * finite / p["length"]))


laws(
    "range",
    "ranges",
    range_quadratic=lambda scene, p, effect: scene.ranges + p["c"] * scene.ranges**2,
    bearing_cos2=lambda scene, p, effect: scene.ranges + p["b"] * np.cos(2 * scene.stated),
    bias_jump=lambda scene, p, effect: scene.ranges + p["b"] * (scene.clock > p["share"] * scene.stamps[-1]),
    incidence_bias=lambda scene, p, effect: (
        scene.ranges + p["k"] * np.minimum(np.tan(scene.incidence) ** 2, 9.0)
    ),
    range_step=lambda scene, p, effect: scene.ranges + p["b"] * (scene.ranges > p["r1"]),
    range_cyclic=_cyclic,
    pitch_acceleration=_pitch,
    crosstalk_rotating=_crosstalk,
    multipath_corners=_multipath,
    reflectivity_stripes=_stripes,
)
laws("ray", "bearings", bearing_scale=lambda scene, p, effect: scene.bearings * (1 + p["s"]))


def _sunlight(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    off = wrapped(scene.angles - p["world"])
    return scene.lost((np.abs(off) < p["width"]) & (scene.rng(effect).random(len(off)) < 0.75))


def _dead_rays(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    dead = scene.rng(effect).choice(scene.robot.n_rays, size=round(p["count"]), replace=False)
    return scene.lost(np.isin(np.arange(len(scene.ranges)) % scene.robot.n_rays, dead))


laws("detection", "ranges", sunlight=_sunlight, dead_rays=_dead_rays)


def _burst_noise(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    loud = scene.clock % p["period"] < p["share"] * p["period"]
    return np.asarray(scene.spread * np.where(loud, p["factor"], 1.0))


laws("noise", "spread", burst_noise=_burst_noise)


def _stuck_rays(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    n = scene.robot.n_rays
    stuck = scene.rng(effect).choice(n, size=round(p["count"]), replace=False)
    grid = scene.measured.reshape(-1, n).copy()
    every = max(2, round(p["hold"] * scene.robot.scan_rate))
    held = (np.arange(len(grid)) // every) * every
    grid[:, stuck] = grid[held][:, stuck]
    return grid.ravel()


def _stale_scans(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    grid = scene.measured.reshape(-1, scene.robot.n_rays).copy()
    for i in np.flatnonzero(scene.rng(effect).random(len(grid)) < p["share"]):
        grid[i] = grid[max(i - 1, 0)]
    return grid.ravel()


def _fog(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> Floats:
    rng, z = scene.rng(effect), scene.measured
    back = rng.exponential(p["depth"], len(z)) + 0.1
    return np.where((rng.random(len(z)) < p["p"]) & (back < z), back, z)


laws("final", "measured", stuck_rays=_stuck_rays, stale_scans=_stale_scans, fog=_fog)


def _bent(scene: SimulatedScan, wall: str, shape: Callable[[Floats, float], Floats]) -> Walls:
    """Return the walls with one replaced by a polyline that leaves it by shape(way along, length) [m]."""
    i = int(scene.walls.index(wall)[0])
    a, b = scene.walls.a[i], scene.walls.b[i]
    length = float(np.linalg.norm(b - a))
    along = np.linspace(0, length, 25)
    normal = np.array([(b - a)[1], -(b - a)[0]]) / length
    points = a + along[:, None] * (b - a) / length + shape(along, length)[:, None] * normal
    keep = np.arange(len(scene.walls.a)) != i
    return Walls(
        a=np.concatenate([scene.walls.a[keep], points[:-1]]),
        b=np.concatenate([scene.walls.b[keep], points[1:]]),
        names=(*[n for n, k in zip(scene.walls.names, keep, strict=True) if k], *[wall] * (len(points) - 1)),
    )


laws(
    "wall",
    "walls",
    bowed_wall=lambda scene, p, effect: _bent(
        scene, effect.place, lambda s, length: 4 * p["d"] * s * (length - s) / length**2
    ),
    wavy_wall=lambda scene, p, effect: _bent(
        scene, effect.place, lambda s, length: p["d"] * np.sin(2 * np.pi * s / p["length"])
    ),
)


@at("surface", "door_opens")
def _door_opens(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> None:
    a, b = scene.room.edge(str(effect.place))
    centre = p["middle"] * float(np.linalg.norm(b - a))
    gone = scene.on(effect) & (np.abs(scene.along - centre) < p["width"] / 2)
    gone &= scene.times.ravel() > p["share"] * scene.stamps[-1]
    scene.true = np.where(gone, scene.true + p["depth"] / np.cos(scene.incidence), scene.true)


@at("geometry", "rotated_obstacle")
def _rotated_obstacle(scene: SimulatedScan, p: Mapping[str, Any], effect: HiddenEffect) -> None:
    ring = scene.room.rings[str(effect.place)]
    middle = ring.mean(axis=0)
    scene.room = scene.room.with_ring(str(effect.place), middle + turned(ring - middle, p["turn"]))


PoseLaw = Callable[[Mapping[str, Any], Floats, Floats, TrueDrive, Room], Floats]
"""(parameters, stamps, poses, drive, room) -> poses as the reference tells them."""


def _camera_distortion(
    p: Mapping[str, Any], stamps: Floats, poses: Floats, driven: TrueDrive, room: Room
) -> Floats:
    middle = centroid(room)
    off = poses[:, :2] - middle
    reach = float(np.linalg.norm(room.outer - middle, axis=1).max()) * 0.7
    rho2 = (off**2).sum(axis=1, keepdims=True) / reach**2
    bent = poses.copy()
    bent[:, :2] += p["edge"] * off / reach * rho2
    return bent


def _pose_yaw_by_place(
    p: Mapping[str, Any], stamps: Floats, poses: Floats, driven: TrueDrive, room: Room
) -> Floats:
    x0, y0 = room.rings[ARENA].min(axis=0)
    bent = poses.copy()
    wave = np.sin(2 * np.pi * (poses[:, 0] - x0) / 2.6) * np.cos(2 * np.pi * (poses[:, 1] - y0) / 3.1)
    bent[:, 2] += p["s"] * wave
    return bent


POSE_EFFECTS: Mapping[str, PoseLaw] = {
    "pose_clock_drift": lambda p, stamps, poses, driven, room: driven.at(
        stamps - p["tau"] * stamps / stamps[-1]
    ),
    "camera_distortion": _camera_distortion,
    "pose_yaw_by_place": _pose_yaw_by_place,
}
