"""Larger minimum range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import cut_off, within_range
from sensorgraph.effects.set_up import map_error
from sensorgraph.world.scene import Scene, fade

EITHER_WAY = -0.7
"""[nats] Log-likelihood of a reading in the blind zone: about half are reported as too near, the others are missing."""


def transform(scene: Scene, a: Amendment) -> None:
    """Lose rays of short range."""
    if a["r_min"] <= 0:
        return
    beams = scene.beams
    beams.p_return = fade(beams.reading - a["r_min"], scene.sensor.sigma + 1e-4) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for the range below which no ray returns, or is reported as too near."""
    gains = np.where(residuals.near, EITHER_WAY - residuals.log_p, residuals.certain_loss)
    return cut_off(residuals, "r_min", within_range(residuals), gains, upward=False)


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the returns of short range."""
    r_min = typical["r_min"]
    some = exposure.seen & (exposure.reading < r_min)
    if exposure.lost(0.0, some) >= need:
        return ""
    nearest = float(exposure.reading[exposure.seen].min()) if exposure.n_seen else 0.0
    if nearest < r_min:
        return f"only {int(some.sum())} returns from nearer than {r_min:.1f} m"
    return f"no return from nearer than {nearest:.2f} m"


MIN_RANGE = Effect(
    name="min_range",
    title="larger minimum range",
    channel="scan",
    stage="detection",
    physics="Surfaces nearer than r_min do not return, although the data sheet specifies a shorter minimum range: the reading is missing or reported as too near.",
    equation="no return for r < r_min",
    source="Okubo, Ye and Borenstein (2009), characterization of the Hokuyo URG-04LX",
    varies="range, at all bearings",
    rivals={"self_occlusion": "approach a wall at another bearing"},
    parameters=(
        Parameter(
            name="r_min",
            unit="m",
            doc="shortest range of a return",
            low=0.0,
            search_step=0.01,
            typical=0.3,
            hidden=map_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose),
)
