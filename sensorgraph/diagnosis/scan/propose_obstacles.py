"""Propose obstacles that are gone, stand elsewhere, or are not on the map."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.residuals import FEW, LEAST_GAIN, View
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.places import named_walls, obstacles
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.ray_intersection import nearest
from sensorgraph.world.scene import each

NUDGE = 0.12
"""[m] from an outline within which a reading may tell of a small move; ..."""
NUDGES = (0.06, 0.03, 0.015, 0.008, 0.004, 0.002)
"""... steps [m] in which that is looked for, ..."""
AROUND = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y])
"""... in these directions."""


def missing_or_moved(view: View) -> list[Candidate]:
    """Look for an obstacle that is gone, or that stands elsewhere."""
    found = []
    present = {(a.name, a.place) for a in view.fitted.model}
    walls = view.fitted.cast.scene.walls
    odd_end = view.ends(view.strange) if view.strange.sum() else np.zeros((0, 2))
    for feature in obstacles(view.data.arena):
        if ("missing_obstacle", feature) in present or ("moved_obstacle", feature) in present:
            continue
        members = named_walls(view.data.arena, feature)
        mine = np.isin(view.beams.wall, members)
        if mine.sum() < FEW:
            continue
        bare = walls.copy()
        bare[members] = 1e9
        ox = np.broadcast_to(view.beams.ox, view.z.shape)[mine][:, None]
        oy = np.broadcast_to(view.beams.oy, view.z.shape)[mine][:, None]
        behind, _ = each(bare, ox, oy, view.beams.ux[mine][:, None], view.beams.uy[mine][:, None])
        gain = float((view.likely(behind[:, 0], mine) - view.log_p[mine]).sum())
        centre = walls[members].reshape(-1, 2).mean(axis=0)
        if gain > LEAST_GAIN:
            found.append(Candidate(amendment=EFFECTS["missing_obstacle"]().at(feature, centre), gain=gain))
        found += _shifted(view, feature, walls[members], odd_end, mine)
    return found


def _shifted(view: View, feature: str, outline: Floats, ends: Floats, mine: Bools) -> list[Candidate]:
    """Lay the outline of an obstacle over the ends of unexplained rays."""
    low, high = outline.min(axis=(0, 1)) - 0.7, outline.max(axis=(0, 1)) + 0.7
    near = ends[((ends > low) & (ends < high)).all(axis=1)]
    if len(near) < 2 * FEW:
        return []
    near = near[:: max(1, len(near) // 150)]
    steps = np.arange(-0.6, 0.61, 0.04)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    shifted = (near[None] - grid[:, None]).reshape(-1, 2)
    best = _beside(shifted, outline).reshape(len(grid), len(near))
    score = np.exp(-0.5 * (best / 0.03) ** 2).sum(axis=1)
    at = int(score.argmax())
    share = score[at] / len(near)
    if share < 0.35:
        return []
    dx, dy = grid[at]
    centre = outline.reshape(-1, 2).mean(axis=0)
    unexplained = float(-(view.log_p[view.strange & mine]).sum())
    gain = 3.0 * score[at] * max(1, len(ends) // 150) + max(unexplained, 0.0)
    return [
        Candidate(
            amendment=EFFECTS["moved_obstacle"](dx=float(dx), dy=float(dy)).at(feature, centre), gain=gain
        )
    ]


def unmapped(view: View) -> list[Candidate]:
    """unmapped_obstacle: short readings that end at one place, again and again."""
    if view.short.sum() < FEW:
        return []
    ends = view.ends(view.short)
    scan = np.nonzero(view.short)[0]
    cell = np.floor(ends / 0.2).astype(np.intp)
    _, index, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    there = [a for a in view.fitted.model if a.name == "unmapped_obstacle"]
    found = []
    for k in np.argsort(-counts)[:3]:
        if counts[k] < FEW:
            break
        middle = np.median(ends[index == k], axis=0)
        near = np.hypot(*(ends - middle).T) < 0.6
        if len(np.unique(scan[near])) < 4:
            continue
        directions = np.stack([view.beams.ux[view.short][near], view.beams.uy[view.short][near]], axis=1)
        fitted = _circle(ends[near], directions)
        far = np.hypot(*(ends[near] - middle).T)
        small = float(np.clip(np.quantile(far, 0.5), 0.01, 0.3))
        compact = (middle + 0.5 * small * directions.mean(axis=0), small, 0.0)
        for centre, radius, spread in (fitted, compact):
            if any(np.hypot(a["x"] - centre[0], a["y"] - centre[1]) < a["r"] + radius + 0.1 for a in there):
                continue
            if spread < 0.08 and (spread or small < 0.15):
                gain = 8.0 * float((far < radius + 0.1).sum()) * max(0.1, 1 - spread / 0.1)
                amendment = EFFECTS["unmapped_obstacle"](
                    x=float(centre[0]), y=float(centre[1]), r=float(radius)
                )
                found.append(Candidate(amendment=amendment.at("", centre), gain=gain))
    return found


def _circle(points: Floats, directions: Floats) -> tuple[Floats, float, float]:
    """Fit a circle to points on its near side; return centre (2,), radius, median distance from it [m]."""
    best: tuple[float, Floats, float] | None = None
    for start in (0.04, 0.1, 0.2, 0.35):
        centre, radius = np.median(points + start * directions, axis=0), start
        for _ in range(12):
            off = points - centre
            far = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-6)
            e = far - radius
            w = 1 / (1 + (e / 0.03) ** 2)
            rows = np.column_stack([-off / far[:, None], -np.ones(len(far))])
            a = rows.T @ (rows * w[:, None]) + np.diag([1e-3, 1e-3, 1e-3]) * len(far)
            step = np.linalg.solve(a, -rows.T @ (w * e))
            centre, radius = centre + step[:2], float(np.clip(radius + step[2], 0.01, 0.8))
        spread = float(np.median(np.abs(np.hypot(*(points - centre).T) - radius)))
        if best is None or spread < best[0] - 1e-4:
            best = (spread, centre, radius)
    assert best is not None
    return best[1], best[2], best[0]


def nudged(view: View) -> list[Candidate]:
    """moved_obstacle by a few centimetres: where its outline lets rays pass, or stops them, that the map does not.

    To first order a side changes only the readings that end on it; of one that no ray met head-on, only the ends of the
    silhouette tell, so the readings of each shift are cast.
    """
    if view.strange.sum() < FEW or view.data.floors.get("moved_obstacle") == np.inf:
        return []
    ends, walls = view.ends(view.strange), view.fitted.cast.scene.walls
    present = {(a.name, a.place) for a in view.fitted.model}
    found = []
    for feature in obstacles(view.data.arena):
        if ("missing_obstacle", feature) in present or ("moved_obstacle", feature) in present:
            continue
        members = named_walls(view.data.arena, feature)
        if (_beside(ends, walls[members]) < NUDGE).sum() >= FEW:
            candidate = _nudge(view, feature, members)
            if candidate is not None:
                found.append(candidate)
    return found


def _nudge(view: View, feature: str, members: Ints) -> Candidate | None:
    """Return the shift of an obstacle that makes the readings about it most likely."""
    walls, beams = view.fitted.cast.scene.walls, view.beams
    shape = view.z.shape
    centre = walls[members].reshape(-1, 2).mean(axis=0)
    radius = float(np.hypot(*(walls[members].reshape(-1, 2) - centre).T).max()) + 1.5 * NUDGE
    ox, oy = np.broadcast_to(beams.ox, shape), np.broadcast_to(beams.oy, shape)
    aside = (centre[0] - ox) * beams.uy - (centre[1] - oy) * beams.ux
    ahead = (centre[0] - ox) * beams.ux + (centre[1] - oy) * beams.uy
    some = (np.abs(aside) < radius) & (ahead > 0) & ~np.isnan(view.z)
    if not some.any():
        return None
    rays = ox[some], oy[some], beams.ux[some], beams.uy[some]
    bare = np.delete(walls, members, axis=0)
    behind, _ = nearest(bare, *rays)
    usual = np.where(view.aimed[some], view.mu[some] - beams.ranges[some], 0.0)  # what nuisances add

    def log_p(shift: Floats) -> float:
        there, _ = nearest(walls[members] + shift, *rays)
        reading = np.minimum(there, behind) + np.where(np.isfinite(usual), usual, 0.0)
        return float(view.likely(reading, some).sum())

    best, at = (here := log_p(np.zeros(2))), np.zeros(2)
    for step in NUDGES:
        middle = at
        for way in AROUND:
            shift = middle + step * way
            if (got := log_p(shift)) > best:
                best, at = got, shift
    if best - here < LEAST_GAIN or not at.any():
        return None
    amendment = EFFECTS["moved_obstacle"](dx=float(at[0]), dy=float(at[1])).at(feature, centre)
    return Candidate(amendment=amendment, gain=best - here)


def _beside(points: Floats, outline: Floats) -> Floats:
    """Return how far points (n, 2) are from an outline (k, 2, 2), (n,) [m]."""
    a, d = outline[:, 0], outline[:, 1] - outline[:, 0]
    off = points[:, None] - a
    share = np.clip((off * d).sum(axis=2) / np.maximum((d * d).sum(axis=1), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*np.moveaxis(off - share[..., None] * d, 2, 0)).min(axis=1))
