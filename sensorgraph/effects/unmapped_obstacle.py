"""Obstacle that the map lacks."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Proposal, Residuals
from sensorgraph.effects.proposals import PROPOSAL
from sensorgraph.effects.set_up import half_map_error
from sensorgraph.types import Floats
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Put a disc into the room."""
    if a["r"] > 0:
        scene.discs = np.concatenate([scene.discs, [[a["x"], a["y"], a["r"]]]])


def propose(residuals: Residuals) -> list[Proposal]:
    """Look for short readings that end at one place, again and again."""
    if residuals.short.sum() < PROPOSAL.min_rays:
        return []
    ends = residuals.ends(residuals.short)
    scan = np.nonzero(residuals.short)[0]
    cell = np.floor(ends / 0.2).astype(np.intp)
    _, index, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    there = [a.parameters for a in residuals.model if a.name == "unmapped_obstacle"]
    found = []
    for k in np.argsort(-counts)[:3]:
        if counts[k] < PROPOSAL.min_rays:
            break
        middle = np.median(ends[index == k], axis=0)
        near = np.hypot(*(ends - middle).T) < 0.6
        if len(np.unique(scan[near])) < 4:
            continue
        directions = np.stack(
            [residuals.beams.ux[residuals.short][near], residuals.beams.uy[residuals.short][near]], axis=1
        )
        fitted = _circle(ends[near], directions)
        far = np.hypot(*(ends[near] - middle).T)
        small = float(np.clip(np.quantile(far, 0.5), 0.01, 0.3))
        compact = (middle + 0.5 * small * directions.mean(axis=0), small, 0.0)
        for centre, radius, spread in (fitted, compact):
            if any(np.hypot(a["x"] - centre[0], a["y"] - centre[1]) < a["r"] + radius + 0.1 for a in there):
                continue
            if spread < 0.08 and (spread or small < 0.15):
                gain = 8.0 * float((far < radius + 0.1).sum()) * max(0.1, 1 - spread / 0.1)
                values = {"x": float(centre[0]), "y": float(centre[1]), "r": float(radius)}
                found.append(Proposal(values=values, gain=gain, xy=centre))
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
    diagnostics=Diagnostics(propose=propose),
)
