"""Range scale."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import spread_of_ranges
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Stretch each reading."""
    beams = scene.beams
    beams.reading = (1 + a["s"]) * beams.reading
    beams.slope = (1 + a["s"]) * beams.slope


RANGE_SCALE = Effect(
    name="range_scale",
    title="range scale",
    channel="scan",
    stage="range",
    physics="Each return is stretched in proportion to its range: z = (1 + s) r.",
    equation="z = (1 + s) r",
    source="Okubo, Ye and Borenstein (2009), characterization of the Hokuyo URG-04LX",
    varies="range",
    rivals={
        "map_scale": "look at the same wall from near and from far, from two sides",
        "range_bias": "look at very near and very far walls",
    },
    parameters=(
        Parameter(
            name="s",
            unit="",
            doc="relative stretch",
            materiality=0.002,
            step=1e-3,
            jump=300.0,
            nuisance=Nuisance.SCALE,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=spread_of_ranges, site_start={"s": 0.0}, question_rank=3),
)
