"""People walking about."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import too_few_returns
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import share_of_readings
from sensorgraph.effects.walkers import walkers
from sensorgraph.world.scene import Scene

NATS = 1.1
"""[nats] that one such reading gains, about."""


def transform(scene: Scene, a: Amendment) -> None:
    """Let people walk, if the scene is drawn; else give every ray a chance to be short."""
    if scene.seed is None:
        scene.shorts = 1 - (1 - scene.shorts) * (1 - a["p"])
    elif a["p"] > 0:
        scene.movers = walkers(scene, a["p"], np.random.default_rng([scene.seed, 35]))


def propose(residuals: Residuals) -> list[Proposal]:
    """Count short readings."""
    return share_of_readings(residuals, residuals.short, NATS)


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Compare the share with the strays that need no effect."""
    return too_few_returns(exposure, typical["p"], need)


PEOPLE = Effect(
    name="people",
    title="people walking about",
    channel="scan",
    stage="geometry",
    physics="Something that moves stands in the way of a share p of the rays.",
    equation="P(short) = p",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3; Fox, Burgard and Thrun (1999)",
    varies="time; neighbouring rays and successive scans together",
    rivals={
        "unmapped_obstacle": "come back later",
        "random_outliers": "scattered single rays, also longer ones",
    },
    parameters=(
        Parameter(
            name="p",
            unit="",
            doc="share of rays that end at somebody",
            materiality=0.002,
            low=0.0,
            high=1.0,
            search_step=0.005,
        ),
    ),
    transform=transform,
    absorber=True,
    diagnostics=Diagnostics(
        unobservable=unobservable,
        propose=propose,
        explains="short readings",
        misfit_share=0.06,
        is_forecast=False,
    ),
)
