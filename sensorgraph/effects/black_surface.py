"""Black, absorbing surface."""

from __future__ import annotations

from functools import partial

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.places import part_of_wall
from sensorgraph.effects.set_up import end_of_part_error
from sensorgraph.effects.shared import LOSS_LEFTOVERS, LOST_BY_DIRECTION
from sensorgraph.world.scene import Beams, Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Lose rays that meet it slanting or from afar."""
    scene.surfaces.append(partial(absorb, a=a))


def absorb(scene: Scene, beams: Beams, *, a: Amendment) -> None:
    """Lower the chance of a return on the black part."""
    on = part_of_wall(scene, beams, a)
    near = min(a["r0"], 1e6) / np.maximum(beams.ranges, 1e-6)
    chance = np.minimum(1.0, beams.cosine * near**2)
    beams.p_return = np.where(on, chance, 1.0) * beams.p_return


BLACK_SURFACE = Effect(
    name="black_surface",
    title="black, absorbing surface",
    channel="scan",
    stage="surface",
    physics="A dark part of a wall returns with probability min(1, cos(incidence) (r0 / r)^2).",
    equation="P(return) = min(1, cos α (r₀ / r)²), from a to b along the wall",
    source="Jelalian (1992), laser radar systems: the range equation of a Lambertian target",
    varies="one part of one wall, losses that grow with range and incidence",
    rivals={
        "max_range": "another wall at the same range",
        "incidence_dropout": "another wall at the same incidence",
    },
    parameters=(
        Parameter(
            name="a",
            unit="m",
            doc="where it begins, along the wall from its first end",
            neutral=None,
            search_step=0.01,
            hidden=end_of_part_error,
        ),
        Parameter(
            name="b", unit="m", doc="where it ends", neutral=None, search_step=0.01, hidden=end_of_part_error
        ),
        Parameter(
            name="r0",
            unit="m",
            doc="a head-on return is sure up to this range",
            neutral=None,
            low=0.0,
            search_step=0.05,
            typical=1.0,
        ),
    ),
    transform=transform,
    place="wall",
    diagnostics=Diagnostics(leftovers=LOSS_LEFTOVERS, misfit_share=0.012, telltale=LOST_BY_DIRECTION),
)
