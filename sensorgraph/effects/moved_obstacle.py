"""Moved obstacle."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import CornerShift, Proposal, Residuals
from sensorgraph.effects.places import named_walls, obstacles, walls_of
from sensorgraph.effects.proposals import PROPOSAL, strangest_obstacles
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.ray_intersection import nearest_from_each, nearest_walls
from sensorgraph.world.scene import Scene

REACH = 0.6
"""[m] Maximum shift along each axis; beyond it, a missing and an unmapped obstacle are reported."""
NUDGE_DISTANCE = 0.12
"""[m] Distance from an outline within which a reading depends on a small shift."""
NUDGE_STEPS = (0.06, 0.03, 0.015, 0.008, 0.004, 0.002)
"""[m] Steps of the search for a small shift."""
DIRECTIONS = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y])
"""Directions of the search."""
MAX_SIDES = 4
"""Number of the longest sides whose directions are also searched."""


def transform(scene: Scene, a: Amendment) -> None:
    """Shift the walls of the obstacle."""
    scene.walls[walls_of(scene, a.place)] += [a["dx"], a["dy"]]


def corner_shifts(arena: Arena, walls: Floats, ends: Ints) -> list[CornerShift]:
    """Return the shift of the corners of each obstacle along x and y of the map."""
    out = []
    for name in obstacles(arena):
        members = named_walls(arena, name)
        shift = np.zeros((int(ends.max()) + 1, 2, 2))
        shift[np.unique(ends[members])] = np.eye(2)
        centre = walls[members].reshape(-1, 2).mean(axis=0)
        out.append(CornerShift(shift=shift, place=name, xy=centre))
    return out


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for a large or a small shift of an obstacle."""
    return [*_elsewhere(residuals), *nudged(residuals)]


def _elsewhere(residuals: Residuals) -> list[Proposal]:
    """Match the outline of each obstacle with the end points of outliers."""
    found = []
    ends = residuals.ends(residuals.strange) if residuals.strange.sum() else np.zeros((0, 2))
    for name in strangest_obstacles(residuals):
        members = named_walls(residuals.arena, name)
        mine = np.isin(residuals.beams.wall, members)
        if mine.sum() >= PROPOSAL.min_rays:
            found += _shifted(residuals, name, residuals.walls[members], ends, mine)
    return found


