"""Range bias."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import count_of_returns
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Add b to each reading."""
    scene.beams.reading = scene.beams.reading + a["b"]


RANGE_BIAS = Effect(
    name="range_bias",
    title="range bias",
    channel="scan",
    stage="range",
    physics="Each return has a constant offset: z = r + b.",
    equation="z = r + b",
    source="Reina and Gonzales (1997), characterisation of a radial laser scanner",
    varies="no quantity (equal on all rays)",
    rivals={
        "range_scale": "look at very near and very far walls",
        "map_scale": "a bias changes the size of obstacles by a constant",
    },
    parameters=(
        Parameter(
            name="b",
            unit="m",
            doc="offset of each return",
            materiality=0.005,
            step=1e-3,
            nuisance=Nuisance.BIAS,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=count_of_returns, site_start={"b": 0.0}),
)
