"""Scale of the map."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import spread_of_ranges
from sensorgraph.effects.interfaces import CornerShift
from sensorgraph.types import Floats, Ints
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Stretch the walls about the centre of the arena, and shift them."""
    x0, y0, x1, y1 = scene.arena.bounds
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    shift = [a.parameters.get("dx", 0.0), a.parameters.get("dy", 0.0)]
    scene.walls = scene.walls + a["s"] * (scene.walls - middle) + shift


def corner_shifts(arena: Arena, walls: Floats, ends: Ints) -> list[CornerShift]:
    """Return the shift of all corners by a stretch about the centre of the arena, and by shifts along x and y."""
    x0, y0, x1, y1 = arena.bounds
    shift = np.zeros((int(ends.max()) + 1, 2, 3))
    shift[ends, :, 0] = arena.walls - [(x0 + x1) / 2, (y0 + y1) / 2]
    shift[:, 0, 1] = shift[:, 1, 2] = 1.0
    return [CornerShift(shift=shift)]


MAP_SCALE = Effect(
    name="map_scale",
    title="map scale",
    channel="scan",
    stage="geometry",
    physics="The room is (1 + s) times the map, about the centre of its bounding box, and shifted by (dx, dy).",
    equation="map → (1 + s) map, about the centre of the arena's bounding box",
    source="surveying practice: a plan measured with a wrong scale",
    varies="the distance of a wall from the centre of the map, not the range",
    rivals={
        "range_scale": "look at the same wall from near and from far",
        "moved_wall": "a moved wall affects only one wall",
    },
    parameters=(
        Parameter(name="s", unit="", doc="relative stretch", materiality=0.002, step=1e-5, jump=300.0),
        Parameter(name="dx", unit="m", doc="shift of the centre along x", neutral=0.0, step=1e-4),
        Parameter(name="dy", unit="m", doc="shift of the centre along y", neutral=0.0, step=1e-4),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=spread_of_ranges, corner_shifts=corner_shifts),
)
