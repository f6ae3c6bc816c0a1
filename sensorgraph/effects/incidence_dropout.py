"""Missing returns at oblique incidence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import LOSS_LEFTOVERS, cut_off, within_range
from sensorgraph.effects.set_up import wall_direction_error
from sensorgraph.world.scene import RIGHT_ANGLE, Scene, fade

BLUR = 0.003  # [rad] width of the transition


def transform(scene: Scene, a: Amendment) -> None:
    """Lose rays at oblique incidence."""
    if a["alpha_max"] >= RIGHT_ANGLE:
        return
    beams = scene.beams
    slack = np.where(np.isfinite(beams.ranges), a["alpha_max"] - beams.incidence, 1.0)
    beams.p_return = fade(slack, BLUR) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for the incidence above which no ray returns."""
    incidence = np.where(np.isfinite(within_range(residuals)), residuals.incidence, np.nan)
    return cut_off(residuals, "alpha_max", incidence, residuals.certain_loss, upward=True)


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the rays that hit a wall at oblique incidence."""
    alpha = typical["alpha_max"]
    some = exposure.incidence > alpha
    if exposure.lost(0.0, some) >= need:
        return ""
    return f"only {int(some.sum())} rays hit a wall at an incidence above {np.degrees(alpha):.0f} degrees"


INCIDENCE_DROPOUT = Effect(
    name="incidence_dropout",
    title="missing returns at oblique incidence",
    channel="scan",
    stage="detection",
    physics="A ray at an incidence above alpha_max does not return.",
    equation="no return for α > α_max",
    source="Okubo, Ye and Borenstein (2009), characterization of the Hokuyo URG-04LX",
    varies="incidence, equally on all walls",
    rivals={
        "black_surface": "look at another wall at the same range and incidence",
        "max_range": "look at a far wall at normal incidence",
    },
    parameters=(
        Parameter(
            name="alpha_max",
            unit="rad",
            doc="largest incidence of a return",
            neutral=RIGHT_ANGLE,
            low=0.0,
            high=RIGHT_ANGLE,
            search_step=0.01,
            typical=float(np.radians(75.0)),
            hidden=wall_direction_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, leftovers=LOSS_LEFTOVERS),
)
