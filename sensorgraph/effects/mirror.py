"""Mirror."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect
from sensorgraph.effects.exposures import UNEXPECTED, blind_walls
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.places import ends_of_part, part_of_wall, reflected
from sensorgraph.effects.proposals import (
    LOSS_LEFTOVERS,
    best_first,
    best_part,
    on_part_of_wall,
    sharpen_part,
    strange_on_walls,
)
from sensorgraph.world.beams import Beams
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Add the reflection of rays."""
    scene.surfaces.append(partial(reflect, a=a))


def reflect(scene: Scene, beams: Beams, *, a: Amendment) -> None:
    """Add the distance from the mirror to the hit of the reflected ray."""
    on = part_of_wall(scene, beams, a)
    if not on.any():
        return
    further = np.where(on, 0.0, np.nan)
    further[on] = reflected(scene.walls, beams, on)
    beams.ranges = np.where(on, beams.ranges + further, beams.ranges)
    beams.reading = beams.ranges.copy()
    beams.bent()[on] = False


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for long readings that show the mirrored room in a part of one wall."""
    on, walls = strange_on_walls(residuals)
    found = []
    for wall in walls:
        mine = on & (residuals.beams.wall == wall)
        seen = residuals.mu[mine] + reflected(residuals.walls, residuals.beams, mine)
        gain = residuals.likely(seen, mine) - residuals.log_p[mine]
        along = residuals.along[mine]
        first, last, total = best_part(along, gain)
        a, b, exact = sharpen_part(along, gain, first, last)
        found.append(on_part_of_wall(residuals, wall, max(exact, total), a=a, b=b))
    return best_first(found)[:2]


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return the walls with too few rays."""
    return blind_walls(exposure, np.asarray(UNEXPECTED * exposure.seen), need, "too few rays hit it")


MIRROR = Effect(
    name="mirror",
    title="mirror",
    channel="scan",
    stage="surface",
    physics="A part of a wall reflects the ray, so that the reading includes the distance to the next surface in the map.",
    equation="z = r + range of the reflected ray, from a to b along the wall",
    source="Yang and Wang (2011), on solving mirror reflection in lidar sensing",
    varies="the mirrored geometry behind a part of one wall, with long readings",
    rivals={"glass": "look at it from two sides: a mirror shows the mirrored room"},
    parameters=ends_of_part("the mirror"),
    transform=transform,
    place="wall",
    diagnostics=Diagnostics(
        unobservable=unobservable,
        propose=propose,
        leftovers=LOSS_LEFTOVERS,
        misfit_share=0.012,
    ),
)
