"""Random outliers."""

from __future__ import annotations

from collections.abc import Mapping

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import too_few_returns
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import share_of_readings
from sensorgraph.effects.set_up import share_of_strays
from sensorgraph.world.scene import Scene

NATS = 1.0
"""[nats] Approximate gain of one such reading."""


def transform(scene: Scene, a: Amendment) -> None:
    """Add a probability of uniform readings."""
    scene.outliers = 1 - (1 - scene.outliers) * (1 - a["p"])


def propose(residuals: Residuals) -> list[Proposal]:
    """Count outliers."""
    return share_of_readings(residuals, residuals.strange, NATS)


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Compare the share with the usual outliers."""
    return too_few_returns(exposure, typical["p"], need)


RANDOM_OUTLIERS = Effect(
    name="random_outliers",
    title="random outliers",
    channel="scan",
    stage="noise",
    physics="With probability p a reading is uniform over (0, range_max).",
    equation="P(z uniform over 0 … range_max) = p",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3: random measurements",
    varies="no quantity (scattered single rays)",
    rivals={
        "people": "readings of people are clustered and move",
        "range_noise": "compare the readings at standstill",
    },
    parameters=(
        Parameter(
            name="p",
            unit="",
            doc="share of uniform readings",
            materiality=0.002,
            low=0.0,
            high=1.0,
            search_step=0.002,
            hidden=share_of_strays,
        ),
    ),
    transform=transform,
    absorber=True,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, explains="strays", is_forecast=False),
)
