"""How big a hidden effect is and where it sits, at a strength from 0 (below materiality) to 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely

from benchmarks.hidden_effects import library
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive, largest_part
from benchmarks.hidden_effects.worlds.own.people import walkers
from benchmarks.hidden_effects.worlds.own.robot import RobotSpec
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect
from benchmarks.hidden_effects.worlds.own.world import ARENA, Room, TrueHits

DEG = math.pi / 180
MATERIALITY = {name: bound for name, (bound, _) in library.MATERIALITY.items() if name != "pose_clock_offset"}
MATERIALITY |= {"mount_yaw": 0.1 * DEG, "mixed_pixels": 0.12 * DEG, "speed_saturation": 0.02}
"""In the unit of the parameter. The other effects have no size, only a mark."""
LARGEST_RATIO = {
    "unmapped_obstacle": 12.0,
    "moved_obstacle": 15.0,
    "random_outliers": 20.0,
    "sector_bias": 8.0,
    "wheel_slip": 9.0,
    "mixed_pixels": 10.0,
}
"""Largest size over materiality where it is not 10."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Context:
    """What there is to hide an effect in."""

    room: Room
    robot: RobotSpec
    driven: TrueDrive
    """The trip without any effect."""
    hits: TrueHits
    """What the laser would see on it (some of the scans)."""
    wall_names: tuple[str, ...]

    def share(self, name: str) -> float:
        """Return the share of rays that end on a wall or on any wall of an obstacle."""
        on = [i for i, wall in enumerate(self.wall_names) if wall == name or wall.startswith(name + "/")]
        return float(np.isin(self.hits.wall, on).mean())

    def pick_wall(self, rng: np.random.Generator, *, least: float = 0.04) -> str:
        """Draw a well seen outer wall."""
        walls = [wall for wall in self.wall_names if wall.startswith(ARENA + "/")]
        shares = np.array([self.share(wall) for wall in walls])
        good = shares >= min(least, shares.max())
        return str(rng.choice(np.array(walls)[good]))

    def pick_obstacle(self, rng: np.random.Generator) -> str:
        """Draw a well seen obstacle."""
        names = [name for name in self.room.rings if name != ARENA]
        shares = np.array([self.share(name) for name in names])
        good = shares >= min(0.015, shares.max())
        return str(rng.choice(np.array(names)[good]))

    def quantile(self, what: Floats, q: float) -> float:
        """Return a quantile over the rays that hit."""
        return float(np.quantile(what[np.isfinite(self.hits.ranges)], q))


def size_of(name: str, strength: float) -> float:
    """Return the size in the parameter's unit: from half the materiality, geometrically, to ten times it."""
    return MATERIALITY[name] * 0.5 * (LARGEST_RATIO.get(name, 10.0) / 0.5) ** strength


def ratio_of(effect: HiddenEffect, context: Context) -> float | None:
    """Return true size over materiality, None for effects without a size (people: known from the mark)."""
    if effect.name not in MATERIALITY or effect.name == "people":
        return None
    if effect.name == "speed_saturation":
        size = float(np.abs(context.driven.commands[:, 0]).max()) - float(effect.parameters["v_max"] or 0)
    else:
        size = math.hypot(*(effect.parameters[key] or 0 for key in library.MATERIALITY[effect.name][1]))
    return size / MATERIALITY[effect.name]


Draw = Callable[[Context, float, np.random.Generator], HiddenEffect]


def draw(name: str, strength: float, context: Context, rng: np.random.Generator) -> HiddenEffect:
    """Draw one library effect at a strength in 0...1."""
    return DRAWS[name](context, strength, rng)


