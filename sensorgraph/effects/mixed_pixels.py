"""Mixed pixels of a wide beam."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.world.scene import Scene

SPREAD = (-0.875, -0.625, -0.375, -0.125, 0.125, 0.375, 0.625, 0.875)
"""Of the half angle: where the rays of one beam go."""
GRAZING = 1.5  # [rad] walls met at more are taken as if met at this
STEP = 0.02  # [m] a smaller step in depth is a bent wall, not an edge


def transform(scene: Scene, a: Amendment) -> None:
    """Average the readings of rays spread over the beam."""
    gamma = a["gamma"]
    if gamma == 0.0:
        return
    beams = scene.beams
    parts = [scene.shoot(gamma * share).ranges for share in SPREAD]
    both = np.stack([beams.ranges, *parts])
    seen = np.isfinite(both)
    step = np.where(seen.all(axis=0), np.ptp(np.where(seen, both, 0.0), axis=0), 0.0)
    alpha = np.minimum(beams.incidence, GRAZING - gamma)
    flat = beams.ranges * np.cos(alpha) * (1 / np.cos(alpha + gamma) - 1 / np.cos(alpha - gamma))
    edge = step > flat + STEP
    beams.bent()[edge] = False
    beams.reading = np.where(edge, beams.reading + both[1:].mean(axis=0) - beams.ranges, beams.reading)


MIXED_PIXELS = Effect(
    name="mixed_pixels",
    title="mixed pixels of a wide beam",
    channel="scan",
    stage="optics",
    physics="A beam of half angle gamma returns the mean over what it lights, so that edges read between near and far.",
    source="Tuley, Vandapel and Hebert (2005), analysis and removal of artifacts in 3-D ladar data",
    varies="only within gamma of depth edges",
    rivals={
        "moved_obstacle": "a slow pass by an edge with a deep step",
        "mount_yaw": "walls away from edges do not move",
    },
    parameters=(
        Parameter(name="gamma", unit="rad", doc="half angle of the beam", materiality=0.0020944, low=0.0),
    ),
    transform=transform,
    absorber=True,
)
