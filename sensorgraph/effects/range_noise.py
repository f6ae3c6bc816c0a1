"""Range-dependent noise."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Widen every return by k r."""
    beams = scene.beams
    r = np.where(np.isfinite(beams.reading), beams.reading, 0.0)
    beams.sigma = np.sqrt(np.square(beams.sigma) + (a["k"] * r) ** 2)


RANGE_NOISE = Effect(
    name="range_noise",
    title="range-dependent noise",
    channel="scan",
    stage="noise",
    physics="The noise grows with the range: sigma^2 = sigma_0^2 + (k r)^2.",
    equation="σ² = σ₀² + (k r)²",
    source="Reina and Gonzales (1997), characterisation of a radial laser scanner",
    varies="variance of the residual against range",
    rivals={
        "random_outliers": "outliers are far off and rare at every range",
        "pose_clock_offset": "stand still before a far wall at normal incidence",
    },
    parameters=(
        Parameter(
            name="k", unit="m/m", doc="growth of the noise", materiality=0.0025, low=0.0, search_step=0.002
        ),
    ),
    transform=transform,
    absorber=True,
    diagnostics=Diagnostics(site_start={"k": 0.004}),
)
