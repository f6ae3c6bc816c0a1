"""Moved obstacle."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import CornerShift
from sensorgraph.effects.places import named_walls, obstacles, walls_of
from sensorgraph.types import Floats, Ints
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Shift the walls of the obstacle."""
    scene.walls[walls_of(scene, a.place)] += [a["dx"], a["dy"]]


def corner_shifts(arena: Arena, walls: Floats, ends: Ints) -> list[CornerShift]:
    """Shift the corners of each obstacle along x and y of the map."""
    out = []
    for name in obstacles(arena):
        members = named_walls(arena, name)
        shift = np.zeros((int(ends.max()) + 1, 2, 2))
        shift[np.unique(ends[members])] = np.eye(2)
        centre = walls[members].reshape(-1, 2).mean(axis=0)
        out.append(CornerShift(shift=shift, place=name, xy=centre))
    return out


MOVED_OBSTACLE = Effect(
    name="moved_obstacle",
    title="moved obstacle",
    channel="scan",
    stage="geometry",
    physics="One obstacle stands (dx, dy) from where the map has it.",
    equation="obstacle → obstacle + (dx, dy)",
    source="Biber and Duckett (2005), dynamic maps for long-term operation of mobile service robots",
    varies="the walls of one obstacle, with opposite signs on opposite faces",
    rivals={"missing_obstacle": "it stands somewhere else", "mount_yaw": "circle it"},
    parameters=(
        Parameter(name="dx", unit="m", doc="along x of the map", materiality=0.01, step=1e-4),
        Parameter(name="dy", unit="m", doc="along y of the map", materiality=0.01, step=1e-4),
    ),
    transform=transform,
    place="obstacle",
    diagnostics=Diagnostics(corner_shifts=corner_shifts),
)
