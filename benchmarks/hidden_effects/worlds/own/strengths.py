"""How large a hidden effect is and where it is, at a strength from 0 (below materiality) to 1; and people."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from benchmarks.hidden_effects import library
from benchmarks.hidden_effects.geometry import Room, interpolated, largest_part
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive
from benchmarks.hidden_effects.worlds.own.robot import RobotSpec
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect
from benchmarks.hidden_effects.worlds.own.world import ARENA, TrueHits

Walker = tuple[Floats, Floats, float]
"""Times (k,) [s], centres (k, 2) [m] and radius [m] of a disc that moves."""


def walkers(
    free: shapely.Geometry, duration: float, strength: float, rng: np.random.Generator
) -> list[Walker]:
    """Let persons walk between random places in the free space for part of the run.

    Parameters
    ----------
    duration : [s] of the run
    strength : 0...1, how many they are and how long they stay
    """
    found: list[Walker] = []
    for _ in range(1 + int(2.99 * strength * rng.random())):
        stay = duration * min(1.0, 0.04 * 20**strength * rng.uniform(0.7, 1.4))
        enter = rng.uniform(0, max(duration - stay, 1e-3))
        stamps, centres = _walk(free, enter, enter + stay, rng)
        gone = np.array([[1e4, 1e4]])
        fine = np.arange(enter, enter + stay, 0.05)
        at = interpolated(fine, stamps, centres)
        ends = np.array([enter - 1e-3]), np.array([fine[-1] + 1e-3])
        times = np.concatenate([ends[0], fine, ends[1]])
        if rng.random() < 0.5:
            found.append((times, np.concatenate([gone, at, gone]), float(rng.uniform(0.15, 0.25))))
            continue
        along = np.gradient(at, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
        aside = np.stack([-along[:, 1], along[:, 0]], axis=1)
        swing = 0.18 * np.sin(2 * np.pi * 0.9 * fine)[:, None]
        radius = float(rng.uniform(0.05, 0.08))
        for side in (-1, 1):
            leg = at + side * (0.11 * aside + swing * along)
            found.append((times, np.concatenate([gone, leg, gone]), radius))
    return found


def _walk(
    free: shapely.Geometry, start: float, stop: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    x0, y0, x1, y1 = free.bounds
    shapely.prepare(free)

    def spot() -> Floats:
        while True:
            points = rng.uniform((x0, y0), (x1, y1), size=(8, 2))
            inside = points[shapely.contains_xy(free, points[:, 0], points[:, 1])]
            if len(inside):
                return np.asarray(inside[0])

    t, here = start, spot()
    stamps, centres = [t], [here]
    while t < stop:
        there = spot()
        for _ in range(20):
            if free.contains(shapely.LineString([here, there])):
                break
            there = spot()
        t += max(0.3, float(np.linalg.norm(there - here))) / rng.uniform(0.3, 1.2)
        stamps.append(t)
        centres.append(there)
        here = there
    return np.array(stamps), np.array(centres)


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
        names = self.room.obstacles
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


Found = dict[str, Any]
"""Fields of a `HiddenEffect` but its name."""
Draw = Callable[[Context, float, np.random.Generator], Found]


def draw(name: str, strength: float, context: Context, rng: np.random.Generator) -> HiddenEffect:
    """Draw one library effect at a strength in 0...1."""
    if name in SIZED:
        key, negative = SIZED[name]
        sign = -1.0 if rng.random() < negative else 1.0
        return HiddenEffect(name=name, parameters={key: sign * size_of(name, strength)})
    return HiddenEffect(name=name, **DRAWS[name](context, strength, rng))


SIZED = {
    "range_bias": ("b", 0.5), "range_scale": ("s", 0.5), "range_noise": ("k", 0.0), "mount_yaw": ("delta", 0.5),
    "latency": ("tau", 0.0), "scan_skew": ("T", 0.0), "mixed_pixels": ("gamma", 0.0), "map_scale": ("s", 0.5),
    "random_outliers": ("p", 0.0), "wheel_radius": ("s", 0.5), "wheel_radius_diff": ("s", 0.5), "wheel_base": ("s", 0.5),
    "actuator_lag": ("tau", 0.0), "dead_time": ("L", 0.0),
}  # fmt: skip
"""Effects of one parameter, and how often it is negative."""


def _shift(name: str, u: float, rng: np.random.Generator) -> dict[str, float]:
    size, angle = size_of(name, u), rng.uniform(-np.pi, np.pi)
    return {"dx": size * math.cos(angle), "dy": size * math.sin(angle)}


def _sector(context: Context, width: float, rng: np.random.Generator) -> dict[str, float]:
    lowest, highest = context.robot.bearings[0], context.robot.bearings[-1]
    first = float(rng.uniform(lowest, max(lowest + 1e-6, highest - width)))
    return {"theta1": first, "theta2": first + width}


def _sector_bias(context: Context, u: float, rng: np.random.Generator) -> Found:
    sector = _sector(context, rng.uniform(15, 50) * DEG, rng)
    return {"parameters": sector | {"b": float(rng.choice([-1, 1])) * size_of("sector_bias", u)}}


def _self_occlusion(context: Context, u: float, rng: np.random.Generator) -> Found:
    step = float(np.diff(context.robot.bearings[:2])[0])
    sector = _sector(context, max(1.2 * step, (1 + 14 * u) * DEG), rng)
    return {"parameters": {"r0": float(rng.uniform(context.robot.range_min + 0.03, 0.35)), **sector}}


def _wall_part(context: Context, u: float, rng: np.random.Generator) -> Found:
    """Draw a part of a well seen wall, from a to b [m] of its first vertex."""
    wall = context.pick_wall(rng)
    p, q = context.room.edge(wall)
    length = float(np.linalg.norm(q - p))
    named = [i for i, name in enumerate(context.wall_names) if name == wall]
    seen = context.hits.along[np.isin(context.hits.wall, named)]
    half = min(length / 2, 0.5 * rng.uniform(0.4 + 0.4 * u, 0.8 + 1.4 * u))
    middle = float(np.clip(rng.choice(seen) if len(seen) else length / 2, half, length - half))
    at = p + middle * (q - p) / length
    xy = (float(at[0]), float(at[1]))
    return {"parameters": {"a": middle - half, "b": middle + half}, "place": wall, "xy": xy}


def _glass(context: Context, u: float, rng: np.random.Generator) -> Found:
    part = _wall_part(context, u, rng)
    depth = None if rng.random() < 0.3 else float(rng.uniform(0.3, 3.0))
    part["parameters"] |= {"alpha_ret": float(rng.uniform(4, 30 - 15 * u)) * DEG, "depth": depth}
    return part


def _black(context: Context, u: float, rng: np.random.Generator) -> Found:
    part = _wall_part(context, u, rng)
    part["parameters"]["r0"] = float(rng.uniform(0.5, 1.0 + 2.0 * (1 - u)))
    return part


def _incidence(context: Context, u: float, rng: np.random.Generator) -> Found:
    loss = 0.008 * 30**u * rng.uniform(0.8, 1.25)
    return {"parameters": {"alpha_max": context.quantile(context.hits.incidence, 1 - loss)}}


def _max_range(context: Context, u: float, rng: np.random.Generator) -> Found:
    loss = 0.008 * 50**u * rng.uniform(0.8, 1.2)
    inside = min(context.quantile(context.hits.ranges, 1 - loss), 0.98 * context.robot.range_max)
    return {"parameters": {"R": inside}}


def _min_range(context: Context, u: float, rng: np.random.Generator) -> Found:
    loss = 0.008 * 20**u * rng.uniform(0.8, 1.2)
    r_min = max(context.quantile(context.hits.ranges, loss), context.robot.range_min + 0.05)
    return {"parameters": {"r_min": r_min}, "extra": {"reads": float(rng.choice([-np.inf, np.inf]))}}


def _unmapped(context: Context, u: float, rng: np.random.Generator) -> Found:
    r = size_of("unmapped_obstacle", u)
    way = shapely.LineString(context.driven.poses[::20, :2])
    free = context.room.free().buffer(-r - 0.05)
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
    return {"parameters": {"x": x, "y": y, "r": r}, "xy": (x, y)}


def _obstacle(context: Context, rng: np.random.Generator) -> Found:
    name = context.pick_obstacle(rng)
    x, y = map(float, shapely.Polygon(context.room.rings[name]).centroid.coords[0])
    return {"parameters": {}, "place": name, "xy": (x, y)}


def _moved_obstacle(context: Context, u: float, rng: np.random.Generator) -> Found:
    return _obstacle(context, rng) | {"parameters": _shift("moved_obstacle", u, rng)}


def _moved_wall(context: Context, u: float, rng: np.random.Generator) -> Found:
    wall = context.pick_wall(rng)
    a, b = context.room.edge(wall)
    d = float(rng.choice([-1, 1])) * size_of("moved_wall", u)
    return {"parameters": {"d": d}, "place": wall, "xy": tuple(map(float, (a + b) / 2))}


def _people(context: Context, u: float, rng: np.random.Generator) -> Found:
    """Persons as bodies or pairs of legs that walk between random places for part of the run."""
    free = largest_part(context.room.free().buffer(-0.3))
    found = walkers(free, float(context.driven.stamps[-1]), u, rng)
    return {"parameters": {"p": None}, "extra": {"walkers": found}}


def _range_drift(context: Context, u: float, rng: np.random.Generator) -> Found:
    values = {"b1": float(rng.choice([-1, 1])) * size_of("range_drift", u)}
    if rng.random() < 0.4:
        values["tau"] = float(rng.uniform(8, 30))
    return {"parameters": values}


def _sonar(context: Context, u: float, rng: np.random.Generator) -> Found:
    gamma = float((7 + 12 * u) * DEG * rng.uniform(0.9, 1.1))
    return {"parameters": {"gamma": gamma, "alpha_max": float(rng.uniform(15, 45)) * DEG}}


def _tilt(context: Context, u: float, rng: np.random.Generator) -> Found:
    far = context.quantile(context.hits.ranges, 0.97 - 0.35 * u)
    beta = float(math.atan(context.robot.height / far) * rng.uniform(1.0, 1.15))
    inside = context.robot.bearings
    return {"parameters": {"beta": beta, "theta0": float(rng.uniform(0.6 * inside[0], 0.6 * inside[-1]))}}


def _slip(context: Context, u: float, rng: np.random.Generator) -> Found:
    r = float(rng.uniform(0.45, 0.9))
    spots = context.driven.poses[:: max(1, len(context.driven.poses) // 200), :2]
    moving = np.abs(context.driven.wheels[:, 0]) > 0.08
    track = context.driven.poses[moving, :2][::10]
    visits = np.array([(np.hypot(*(track - spot).T) < r).sum() for spot in spots])
    spot = rng.choice(spots[visits >= np.quantile(visits, 0.6)])
    x, y = float(spot[0]), float(spot[1])
    return {"parameters": {"s": size_of("wheel_slip", u), "x": x, "y": y, "r": r}, "xy": (x, y)}


def _saturation(context: Context, u: float, rng: np.random.Generator) -> Found:
    fastest = float(np.abs(context.driven.commands[:, 0]).max())
    return {"parameters": {"v_max": fastest - size_of("speed_saturation", u)}}


def _clock_offset(context: Context, u: float, rng: np.random.Generator) -> Found:
    sign = -1.0 if rng.random() < 0.2 else 1.0
    return {"parameters": {"tau": sign * 0.015 * 20**u}}


DRAWS: dict[str, Draw] = {
    "sector_bias": _sector_bias,
    "mount_xy": lambda context, u, rng: {"parameters": _shift("mount_xy", u, rng)},
    "glass": _glass,
    "mirror": _wall_part,
    "black_surface": _black,
    "incidence_dropout": _incidence,
    "max_range": _max_range,
    "min_range": _min_range,
    "quantisation": lambda context, u, rng: {"parameters": {"q": round(0.004 * 25**u, 3)}},
    "unmapped_obstacle": _unmapped,
    "moved_obstacle": _moved_obstacle,
    "missing_obstacle": lambda context, u, rng: _obstacle(context, rng),
    "moved_wall": _moved_wall,
    "people": _people,
    "range_drift": _range_drift,
    "sonar_cone": _sonar,
    "self_occlusion": _self_occlusion,
    "tilt": _tilt,
    "wheel_slip": _slip,
    "pose_clock_offset": _clock_offset,
    "speed_saturation": _saturation,
}
