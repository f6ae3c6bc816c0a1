"""Mirror."""

from __future__ import annotations

from functools import partial

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.places import part_of_wall, reflected
from sensorgraph.effects.set_up import end_of_part_error
from sensorgraph.effects.shared import LOSS_LEFTOVERS, LOST_BY_DIRECTION
from sensorgraph.world.scene import Beams, Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Reflect the rays that meet it."""
    scene.surfaces.append(partial(reflect, a=a))


def reflect(scene: Scene, beams: Beams, *, a: Amendment) -> None:
    """Add the path from the mirror to what the reflected ray meets."""
    on = part_of_wall(scene, beams, a)
    if not on.any():
        return
    further = np.where(on, 0.0, np.nan)
    further[on] = reflected(scene.walls, beams, on)
    beams.ranges = np.where(on, beams.ranges + further, beams.ranges)
    beams.reading = beams.ranges.copy()
    beams.bent()[on] = False


MIRROR = Effect(
    name="mirror",
    title="mirror",
    channel="scan",
    stage="surface",
    physics="A part of a wall reflects the ray, and the path to what it meets next is added.",
    equation="z = r + r mirrored, from a to b along the wall",
    source="Yang and Wang (2011), on solving mirror reflection in lidar sensing",
    varies="one part of one wall, long readings, the geometry of a ghost room",
    rivals={"glass": "view it from two sides; the ghost moves with the room"},
    parameters=(
        Parameter(
            name="a",
            unit="m",
            doc="where the mirror begins, along the wall from its first end",
            neutral=None,
            search_step=0.01,
            hidden=end_of_part_error,
        ),
        Parameter(
            name="b", unit="m", doc="where it ends", neutral=None, search_step=0.01, hidden=end_of_part_error
        ),
    ),
    transform=transform,
    place="wall",
    diagnostics=Diagnostics(leftovers=LOSS_LEFTOVERS, misfit_share=0.012, telltale=LOST_BY_DIRECTION),
)
