"""Reduced maximum range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import LOSS_LEFTOVERS, cut_off, within_range
from sensorgraph.effects.set_up import map_error
from sensorgraph.world.scene import Scene, fade

FAR_SHARE = 0.75
"""Share of range_max at which a reduced maximum range should be visible."""
BEYOND_SHARE = 0.3
"""Maximum number of returns from beyond a limit, as a share of the missing returns there; more show that it is no limit."""


def transform(scene: Scene, a: Amendment) -> None:
    """Lose rays of long range."""
    beams = scene.beams
    with np.errstate(invalid="ignore"):
        slack = np.where(np.isfinite(beams.reading), a["R"] - beams.reading, 1.0)
    beams.p_return = fade(slack, scene.sensor.sigma + 1e-4) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for the range above which no ray returns."""
    found = cut_off(residuals, "R", within_range(residuals), residuals.certain_loss, upward=True)
    return [proposal for proposal in found if is_limit(residuals, proposal.values["R"])]


def is_limit(residuals: Residuals, limit: float) -> bool:
    """Return whether few rays return from beyond a range [m], compared with the missing returns there."""
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
    return f"no return from farther than {farthest:.1f} m, with a range of {limit:.0f} m"


MAX_RANGE = Effect(
    name="max_range",
    title="reduced maximum range",
    channel="scan",
    stage="detection",
    physics="Surfaces farther than R do not return, although the data sheet specifies a longer range.",
    equation="no return for r > R",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3: max-range readings",
    varies="range, equally on all walls",
    rivals={
        "black_surface": "look at another wall at the same range",
        "incidence_dropout": "look at a far wall at normal incidence",
        "tilt": "a tilted sensor measures the floor",
    },
    parameters=(
        Parameter(
            name="R",
            unit="m",
            doc="longest range of a return",
            neutral=None,
            low=0.0,
            search_step=0.02,
            hidden=map_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, leftovers=LOSS_LEFTOVERS),
)