def _signed(name: str, key: str, *, negative: float = 0.5) -> Draw:
    def one(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
        sign = -1.0 if rng.random() < negative else 1.0
        return HiddenEffect(name=name, parameters={key: sign * size_of(name, u)})

    return one


def _direction(name: str, context: Context, u: float, rng: np.random.Generator) -> dict[str, float | None]:
    size, angle = size_of(name, u), rng.uniform(-np.pi, np.pi)
    return {"dx": size * math.cos(angle), "dy": size * math.sin(angle)}


def _sector(context: Context, width: float, rng: np.random.Generator) -> tuple[float, float]:
    lowest, highest = context.robot.bearings[0], context.robot.bearings[-1]
    first = rng.uniform(lowest, max(lowest + 1e-6, highest - width))
    return float(first), float(first + width)


def _sector_bias(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    theta1, theta2 = _sector(context, rng.uniform(15, 50) * DEG, rng)
    b = float(rng.choice([-1, 1])) * size_of("sector_bias", u)
    return HiddenEffect(name="sector_bias", parameters={"theta1": theta1, "theta2": theta2, "b": b})


def _self_occlusion(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    step = float(np.diff(context.robot.bearings[:2])[0])
    theta1, theta2 = _sector(context, max(1.2 * step, (1 + 14 * u) * DEG), rng)
    r0 = float(rng.uniform(context.robot.range_min + 0.03, 0.35))
    return HiddenEffect(name="self_occlusion", parameters={"r0": r0, "theta1": theta1, "theta2": theta2})


def _wall_part(
    context: Context, u: float, rng: np.random.Generator
) -> tuple[str, float, float, tuple[float, float]]:
    """Draw a part of a well seen wall: its name, both ends [m] from the first vertex, its middle."""
    wall = context.pick_wall(rng)
    p, q = context.room.edge(wall)
    length = float(np.linalg.norm(q - p))
    seen = context.hits.along[
        np.isin(context.hits.wall, [i for i, w in enumerate(context.wall_names) if w == wall])
    ]
    half = min(length / 2, 0.5 * rng.uniform(0.4 + 0.4 * u, 0.8 + 1.4 * u))
    middle = float(np.clip(rng.choice(seen) if len(seen) else length / 2, half, length - half))
    at = p + middle * (q - p) / length
    return wall, middle - half, middle + half, (float(at[0]), float(at[1]))


def _glass(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    wall, a, b, xy = _wall_part(context, u, rng)
    depth = None if rng.random() < 0.3 else float(rng.uniform(0.3, 3.0))
    alpha = float(rng.uniform(4, 30 - 15 * u)) * DEG
    return HiddenEffect(
        name="glass", parameters={"a": a, "b": b, "alpha_ret": alpha, "depth": depth}, place=wall, xy=xy
    )


def _mirror(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    wall, a, b, xy = _wall_part(context, u, rng)
    return HiddenEffect(name="mirror", parameters={"a": a, "b": b}, place=wall, xy=xy)


def _black(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    wall, a, b, xy = _wall_part(context, u, rng)
    r0 = float(rng.uniform(0.5, 1.0 + 2.0 * (1 - u)))
    return HiddenEffect(name="black_surface", parameters={"a": a, "b": b, "r0": r0}, place=wall, xy=xy)


def _incidence(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    loss = 0.008 * 30**u * rng.uniform(0.8, 1.25)
    return HiddenEffect(
        name="incidence_dropout", parameters={"alpha_max": context.quantile(context.hits.incidence, 1 - loss)}
    )


def _max_range(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    loss = 0.008 * 50**u * rng.uniform(0.8, 1.2)
    inside = min(context.quantile(context.hits.ranges, 1 - loss), 0.98 * context.robot.range_max)
    return HiddenEffect(name="max_range", parameters={"R": inside})


def _min_range(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    loss = 0.008 * 20**u * rng.uniform(0.8, 1.2)
    r_min = max(context.quantile(context.hits.ranges, loss), context.robot.range_min + 0.05)
    return HiddenEffect(
        name="min_range", parameters={"r_min": r_min}, extra={"reads": float(rng.choice([-np.inf, np.inf]))}
    )


def _quantisation(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    return HiddenEffect(name="quantisation", parameters={"q": round(0.004 * 25**u, 3)})


def _unmapped(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    r = size_of("unmapped_obstacle", u)
    way = shapely.LineString(context.driven.poses[::20, :2])
    free = context.room.free.buffer(-r - 0.05)
    x0, y0, x1, y1 = free.bounds
    best, far = np.zeros(2), -1.0
    for point in rng.uniform((x0, y0), (x1, y1), size=(300, 2)):
        spot = shapely.Point(point)
        if not free.contains(spot):
            continue
        away = spot.distance(way)
        if away > r + 0.22:
            best = point
            break
        if away > far:
            best, far = point, away
    x, y = float(best[0]), float(best[1])
    return HiddenEffect(name="unmapped_obstacle", parameters={"x": x, "y": y, "r": r}, xy=(x, y))


def _moved_obstacle(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    name = context.pick_obstacle(rng)
    xy = tuple(map(float, shapely.Polygon(context.room.rings[name]).centroid.coords[0]))
    shift = _direction("moved_obstacle", context, u, rng)
    return HiddenEffect(name="moved_obstacle", parameters=shift, place=name, xy=(xy[0], xy[1]))


def _missing_obstacle(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    name = context.pick_obstacle(rng)
    xy = tuple(map(float, shapely.Polygon(context.room.rings[name]).centroid.coords[0]))
    return HiddenEffect(name="missing_obstacle", parameters={}, place=name, xy=(xy[0], xy[1]))


def _moved_wall(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    wall = context.pick_wall(rng)
    a, b = context.room.edge(wall)
    d = float(rng.choice([-1, 1])) * size_of("moved_wall", u)
    return HiddenEffect(name="moved_wall", parameters={"d": d}, place=wall, xy=tuple(map(float, (a + b) / 2)))


def _people(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    """Persons as bodies or pairs of legs that walk between random places for part of the run."""
    free = largest_part(context.room.free.buffer(-0.3))
    found = walkers(free, float(context.driven.stamps[-1]), u, rng)
    return HiddenEffect(name="people", parameters={"p": None}, extra={"walkers": found})


def _range_drift(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    b1 = float(rng.choice([-1, 1])) * size_of("range_drift", u)
    values: dict[str, float | None] = {"b1": b1}
    if rng.random() < 0.4:
        values["tau"] = float(rng.uniform(8, 30))
    return HiddenEffect(name="range_drift", parameters=values)


def _sonar(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    gamma = (7 + 12 * u) * DEG * rng.uniform(0.9, 1.1)
    return HiddenEffect(
        name="sonar_cone", parameters={"gamma": float(gamma), "alpha_max": float(rng.uniform(15, 45)) * DEG}
    )


def _tilt(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    far = context.quantile(context.hits.ranges, 0.97 - 0.35 * u)
    beta = math.atan(context.robot.height / far) * rng.uniform(1.0, 1.15)
    inside = context.robot.bearings
    theta0 = float(rng.uniform(0.6 * inside[0], 0.6 * inside[-1]))
    return HiddenEffect(name="tilt", parameters={"beta": float(beta), "theta0": theta0})


def _slip(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    r = float(rng.uniform(0.45, 0.9))
    spots = context.driven.poses[:: max(1, len(context.driven.poses) // 200), :2]
    moving = np.abs(context.driven.wheels[:, 0]) > 0.08
    track = context.driven.poses[moving, :2][::10]
    visits = np.array([(np.hypot(*(track - spot).T) < r).sum() for spot in spots])
    spot = rng.choice(spots[visits >= np.quantile(visits, 0.6)])
    x, y = float(spot[0]), float(spot[1])
    s = size_of("wheel_slip", u)
    return HiddenEffect(name="wheel_slip", parameters={"s": s, "x": x, "y": y, "r": r}, xy=(x, y))


def _saturation(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    fastest = float(np.abs(context.driven.commands[:, 0]).max())
    return HiddenEffect(
        name="speed_saturation", parameters={"v_max": fastest - size_of("speed_saturation", u)}
    )


def _clock_offset(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    sign = -1.0 if rng.random() < 0.2 else 1.0
    return HiddenEffect(name="pose_clock_offset", parameters={"tau": sign * 0.015 * 20**u})


def _mount_xy(context: Context, u: float, rng: np.random.Generator) -> HiddenEffect:
    return HiddenEffect(name="mount_xy", parameters=_direction("mount_xy", context, u, rng))


DRAWS: dict[str, Draw] = {
    "range_bias": _signed("range_bias", "b"),
    "range_scale": _signed("range_scale", "s"),
    "range_noise": _signed("range_noise", "k", negative=0),
    "sector_bias": _sector_bias,
    "mount_yaw": _signed("mount_yaw", "delta"),
    "mount_xy": _mount_xy,
    "latency": _signed("latency", "tau", negative=0),
    "scan_skew": _signed("scan_skew", "T", negative=0),
    "mixed_pixels": _signed("mixed_pixels", "gamma", negative=0),
    "glass": _glass,
    "mirror": _mirror,
    "black_surface": _black,
    "incidence_dropout": _incidence,
    "max_range": _max_range,
    "min_range": _min_range,
    "quantisation": _quantisation,
    "unmapped_obstacle": _unmapped,
    "moved_obstacle": _moved_obstacle,
    "missing_obstacle": _missing_obstacle,
    "moved_wall": _moved_wall,
    "map_scale": _signed("map_scale", "s"),
    "people": _people,
    "range_drift": _range_drift,
    "sonar_cone": _sonar,
    "self_occlusion": _self_occlusion,
    "tilt": _tilt,
    "random_outliers": _signed("random_outliers", "p", negative=0),
    "wheel_radius": _signed("wheel_radius", "s"),
    "wheel_radius_diff": _signed("wheel_radius_diff", "s"),
    "wheel_base": _signed("wheel_base", "s"),
    "wheel_slip": _slip,
    "pose_clock_offset": _clock_offset,
    "actuator_lag": _signed("actuator_lag", "tau", negative=0),
    "dead_time": _signed("dead_time", "L", negative=0),
    "speed_saturation": _saturation,
}
