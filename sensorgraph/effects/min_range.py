"""Larger blind zone."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Proposal, Residuals
from sensorgraph.effects.proposals import cut_off, within_range
from sensorgraph.effects.set_up import map_error
from sensorgraph.world.scene import Scene, fade

EITHER_WAY = -0.7
"""[nats] of a reading in the blind zone: about half of them are said to be too near, the others are lost."""


def transform(scene: Scene, a: Amendment) -> None:
    """Lose near rays."""
    if a["r_min"] <= 0:
        return
    beams = scene.beams
    beams.p_return = fade(beams.reading - a["r_min"], scene.sensor.sigma + 1e-4) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Look for the range below which nothing returns, or is said to be too near."""
    gains = np.where(residuals.near, EITHER_WAY - residuals.log_p, residuals.certain_loss)
    return cut_off(residuals, "r_min", within_range(residuals), gains, upward=False)


MIN_RANGE = Effect(
    name="min_range",
    title="larger blind zone",
    channel="scan",
    stage="detection",
    physics="Nothing nearer than r_min returns, though the data sheet says so.",
    equation="no return for r < r_min",
    source="Okubo, Ye and Borenstein (2009), characterization of the Hokuyo URG-04LX",
    varies="small ranges, whatever the bearing",
    rivals={"self_occlusion": "approach a wall with another bearing"},
    parameters=(
        Parameter(
            name="r_min",
            unit="m",
            doc="nearest return",
            low=0.0,
            search_step=0.01,
            typical=0.3,
            hidden=map_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(propose=propose),
)
