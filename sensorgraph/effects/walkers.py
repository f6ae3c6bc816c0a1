"""People: discs that walk between random places of the free space."""

from __future__ import annotations

import numpy as np

from sensorgraph.types import Bools, Floats
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.scene import MAX_DISTANCE, Scene

RADIUS = 0.18  # [m] of somebody at the height of the scan
SPEED = (0.4, 1.3)  # [m/s]
APART = 0.35  # [m] that people keep from the middle of the robot
MOST = 40
EVERY = 0.25  # [s] between two looks at how much of the view people take
LOOKS = (50, 800)  # least and most of them


def walkers(scene: Scene, share: float, rng: np.random.Generator) -> Floats:
    """Return (n_scans, n_people, 3) [m] x, y, radius so that about `share` of the rays end at somebody.

    Their paths are drawn for the whole span, so that every part of a run meets the same people.
    """
    n_looks = int(np.clip(scene.span / EVERY, *LOOKS))
    looks = scene.begin + np.linspace(0.0, scene.span, n_looks)
    robot = scene.motion(looks)
    lasers = laser_poses(robot, scene.mount)
    ranges, _ = cast_laser(scene.walls, lasers, scene.bearings, MAX_DISTANCE)
    blocked = np.zeros(ranges.shape, dtype=np.bool_)
    people = []
    for _ in range(MOST):
        times, places = _walk(scene, rng)
        first = int(rng.integers(n_looks))  # the last of them comes and goes, beginning here
        more = _in_view(lasers, scene.bearings, ranges, _at(times, places, looks, robot)) & ~blocked
        gain = np.cumsum(np.roll(more.sum(axis=1), -first)) / more.size
        enough = int(np.searchsorted(gain, share - blocked.mean()))
        stay = min((enough + 1) / n_looks, 1.0) * scene.span
        people.append(_seen(scene, times, places, looks[first], stay))
        blocked |= more
        if enough < n_looks:
            break
    return np.stack(people, axis=1)


def _walk(scene: Scene, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Walk from place to place; return times (n,) [s] and places (n, 2) [m]."""
    x0, y0, x1, y1 = scene.arena.bounds
    times, places = [scene.begin], [rng.uniform([x0, y0], [x1, y1])]
    while times[-1] < scene.begin + scene.span:
        place = rng.uniform([x0, y0], [x1, y1])
        if scene.arena.contains(place):
            way = float(np.hypot(*(place - places[-1])))
            times.append(times[-1] + max(way / rng.uniform(*SPEED), 0.1))
            places.append(place)
    return np.array(times), np.array(places)


def _at(times: Floats, places: Floats, stamps: Floats, robot: Floats) -> Floats:
    """Return where somebody is (n, 2) [m] at stamps (n,): on the way, but out of the robot's."""
    xy = np.stack([np.interp(stamps, times, column) for column in places.T], axis=1)
    away = xy - robot[:, :2]
    far = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)[:, None]
    return np.asarray(robot[:, :2] + away / far * np.maximum(far, APART + RADIUS))


def _seen(scene: Scene, times: Floats, places: Floats, start: float, stay: float) -> Floats:
    """Return (n_scans, 3) x, y, radius; the radius is 0 while somebody is away (before `start`, after `stay`)."""
    xy = _at(times, places, scene.stamps, scene.motion(scene.stamps))
    here = (scene.stamps - start) % max(scene.span, 1e-9) <= stay
    return np.column_stack([xy, np.where(here, RADIUS, 0.0)])


def _in_view(lasers: Floats, bearings: Floats, ranges: Floats, xy: Floats) -> Bools:
    """Tell which rays (n, n_rays) end at a disc at xy (n, 2)."""
    x, y = xy[:, 0] - lasers[:, 0], xy[:, 1] - lasers[:, 1]
    far = np.maximum(np.hypot(x, y), RADIUS)
    aside = (lasers[:, 2:] + bearings - np.arctan2(y, x)[:, None] + np.pi) % (2 * np.pi) - np.pi
    return np.asarray((np.abs(aside) < np.arcsin(RADIUS / far)[:, None]) & (far[:, None] < ranges))
