"""Moved wall."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from planners.types import SAME_PLACE
from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import CornerShift
from sensorgraph.effects.places import walls_of
from sensorgraph.types import Floats, Ints
from sensorgraph.world.scene import Scene
from sensorgraph.world.wall_sides import outward


def transform(scene: Scene, a: Amendment) -> None:
    """Shift a wall along its outward normal, together with the ends of its neighbours."""
    (index,) = walls_of(scene, a.place)
    shift = a["d"] * outward(scene.arena, np.array([index]))[0]
    for end in scene.walls[index].copy():
        scene.walls[(np.abs(scene.walls - end) < SAME_PLACE).all(axis=2)] += shift


def corner_shifts(arena: Arena, walls: Floats, ends: Ints) -> list[CornerShift]:
    """Return the shift of the two corners of each outer wall along its normal."""
    out, n_corners = [], int(ends.max()) + 1
    outline = arena.names[0].split("/")[0]
    outer = np.array([k for k, name in enumerate(arena.names) if name.split("/")[0] == outline])
    middles = arena.walls[outer].mean(axis=1)
    for index, normal, middle in zip(outer, outward(arena, outer), middles, strict=True):
        shift = np.zeros((n_corners, 2, 1))
        shift[ends[index], :, 0] = normal
        out.append(CornerShift(shift=shift, place=arena.names[index], xy=middle))
    return out


MOVED_WALL = Effect(
    name="moved_wall",
    title="moved wall",
    channel="scan",
    stage="geometry",
    physics="One wall is shifted by d along its outward normal from its position in the map; the ends of its neighbours move with its corners.",
    equation="wall → wall + d n, n its outward normal",
    source="surveying practice: one edge of the floor plan is wrong",
    varies="d / cos(incidence) on one wall",
    rivals={
        "range_bias": "look at the opposite wall",
        "map_scale": "a map scale moves all walls in proportion to their distance from the centre",
    },
    parameters=(
        Parameter(
            name="d",
            unit="m",
            doc="shift along the outward normal, away from free space",
            materiality=0.01,
            step=1e-4,
        ),
    ),
    transform=transform,
    place="wall",
    diagnostics=Diagnostics(
        corner_shifts=corner_shifts,
        tolerance="map",
    ),
)
