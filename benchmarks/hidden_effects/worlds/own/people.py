"""People who walk through the room, as bodies or as pairs of legs."""

from __future__ import annotations

import numpy as np
import shapely

from benchmarks.hidden_effects.log import Floats

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
        at = np.stack([np.interp(fine, stamps, column) for column in centres.T], axis=1)
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
