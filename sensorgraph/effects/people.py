"""Moving people."""

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
"""[nats] Approximate gain of one such reading."""


def transform(scene: Scene, a: Amendment) -> None:
    """Add walking people if the scene is sampled; otherwise add a probability of short readings."""
    if scene.seed is None:
        scene.shorts = 1 - (1 - scene.shorts) * (1 - a["p"])
    elif a["p"] > 0:
        scene.movers = walkers(scene, a["p"], np.random.default_rng([scene.seed, 35]))


def propose(residuals: Residuals) -> list[Proposal]:
    """Count short readings."""
    return share_of_readings(residuals, residuals.short, NATS)


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Compare the share with the usual outliers."""
    return too_few_returns(exposure, typical["p"], need)


PEOPLE = Effect(
    name="people",
    title="moving people",
    channel="scan",
    stage="geometry",
    physics="Moving objects block a share p of the rays.",
    equation="P(short) = p",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3; Fox, Burgard and Thrun (1999)",
    varies="time, equally in neighbouring rays and successive scans",
    rivals={
        "unmapped_obstacle": "look at the place again later",
        "random_outliers": "outliers are scattered single rays, some of them long",
    },
    parameters=(
        Parameter(
            name="p",
            unit="",
            doc="share of rays that end at a moving object",
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
