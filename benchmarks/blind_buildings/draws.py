"""Sizes of what is hidden."""

from __future__ import annotations

import math

from benchmarks.blind_buildings.scene import Scene

DEGREE = math.pi / 180


def even(scene: Scene, low: float, high: float) -> float:
    """Draw a number between two."""
    return float(scene.rng.uniform(low, high))


def size(scene: Scene, materiality: float, low: float = 1.7, high: float = 6.0) -> float:
    """Draw low to high times what matters, its logarithm even."""
    return materiality * math.exp(scene.rng.uniform(math.log(low), math.log(high)))


def sign(scene: Scene) -> float:
    """Draw -1 or 1."""
    return float(scene.rng.choice([-1, 1]))


def rounded(**parameters: float) -> dict[str, float]:
    """Return parameters as they are applied and told."""
    return {name: round(float(value), 5) for name, value in parameters.items()}


def sector(scene: Scene, width: float) -> tuple[float, float]:
    """Draw the ends [rad] of a sector of the scan, of some width [rad]."""
    bearings = scene.robot.bearings
    first = scene.rng.uniform(bearings[0], bearings[-1] - width)
    return first, first + width
