"""Moved obstacle."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.effects.places import walls_of
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Shift the walls of the obstacle."""
    scene.walls[walls_of(scene, a.place)] += [a["dx"], a["dy"]]


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
)
