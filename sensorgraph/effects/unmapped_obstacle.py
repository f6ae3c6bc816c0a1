"""Obstacle that the map lacks."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.effects.set_up import half_map_error
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Put a disc into the room."""
    if a["r"] > 0:
        scene.discs = np.concatenate([scene.discs, [[a["x"], a["y"], a["r"]]]])


UNMAPPED_OBSTACLE = Effect(
    name="unmapped_obstacle",
    title="obstacle that the map lacks",
    channel="scan",
    stage="geometry",
    physics="Something round stands at (x, y) that the map does not have.",
    equation="a disc of radius r at (x, y)",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3: unexpected objects",
    varies="short readings that end at one place, at all times",
    rivals={"people": "come back later", "moved_obstacle": "a moved obstacle leaves a hole as well"},
    parameters=(
        Parameter(name="x", unit="m", doc="centre", neutral=None, step=1e-4, hidden=half_map_error),
        Parameter(name="y", unit="m", doc="centre", neutral=None, step=1e-4, hidden=half_map_error),
        Parameter(
            name="r", unit="m", doc="radius", materiality=0.02, low=0.0, step=1e-4, hidden=half_map_error
        ),
    ),
    transform=transform,
    place="spot",
)
