"""People who walk about on two legs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.floors.scene import Scene, pose_at

STRIDE = 0.25
"""[m] by which a leg is ahead or behind at most."""
HIPS = 0.11
"""[m] from the middle to a leg."""
MOMENT = 0.1
"""[s] over which a walker's direction is taken."""
BESIDE = 0.4
"""[m] that people keep to the robot."""


def legs(scene: Scene, rng: np.random.Generator, t: Floats, present: Sequence[tuple[float, float]]) -> Floats:
    """Return the legs (n_times, 2 n_people, 3) [m] x, y and radius, 0 while nobody is there.

    Parameters
    ----------
    t : (n_times,) [s]
    present : of each person, when it comes and goes [s]
    """
    found = np.zeros((t.size, 2 * len(present), 3))
    robot_x, robot_y, _ = pose_at(scene.run, t)
    for k, (comes, goes) in enumerate(present):
        times, places = _walk(scene, rng)
        x, y = np.interp(t, times, places[:, 0]), np.interp(t, times, places[:, 1])
        vx = np.interp(t + MOMENT, times, places[:, 0]) - x
        vy = np.interp(t + MOMENT, times, places[:, 1]) - y
        v = np.hypot(vx, vy) + 1e-9
        ux, uy = np.where(v > 1e-6, vx / v, 1), np.where(v > 1e-6, vy / v, 0)
        swing = STRIDE * np.sin(2 * np.pi * 1.0 * t) * np.minimum(1, v / 0.05)
        radius = rng.uniform(0.06, 0.09)
        is_away = np.hypot(robot_x - x, robot_y - y) > scene.robot.footprint + BESIDE
        is_there = (t > comes) & (t < goes) & is_away
        for leg, side in ((0, 1), (1, -1)):
            found[:, 2 * k + leg, 0] = x + ux * swing * side - uy * HIPS * side
            found[:, 2 * k + leg, 1] = y + uy * swing * side + ux * HIPS * side
            found[:, 2 * k + leg, 2] = np.where(is_there, radius, 0)
    return found


def _walk(scene: Scene, rng: np.random.Generator) -> tuple[list[float], Floats]:
    """Return times [s] and places (n, 2) [m] of one who goes from cell to cell, with pauses."""
    ways = scene.ways
    places = [ways.place(int(rng.integers(len(ways.cells))))]
    times = [0.0]
    while times[-1] < scene.duration:
        path = ways.path(places[-1][0], places[-1][1], int(rng.integers(len(ways.cells))))
        lengths = np.hypot(*np.diff(path, axis=0).T)
        speed = rng.uniform(0.5, 1.2)
        for place, length in zip(path[1:], lengths, strict=True):
            times.append(times[-1] + length / speed + 1e-6)
            places.append(place)
        times.append(times[-1] + rng.uniform(0.5, 4))
        places.append(places[-1])
    return times, np.array(places)
