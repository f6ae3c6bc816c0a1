"""Obstacle that is no longer there."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Effect
from sensorgraph.effects.places import walls_of
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Shrink the obstacle to nothing, far away."""
    scene.walls[walls_of(scene, a.place)] = 1e9


MISSING_OBSTACLE = Effect(
    name="missing_obstacle",
    title="obstacle that is no longer there",
    channel="scan",
    stage="geometry",
    physics="One obstacle of the map is not in the room.",
    equation="map → map without it",
    source="Biber and Duckett (2005), dynamic maps for long-term operation of mobile service robots",
    varies="long readings through one obstacle",
    rivals={"glass": "look at it head-on", "moved_obstacle": "it stands nowhere else"},
    parameters=(),
    transform=transform,
    place="obstacle",
)
