"""Effects planted in a measured run, by code that knows nothing of the project's effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import shapely

from benchmarks.planted_site import MAP_MIN_RANGE, Floats, LogWindow, limited, measured_rays
from logs import Run
from logs.transforms import compose

DEGREES = 180 / np.pi


def _of(name: str, scale: float = 1.0) -> Callable[[Mapping[str, float]], float]:
    """Read the size from one parameter."""
    return lambda parameters: float(parameters[name]) * scale


def _offset(parameters: Mapping[str, float]) -> float:
    """Return the length of the shift [m]."""
    return float(np.hypot(parameters["dx"], parameters["dy"]))


def _width(parameters: Mapping[str, float]) -> float:
    """Return the width of the sector [deg]."""
    return float(parameters["theta2"] - parameters["theta1"]) * DEGREES


@dataclass(frozen=True)
class Plant:
    """One effect to be planted, with the name it should be given."""

    label: str
    name: str
    size: float
    unit: str
    change: Callable[[Run, Run, LogWindow, float, np.random.Generator], Run]
    """(measurement, whole log, window, size, rng) -> measurement with the effect."""
    estimate: Callable[[Mapping[str, float]], float]
    """Parameters of the named effect -> the size that they say, in this unit."""


def _ranges(run: Run, ranges: Floats) -> Run:
    return replace(run, ranges=limited(ranges))


def bias(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Lengthen every reading."""
    return _ranges(run, run.ranges + size)


def drift(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Lengthen readings more and more."""
    t = (run.stamps - run.stamps[0]) / (run.stamps[-1] - run.stamps[0])
    return _ranges(run, run.ranges + size * t[:, None])


def sector(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Lengthen the readings of a sector of 35 degrees."""
    first = np.radians(rng.uniform(-80, 45))
    inside = (run.sensor.bearings >= first) & (run.sensor.bearings < first + np.radians(35))
    return _ranges(run, run.ranges + size * inside)


def yaw(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Give every ray the reading of the real beam that points further to the left by a whole count of rays."""
    step = float(np.diff(log.sensor.bearings).mean())
    turn = round(np.radians(size) / step)
    rays = measured_rays(log) + turn
    inside = (rays >= 0) & (rays < log.sensor.n_rays)
    ranges = log.ranges[window.scans][:, np.clip(rays, 0, log.sensor.n_rays - 1)]
    return _ranges(run, np.where(inside, ranges, np.nan))


def offset(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Report poses of a body whose laser sits forward of where it is thought to be, or to a side."""
    angle = run.poses[:, 2] + rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2])
    poses = run.poses.copy()
    poses[:, 0] -= size * np.cos(angle)
    poses[:, 1] -= size * np.sin(angle)
    return replace(run, poses=poses)


def occlusion(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Hide a sector behind a part of the robot, 0.3 m away."""
    width = np.radians(size)
    first = rng.uniform(run.sensor.bearings[0], run.sensor.bearings[-1] - width)
    inside = (run.sensor.bearings >= first) & (run.sensor.bearings <= first + width)
    inside[np.argmin(np.abs(run.sensor.bearings - first - width / 2))] = True
    part = np.round(0.3 + rng.normal(size=run.ranges.shape) * 0.008, 2)
    hidden = inside & ~(run.ranges < part)
    return _ranges(run, np.where(hidden, part, run.ranges))


def cut_off(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Lose what is farther."""
    return _ranges(run, np.where(run.ranges > size, np.inf, run.ranges))


def lattice(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Round every reading."""
    return _ranges(run, np.round(run.ranges / size) * size)


def pillar(run: Run, log: Run, window: LogWindow, size: float, rng: np.random.Generator) -> Run:
    """Stand a round pillar of this diameter in the map's free space beside the path: of 400 places, the one most rays meet."""
    radius = size / 2
    best, most = run, 0
    laser = compose(run.poses, np.array(run.sensor.mount))
    for _ in range(400):
        k = rng.integers(len(run.stamps))
        away, angle = rng.uniform(0.6, 1.5), run.poses[k, 2] + rng.uniform(-1.2, 1.2)
        x, y = run.poses[k, 0] + away * np.cos(angle), run.poses[k, 1] + away * np.sin(angle)
        standing = shapely.Point(x, y).buffer(radius)
        apart = np.hypot(run.poses[:, 0] - x, run.poses[:, 1] - y).min()
        if apart < radius + 0.4 or not window.arena.free.contains(standing):
            continue
        dx, dy = x - laser[:, :1], y - laser[:, 1:2]
        heading = laser[:, 2:] + run.sensor.bearings
        ahead = dx * np.cos(heading) + dy * np.sin(heading)
        aside = dx * np.sin(heading) - dy * np.cos(heading)
        with np.errstate(invalid="ignore"):
            r = ahead - np.sqrt(radius**2 - aside**2)
        met = (r > MAP_MIN_RANGE) & (run.ranges > r + 0.1)
        inside = (r > MAP_MIN_RANGE) & (run.ranges < r - 0.1)  # something real stands before it
        if met.sum() > most and inside.sum() < 0.2 * met.sum():
            seen = np.round(r + rng.normal(size=r.shape) * 0.008, 2)
            best, most = _ranges(run, np.where(met, seen, run.ranges)), int(met.sum())
    return best


FULL_SIZE = (
    Plant("bias", "range_bias", 0.03, "m", bias, _of("b")),
    Plant("offset", "mount_xy", 0.06, "m", offset, _offset),
    Plant("yaw", "mount_yaw", 1.0, "deg", yaw, _of("delta", DEGREES)),
    Plant("drift", "range_drift", 0.02, "m", drift, _of("b1")),
    Plant("sector 35 deg", "sector_bias", 0.06, "m", sector, _of("b")),
    Plant("occlusion", "self_occlusion", 3.0, "deg", occlusion, _width),
    Plant("occlusion", "self_occlusion", 10.0, "deg", occlusion, _width),
    Plant("max range", "max_range", 4.0, "m", cut_off, _of("R")),
    Plant("max range", "max_range", 2.5, "m", cut_off, _of("R")),
    Plant("lattice", "quantisation", 0.03, "m", lattice, _of("q")),
    Plant("lattice", "quantisation", 0.08, "m", lattice, _of("q")),
    Plant("pillar", "unmapped_obstacle", 0.20, "m", pillar, _of("r", 2.0)),
)
HALF_SIZE = tuple(
    replace(plant, size=plant.size / 2)
    for plant in FULL_SIZE
    if plant.name not in ("max_range", "quantisation")
)
