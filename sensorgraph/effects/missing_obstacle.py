"""Missing obstacle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect
from sensorgraph.effects.exposures import UNEXPECTED, listed
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.places import named_walls, obstacles, seen_without, walls_of
from sensorgraph.effects.proposals import PROPOSAL, strangest_obstacles
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Move the walls of the obstacle out of the arena."""
    scene.walls[walls_of(scene, a.place)] = 1e9


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for rays that measure the surface behind an obstacle of the map."""
    found = []
    for name in strangest_obstacles(residuals, residuals.long | residuals.lost):
        members = named_walls(residuals.arena, name)
        mine = np.isin(residuals.beams.wall, members)
        if mine.sum() < PROPOSAL.min_rays:
            continue
        behind = seen_without(residuals.walls, members, residuals.beams, mine)
        gain = float((residuals.likely(behind, mine) - residuals.log_p[mine]).sum())
        centre = residuals.walls[members].reshape(-1, 2).mean(axis=0)
        found.append(Proposal(values={}, gain=gain, place=name, xy=centre))
    return found


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return the obstacles with too few rays."""
    blind = []
    for name in obstacles(exposure.arena):
        walls = named_walls(exposure.arena, name)
        if UNEXPECTED * (np.isin(exposure.wall, walls) & exposure.seen).sum() < need:
            blind.append(name)
    return f"{listed(blind)}: too few rays hit it" if blind else ""


MISSING_OBSTACLE = Effect(
    name="missing_obstacle",
    title="missing obstacle",
    channel="scan",
    stage="geometry",
    physics="One obstacle of the map is not in the room.",
    equation="map → map without the obstacle",
    source="Biber and Duckett (2005), dynamic maps for long-term operation of mobile service robots",
    varies="the place of one obstacle, with long readings",
    rivals={
        "glass": "look at it at normal incidence",
        "moved_obstacle": "a moved obstacle is visible elsewhere",
    },
    parameters=(),
    transform=transform,
    place="obstacle",
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose),
)