def _shifted(residuals: Residuals, name: str, outline: Floats, ends: Floats, mine: Bools) -> list[Proposal]:
    """Match the outline of one obstacle with the end points of outliers."""
    low, high = outline.min(axis=(0, 1)) - REACH - 0.1, outline.max(axis=(0, 1)) + REACH + 0.1
    near = ends[((ends > low) & (ends < high)).all(axis=1)]
    if len(near) < 2 * PROPOSAL.min_rays:
        return []
    near = near[:: max(1, len(near) // 150)]
    steps = np.arange(-REACH, REACH + 0.01, 0.04)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    shifted = (near[None] - grid[:, None]).reshape(-1, 2)
    best = _distance_to(outline, shifted).reshape(len(grid), len(near))
    score = np.exp(-0.5 * (best / 0.03) ** 2).sum(axis=1)
    at = int(score.argmax())
    share = score[at] / len(near)
    if share < 0.35:
        return []
    dx, dy = grid[at]
    centre = outline.reshape(-1, 2).mean(axis=0)
    unexplained = float(-(residuals.log_p[residuals.strange & mine]).sum())
    gain = 3.0 * score[at] * max(1, len(ends) // 150) + max(unexplained, 0.0)
    return [Proposal(values={"dx": float(dx), "dy": float(dy)}, gain=gain, place=name, xy=centre)]


def nudged(residuals: Residuals) -> list[Proposal]:
    """Search for a shift by a few centimetres, which changes the rays that the outline stops.

    To first order, a side changes only the readings that end on it. If no ray hit a side at normal incidence, only the
    rays at the ends of the silhouette carry information, so the readings of each shift are cast.
    """
    if residuals.strange.sum() < PROPOSAL.min_rays:
        return []
    ends, aimed_at = residuals.ends(residuals.strange), residuals.beams.wall[residuals.strange]
    found = []
    for name in strangest_obstacles(residuals):
        members = named_walls(residuals.arena, name)
        stopped = _distance_to(residuals.walls[members], ends) < NUDGE_DISTANCE
        aimed = np.isin(aimed_at, members)
        if (stopped | aimed).sum() >= PROPOSAL.min_rays:
            proposal = _nudge(residuals, name, members)
            if proposal is not None:
                found.append(proposal)
    return found


def _nudge(residuals: Residuals, name: str, members: Ints) -> Proposal | None:
    """Return the shift of an obstacle with the largest likelihood of the readings near it."""
    walls, beams = residuals.walls, residuals.beams
    shape = residuals.z.shape
    centre = walls[members].reshape(-1, 2).mean(axis=0)
    radius = float(np.hypot(*(walls[members].reshape(-1, 2) - centre).T).max()) + 1.5 * NUDGE_DISTANCE
    ox, oy = np.broadcast_to(beams.ox, shape), np.broadcast_to(beams.oy, shape)
    ahead, aside = beams.towards(centre[0], centre[1])
    some = (np.abs(aside) < radius) & (ahead > 0) & ~np.isnan(residuals.z)
    if not some.any():
        return None
    rays = ox[some], oy[some], beams.ux[some], beams.uy[some]
    behind = beams.ranges[some].copy()
    own = np.isin(beams.wall[some], members)
    behind[own] = nearest_from_each(np.delete(walls, members, axis=0), *(axis[own] for axis in rays))[0]
    with np.errstate(invalid="ignore"):  # a ray without a hit has no reading
        added = residuals.mu[some] - beams.ranges[some]
    usual = np.where(residuals.aimed[some] & np.isfinite(added), added, 0.0)

    def log_p(shift: Floats) -> float:
        there, _ = nearest_walls(walls[members] + shift, *rays)
        reading = np.minimum(there, behind) + usual
        return float(residuals.likely(reading, some).sum())

    # a shift along a side does not change the readings on that side, so the search includes its direction
    along = walls[members, 1] - walls[members, 0]
    size = np.hypot(*along.T)
    longest = np.argsort(-size)[:MAX_SIDES]
    along = along[longest] / np.maximum(size[longest], 1e-9)[:, None]
    directions = np.concatenate([DIRECTIONS, along, -along])
    best, at = (here := log_p(np.zeros(2))), np.zeros(2)
    for step in NUDGE_STEPS:
        middle = at
        for direction in directions:
            shift = middle + step * direction
            if (got := log_p(shift)) > best:
                best, at = got, shift
    if best - here < PROPOSAL.min_gain or not at.any():
        return None
    values = {"dx": float(at[0]), "dy": float(at[1])}
    return Proposal(values=values, gain=best - here, place=name, xy=centre)


def _distance_to(outline: Floats, points: Floats) -> Floats:
    """Return the distance (n,) [m] of points (n, 2) from an outline (k, 2, 2)."""
    least = np.full(len(points), np.inf)
    for (ax, ay), (bx, by) in outline:
        dx, dy = bx - ax, by - ay
        x, y = points[:, 0] - ax, points[:, 1] - ay
        share = np.clip((x * dx + y * dy) / max(dx * dx + dy * dy, 1e-12), 0.0, 1.0)
        np.minimum(least, (x - share * dx) ** 2 + (y - share * dy) ** 2, out=least)
    return np.asarray(np.sqrt(least))


MOVED_OBSTACLE = Effect(
    name="moved_obstacle",
    title="moved obstacle",
    channel="scan",
    stage="geometry",
    physics="One obstacle is shifted by (dx, dy) from its position in the map.",
    equation="obstacle → obstacle + (dx, dy)",
    source="Biber and Duckett (2005), dynamic maps for long-term operation of mobile service robots",
    varies="the sides of one obstacle, with opposite signs on opposite sides",
    rivals={
        "missing_obstacle": "a moved obstacle is visible elsewhere",
        "mount_yaw": "drive around the obstacle",
    },
    parameters=(
        Parameter(
            name="dx",
            unit="m",
            doc="shift along x of the map",
            materiality=0.01,
            low=-REACH,
            high=REACH,
            step=1e-4,
        ),
        Parameter(
            name="dy",
            unit="m",
            doc="shift along y of the map",
            materiality=0.01,
            low=-REACH,
            high=REACH,
            step=1e-4,
        ),
    ),
    transform=transform,
    place="obstacle",
    diagnostics=Diagnostics(propose=propose, corner_shifts=corner_shifts),
)
