"""Sonar cone."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.world.scene import RIGHT_ANGLE, Scene

RAY = np.radians(1.5)  # [rad] between the rays that fill the cone


def transform(scene: Scene, a: Amendment) -> None:
    """Take the nearest return of the cone."""
    gamma = a["gamma"]
    beams = scene.beams
    n_side = max(int(np.ceil(gamma / RAY)), 1) if gamma > 0 else 0
    best = np.full(beams.ranges.shape, np.inf)
    alpha = a["alpha_max"] if a["alpha_max"] < RIGHT_ANGLE else np.inf
    for share in np.arange(-n_side, n_side + 1) / max(n_side, 1):
        part = scene.shoot(gamma * share) if share else beams
        with np.errstate(invalid="ignore"):
            seen = part.incidence <= alpha
        best = np.minimum(best, np.where(seen, part.ranges, np.inf))
    bent = best != beams.ranges
    beams.bent()[bent] = False
    beams.reading = np.where(bent, best, beams.reading)


SONAR_CONE = Effect(
    name="sonar_cone",
    title="sonar cone",
    channel="scan",
    stage="optics",
    physics="The reading is the nearest return within +-gamma, and a surface met at more than alpha_max returns nothing.",
    source="Leonard and Durrant-Whyte (1992), Directed Sonar Sensing for Mobile Robot Navigation",
    varies="arcs of constant depth; corners read short",
    rivals={
        "mixed_pixels": "turn in place before a wall",
        "incidence_dropout": "turn in place before a wall",
    },
    parameters=(
        Parameter(name="gamma", unit="rad", doc="half angle of the cone", low=0.0, high=1.5),
        Parameter(
            name="alpha_max",
            unit="rad",
            doc="largest incidence that returns",
            neutral=RIGHT_ANGLE,
            low=0.0,
            high=RIGHT_ANGLE,
        ),
    ),
    transform=transform,
)
