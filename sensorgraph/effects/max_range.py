"""Shorter maximal range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import only_wall
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import cut_off, within_range
from sensorgraph.effects.set_up import map_error
from sensorgraph.effects.shared import LOSS_LEFTOVERS
from sensorgraph.world.scene import Scene, fade

FAR_SHARE = 0.75
"""Of range_max, that a shorter maximal range should show at."""
BEYOND_SHARE = 0.3
"""Of the rays that are lost beyond a limit, that strays from beyond it may come to; more returns show that it is none."""


def transform(scene: Scene, a: Amendment) -> None:
    """Lose far rays."""
    beams = scene.beams
    with np.errstate(invalid="ignore"):
        slack = np.where(np.isfinite(beams.reading), a["R"] - beams.reading, 1.0)
    beams.p_return = fade(slack, scene.sensor.sigma + 1e-4) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Look for the range beyond which nothing returns."""
    found = cut_off(residuals, "R", within_range(residuals), residuals.certain_loss, upward=True)
    return [proposal for proposal in found if is_limit(residuals, proposal.values["R"])]


def is_limit(residuals: Residuals, limit: float) -> bool:
    """Tell whether hardly anything returns from beyond a range [m], of as much as is lost there."""
    lost = residuals.lost & (residuals.mu > limit)
    back = residuals.returned & (residuals.z > limit + residuals.sigma)
    return int(back.sum()) <= BEYOND_SHARE * int(lost.sum())


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the returns from far away."""
    limit = exposure.sensor.range_max
    far = FAR_SHARE * limit
    some = exposure.seen & (exposure.reading > far)
    if exposure.lost(0.0, some) >= need:
        return ""
    farthest = float(exposure.range.max())
    if farthest > far:
        return f"only {int(some.sum())} returns from farther than {far:.1f} m"
    return f"no return from farther than {farthest:.1f} m, of {limit:.0f} m"


def look_alike(exposure: Exposure) -> tuple[str, str] | None:
    """Tell whether all far returns came from one wall."""
    far = FAR_SHARE * exposure.sensor.range_max
    wall = only_wall(exposure, exposure.seen & (exposure.reading > far))
    return ("black_surface", f"all such rays met {wall}") if wall else None


MAX_RANGE = Effect(
    name="max_range",
    title="shorter maximal range",
    channel="scan",
    stage="detection",
    physics="Nothing farther than R returns, though the data sheet says so.",
    equation="no return for r > R",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3: max-range readings",
    varies="range, on all walls alike",
    rivals={
        "black_surface": "look at another wall at the same range",
        "incidence_dropout": "a long view at normal incidence",
        "tilt": "a tilted sensor returns from the floor",
    },
    parameters=(
        Parameter(
            name="R",
            unit="m",
            doc="farthest return",
            neutral=None,
            low=0.0,
            search_step=0.02,
            hidden=map_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(
        unobservable=unobservable, look_alike=look_alike, propose=propose, leftovers=LOSS_LEFTOVERS
    ),
)
