"""Simulate people as discs that walk between random places of the free space."""

from __future__ import annotations

import numpy as np

from sensorgraph.types import Bools, Floats
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.scene import MAX_DISTANCE, Scene

RADIUS = 0.18  # [m] of a person at the height of the scan
SPEED = (0.4, 1.3)  # [m/s] limits of the walking speed
CLEARANCE = 0.35  # [m] minimum distance between a person and the centre of the robot
MAX_PEOPLE = 40
SAMPLE_STEP = 0.25  # [s] between samples of the share of blocked rays
N_SAMPLES = (50, 800)  # limits of the number of samples


def walkers(scene: Scene, share: float, rng: np.random.Generator) -> Floats:
    """Return x, y, radius (n_scans, n_people, 3) [m] so that about `share` of the rays end at a person.

    Their paths are drawn for the whole span, so that all parts of a run contain the same people.
    """
    n_samples = int(np.clip(scene.span / SAMPLE_STEP, *N_SAMPLES))
    samples = scene.begin + np.linspace(0.0, scene.span, n_samples)
    robot = scene.motion(samples)
    lasers = laser_poses(robot, scene.mount)
    ranges, _ = cast_laser(scene.walls, lasers, scene.bearings, MAX_DISTANCE)
    blocked = np.zeros(ranges.shape, dtype=np.bool_)
    people = []
    for _ in range(MAX_PEOPLE):
        times, places = _walk(scene, rng)
        first = int(rng.integers(n_samples))  # the last person is present for a part of the span, from here
        more = _in_view(lasers, scene.bearings, ranges, _at(times, places, samples, robot)) & ~blocked
        gain = np.cumsum(np.roll(more.sum(axis=1), -first)) / more.size
        enough = int(np.searchsorted(gain, share - blocked.mean()))
        stay = min((enough + 1) / n_samples, 1.0) * scene.span
        people.append(_present(scene, times, places, samples[first], stay))
        blocked |= more
        if enough < n_samples:
            break
    return np.stack(people, axis=1)


def _walk(scene: Scene, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw a walk between random places; return times (n,) [s] and places (n, 2) [m]."""
    x0, y0, x1, y1 = scene.arena.bounds
    times, places = [scene.begin], [rng.uniform([x0, y0], [x1, y1])]
    while times[-1] < scene.begin + scene.span:
        place = rng.uniform([x0, y0], [x1, y1])
        if scene.arena.contains(place):
            distance = float(np.hypot(*(place - places[-1])))
            times.append(times[-1] + max(distance / rng.uniform(*SPEED), 0.1))
            places.append(place)
    return np.array(times), np.array(places)


def _at(times: Floats, places: Floats, stamps: Floats, robot: Floats) -> Floats:
    """Return the position (n, 2) [m] of a person at stamps (n,), moved away from the robot if too near."""
    xy = np.stack([np.interp(stamps, times, column) for column in places.T], axis=1)
    away = xy - robot[:, :2]
    far = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)[:, None]
    return np.asarray(robot[:, :2] + away / far * np.maximum(far, CLEARANCE + RADIUS))


def _present(scene: Scene, times: Floats, places: Floats, start: float, stay: float) -> Floats:
    """Return x, y, radius (n_scans, 3); the radius is 0 unless the person is present, from `start` for `stay` [s]."""
    xy = _at(times, places, scene.stamps, scene.motion(scene.stamps))
    here = (scene.stamps - start) % max(scene.span, 1e-9) <= stay
    return np.column_stack([xy, np.where(here, RADIUS, 0.0)])


def _in_view(lasers: Floats, bearings: Floats, ranges: Floats, xy: Floats) -> Bools:
    """Return which rays (n, n_rays) end at a disc at xy (n, 2)."""
    x, y = xy[:, 0] - lasers[:, 0], xy[:, 1] - lasers[:, 1]
    far = np.maximum(np.hypot(x, y), RADIUS)
    aside = (lasers[:, 2:] + bearings - np.arctan2(y, x)[:, None] + np.pi) % (2 * np.pi) - np.pi
    return np.asarray((np.abs(aside) < np.arcsin(RADIUS / far)[:, None]) & (far[:, None] < ranges))
