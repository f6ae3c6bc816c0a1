"""A rectangular room with one box, a robot that drives in it, and exact ranges without any ray caster."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from logs.run import RangeSensor
from planners.arena import Arena
from planners.maps import geojson
from planners.types import Floats
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.scene import Scene

LOWER, UPPER = np.array([0.0, 0.0]), np.array([6.0, 5.0])
BOX = ((4.0, 3.0), (4.6, 3.6))
SPAN = 12.0
STAMPS = np.linspace(0.0, SPAN, 41)
SENSOR = RangeSensor(
    bearings=np.linspace(-2.0, 2.0, 81),
    range_max=30.0,
    range_min=0.05,
    mount=np.array([0.1, 0.02, 0.01]),
    height=0.3,
)
TURN = replace(SENSOR, bearings=-np.pi + 2 * np.pi * np.arange(120) / 120)


def arena(box: tuple[tuple[float, float], tuple[float, float]] | None = BOX) -> Arena:
    """Make the room: walls room/edge_0 (y = 0), room/edge_1 (x = 6), ... and box/edge_0 ..."""
    features = [_feature("room", "arena", LOWER, UPPER)]
    if box is not None:
        features.append(_feature("box", "obstacle", *box))
    return geojson.loads(json.dumps({"type": "FeatureCollection", "features": features}))


def _feature(name: str, kind: str, lower: object, upper: object) -> dict[str, object]:
    (x0, y0), (x1, y1) = np.asarray(lower).tolist(), np.asarray(upper).tolist()
    ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
    return {
        "type": "Feature",
        "properties": {"name": name, "kind": kind},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def motion(t: Floats) -> Floats:
    """Drive loops in the lower left of the room; times before and after the run too."""
    t = np.asarray(t, dtype=np.float64)
    return np.stack([1.8 + 0.6 * np.sin(0.7 * t), 1.7 + 0.5 * np.cos(0.5 * t), 0.8 * t - 1.0], axis=-1)


def scene(sensor: RangeSensor = SENSOR, *, box: bool = False, seed: int | None = None) -> Scene:
    return Scene(
        arena=arena() if box else arena(None),
        sensor=sensor,
        stamps=STAMPS,
        motion=motion,
        span=SPAN,
        seed=seed,
    )


def lasers(
    times: Floats = STAMPS[:, None], shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[Floats, ...]:
    """Return x, y, phi of the laser at times (n_scans, 1 or n_rays), the mount shifted."""
    x, y, phi = np.moveaxis(motion(times), -1, 0)
    mx, my, yaw = SENSOR.mount + shift
    return x + np.cos(phi) * mx - np.sin(phi) * my, y + np.sin(phi) * mx + np.cos(phi) * my, phi + yaw


def to_walls(
    at: tuple[Floats, ...],
    bearings: Floats = SENSOR.bearings,
    lower: object = LOWER,
    upper: object = UPPER,
) -> tuple[Floats, Floats]:
    """Return range (n_scans, n_rays) to the wall of the rectangle, and the cosine of the incidence, from inside."""
    x, y, phi = at
    (x0, y0), (x1, y1) = np.asarray(lower).tolist(), np.asarray(upper).tolist()
    ux, uy = np.cos(phi + bearings), np.sin(phi + bearings)
    with np.errstate(divide="ignore"):
        to_x = np.abs(np.where(ux > 0, x1, x0) - x) / np.abs(ux)
        to_y = np.abs(np.where(uy > 0, y1, y0) - y) / np.abs(uy)
    return np.minimum(to_x, to_y), np.where(to_x < to_y, np.abs(ux), np.abs(uy))


def hit_at(
    at: tuple[Floats, ...], ranges: Floats, bearings: Floats = SENSOR.bearings
) -> tuple[Floats, Floats]:
    """Return where rays end."""
    x, y, phi = at
    return x + ranges * np.cos(phi + bearings), y + ranges * np.sin(phi + bearings)


NEUTRAL: dict[str, dict[str, float]] = {
    "sector_bias": {"theta1": -0.5, "theta2": 0.5},
    "glass": {"a": 1.0, "b": 4.0, "depth": 1.0},
    "mirror": {"a": 1.0, "b": 1.0},
    "black_surface": {"a": 1.0, "b": 4.0, "r0": 1e6},
    "max_range": {"R": np.inf},
    "unmapped_obstacle": {"x": 4.0, "y": 1.0},
    "self_occlusion": {"r0": np.inf, "theta1": -0.5, "theta2": 0.5},
    "speed_saturation": {"v_max": np.inf},
    "wheel_slip": {"x": 1.0, "y": 0.0, "r": 0.5},
}
"""Of parameters that have no single neutral value: values that together change nothing."""
STRONG: dict[str, dict[str, float]] = {
    "range_bias": {"b": 0.05},
    "range_scale": {"s": 0.02},
    "range_noise": {"k": 0.01},
    "sector_bias": {"theta1": -0.5, "theta2": 0.5, "b": 0.06},
    "mount_yaw": {"delta": 0.03},
    "mount_xy": {"dx": 0.03, "dy": -0.02},
    "latency": {"tau": 0.08},
    "scan_skew": {"T": 0.1},
    "mixed_pixels": {"gamma": 0.02},
    "glass": {"a": 1.0, "b": 4.0, "alpha_ret": 0.4, "depth": 1.5},
    "mirror": {"a": 1.0, "b": 4.0},
    "black_surface": {"a": 1.0, "b": 4.0, "r0": 1.2},
    "incidence_dropout": {"alpha_max": 0.9},
    "max_range": {"R": 3.0},
    "min_range": {"r_min": 1.5},
    "quantisation": {"q": 0.05},
    "unmapped_obstacle": {"x": 4.0, "y": 1.0, "r": 0.3},
    "moved_obstacle": {"dx": 0.1, "dy": -0.2},
    "missing_obstacle": {},
    "moved_wall": {"d": 0.1},
    "map_scale": {"s": 0.02, "dx": 0.01, "dy": -0.02},
    "people": {"p": 0.05},
    "range_drift": {"b1": 0.1, "tau": 0.0},
    "sonar_cone": {"gamma": 0.2, "alpha_max": 0.6},
    "self_occlusion": {"r0": 0.3, "theta1": -0.2, "theta2": 0.1},
    "tilt": {"beta": 0.1, "theta0": 0.3},
    "random_outliers": {"p": 0.1},
}
PLACES = {"wall": "room/edge_1", "obstacle": "box"}


def placed(a: Amendment) -> Amendment:
    """Put an amendment on a wall or an obstacle of the room, where it needs one."""
    return a.at(PLACES[a.effect.place]) if a.effect.place in PLACES else a


def neutral(name: str) -> Amendment:
    """Return an effect whose numbers change nothing."""
    effect = EFFECTS[name]
    known = {p.name: p.neutral for p in effect.parameters if p.neutral is not None}
    return placed(effect(**{**known, **NEUTRAL.get(name, {})}))


def strong(name: str) -> Amendment:
    """Return an effect of the scan channel that anybody would notice."""
    return placed(EFFECTS[name](**STRONG[name]))
