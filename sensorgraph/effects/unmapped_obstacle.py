"""Unmapped obstacle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from logs.sensor import median_step
from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import PROPOSAL
from sensorgraph.effects.set_up import half_map_error
from sensorgraph.types import Floats
from sensorgraph.world.scene import Scene

CELL, MAX_CELLS = 0.25, 1500
"""[m] Cell size of the raster of free space, and its approximate maximum number of cells."""
MAX_PLACES = 12
"""Maximum number of places with most ends of short readings that are examined; clutter may have several."""
REACHES = 0.6, 0.25
"""[m] Distances from such a place within which ends may belong to one object; other objects may be near."""
MAX_RADIUS = 0.8
"""[m] Radius above which a round object is not distinguished from a wall."""
N_SCANS = 60
"""Number of scans for the visibility of the raster."""
MAX_BLIND = 0.03
"""Share of unobserved free space that is not reported."""


def transform(scene: Scene, a: Amendment) -> None:
    """Add a disc to the room."""
    if a["r"] > 0:
        scene.discs = np.concatenate([scene.discs, [[a["x"], a["y"], a["r"]]]])


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for places where short readings end repeatedly."""
    if residuals.short.sum() < PROPOSAL.min_rays:
        return []
    ends = residuals.ends(residuals.short)
    cell = np.floor(ends / 0.2).astype(np.intp)
    _, index, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    found = []
    for k in np.argsort(-counts)[:MAX_PLACES]:
        if counts[k] < PROPOSAL.min_rays:
            break
        middle = np.median(ends[index == k], axis=0)
        for reach in REACHES:
            found += _discs_near(residuals, ends, middle, reach)
    return sorted(found, key=lambda one: -one.gain)[: PROPOSAL.max_obstacles]


def _discs_near(residuals: Residuals, ends: Floats, middle: Floats, reach: float) -> list[Proposal]:
    """Propose a disc fitted to the short readings within `reach` [m] of a place, and a small disc at the place.

    Parameters
    ----------
    ends : (n, 2) [m, map] End points of all short readings.
    """
    scan, ray = np.nonzero(residuals.short)
    near = np.hypot(*(ends - middle).T) < reach
    if len(np.unique(scan[near])) < 4:
        return []
    directions = np.stack(
        [axis[scan[near], ray[near]] for axis in (residuals.beams.ux, residuals.beams.uy)], axis=1
    )
    fitted = _circle(ends[near], directions)
    far = np.hypot(*(ends[near] - middle).T)
    small = float(np.clip(np.quantile(far, 0.5), 0.01, 0.3))
    compact = (middle + 0.5 * small * directions.mean(axis=0), small, 0.0)
    there = [a.parameters for a in residuals.model if a.name == "unmapped_obstacle"]
    found = []
    for centre, radius, spread in (fitted, compact):
        if any(np.hypot(a["x"] - centre[0], a["y"] - centre[1]) < a["r"] + radius + 0.1 for a in there):
            continue
        if spread < 0.08 and (spread or small < 0.15):
            gain = 8.0 * float((far < radius + 0.1).sum()) * max(0.1, 1 - spread / 0.1)
            gain -= 8.0 * _n_through(residuals, centre, radius)
            values = {"x": float(centre[0]), "y": float(centre[1]), "r": float(radius)}
            found.append(Proposal(values=values, gain=gain, xy=centre))
    return found


def _n_through(residuals: Residuals, centre: Floats, radius: float) -> int:
    """Count the rays that pass through the inner part of a disc."""
    ahead, aside = residuals.beams.towards(centre[0], centre[1])
    aimed = (ahead > radius) & (np.abs(aside) < 0.7 * radius)
    with np.errstate(invalid="ignore"):
        return int((aimed & (residuals.z > ahead + radius + 0.1)).sum())


def _circle(points: Floats, directions: Floats) -> tuple[Floats, float, float]:
    """Fit a circle to points on its near side; return its centre (2,), radius and median residual [m]."""
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
            centre, radius = centre + step[:2], float(np.clip(radius + step[2], 0.01, MAX_RADIUS))
        spread = float(np.median(np.abs(np.hypot(*(points - centre).T) - radius)))
        if best is None or spread < best[0] - 1e-4:
            best = (spread, centre, radius)
    assert best is not None
    return best[1], best[2], best[0]


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return a text on the part of free space that was not observed."""
    arena, beams = exposure.arena, exposure.beams
    x0, y0, x1, y1 = arena.bounds
    step = max(CELL, float(np.sqrt((x1 - x0) * (y1 - y0) / MAX_CELLS)))
    x, y = np.meshgrid(np.arange(x0 + step / 2, x1, step), np.arange(y0 + step / 2, y1, step))
    spots = np.stack([x.ravel(), y.ravel()], axis=1)
    spots = spots[arena.contains(spots)]
    if not len(spots):
        return ""
    some = np.unique(np.linspace(0, len(exposure.reading) - 1, N_SCANS).astype(np.intp))
    ox, oy = (np.broadcast_to(o, beams.ux.shape)[some, 0] for o in (beams.ox, beams.oy))
    dx, dy = spots[:, 0] - ox[:, None], spots[:, 1] - oy[:, None]  # (n_scans, n_spots)
    bearings = exposure.sensor.bearings
    first = np.arctan2(beams.uy[some, 0], beams.ux[some, 0])[:, None]
    turn = (np.arctan2(dy, dx) - first) % (2 * np.pi)
    width = median_step(bearings, 1.0)
    ray = np.round(turn / width).astype(np.intp) if width > 0 else np.full(turn.shape, len(bearings))
    inside = ray < len(bearings)
    far = np.take_along_axis(exposure.reading[some], np.where(inside, ray, 0), axis=1)
    looks = (inside & (np.hypot(dx, dy) < far)).sum(axis=0)
    blind = looks < 2
    if blind.mean() < MAX_BLIND:
        return ""
    middle = spots[blind][np.hypot(*(spots[blind] - spots[blind].mean(axis=0)).T).argmin()]
    return (
        f"{100 * blind.mean():.0f} % of the free space was not observed, for example around "
        f"({middle[0]:.1f}, {middle[1]:.1f}) m"
    )


UNMAPPED_OBSTACLE = Effect(
    name="unmapped_obstacle",
    title="unmapped obstacle",
    channel="scan",
    stage="geometry",
    physics="A round object at (x, y) is not in the map.",
    equation="a disc of radius r at (x, y)",
    source="Thrun, Burgard and Fox (2005), Probabilistic Robotics, section 6.3: unexpected objects",
    varies="the place of the object, with short readings at all times",
    rivals={
        "people": "look at the place again later",
        "moved_obstacle": "a moved obstacle is missing at its place in the map",
    },
    parameters=(
        Parameter(name="x", unit="m", doc="x of the centre", neutral=None, step=1e-4, hidden=half_map_error),
        Parameter(name="y", unit="m", doc="y of the centre", neutral=None, step=1e-4, hidden=half_map_error),
        Parameter(
            name="r",
            unit="m",
            doc="radius",
            materiality=0.02,
            low=0.0,
            high=MAX_RADIUS,
            step=1e-4,
            hidden=half_map_error,
        ),
    ),
    transform=transform,
    place="spot",
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose),
)
