"""Drop-out at slanting incidence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import only_wall
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import cut_off, within_range
from sensorgraph.effects.set_up import wall_direction_error
from sensorgraph.effects.shared import LOSS_LEFTOVERS
from sensorgraph.world.scene import RIGHT_ANGLE, Scene, fade

BLUR = 0.003  # [rad] over which it sets in

STEEP = float(np.radians(70.0))
"""[rad] of incidence that tells a drop-out on all walls from one black wall."""


def transform(scene: Scene, a: Amendment) -> None:
    """Lose slanting rays."""
    if a["alpha_max"] >= RIGHT_ANGLE:
        return
    beams = scene.beams
    slack = np.where(np.isfinite(beams.ranges), a["alpha_max"] - beams.incidence, 1.0)
    beams.p_return = fade(slack, BLUR) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Look for the incidence beyond which nothing returns."""
    incidence = np.where(np.isfinite(within_range(residuals)), residuals.incidence, np.nan)
    return cut_off(residuals, "alpha_max", incidence, residuals.certain_loss, upward=True)


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the rays that met a wall slanting."""
    alpha = typical["alpha_max"]
    some = exposure.incidence > alpha
    if exposure.lost(0.0, some) >= need:
        return ""
    return f"only {int(some.sum())} rays met a wall at more than {np.degrees(alpha):.0f} degrees"


def look_alike(exposure: Exposure) -> tuple[str, str] | None:
    """Tell whether all slanting rays met one wall."""
    wall = only_wall(exposure, exposure.incidence > STEEP)
    return ("black_surface", f"all such rays met {wall}") if wall else None


INCIDENCE_DROPOUT = Effect(
    name="incidence_dropout",
    title="drop-out at slanting incidence",
    channel="scan",
    stage="detection",
    physics="A surface met at more than alpha_max returns nothing.",
    equation="no return for α > α_max",
    source="Okubo, Ye and Borenstein (2009), characterization of the Hokuyo URG-04LX",
    varies="incidence, on all walls alike",
    rivals={
        "black_surface": "look at another wall at the same range and incidence",
        "max_range": "look at a far wall head-on",
    },
    parameters=(
        Parameter(
            name="alpha_max",
            unit="rad",
            doc="largest incidence that returns",
            neutral=RIGHT_ANGLE,
            low=0.0,
            high=RIGHT_ANGLE,
            search_step=0.01,
            typical=float(np.radians(75.0)),
            hidden=wall_direction_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(
        unobservable=unobservable, look_alike=look_alike, propose=propose, leftovers=LOSS_LEFTOVERS
    ),
)
