"""Mixed pixels of a beam of finite width."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import UNEXPECTED
from sensorgraph.effects.interfaces import Exposure, Residuals
from sensorgraph.effects.proposals import PROPOSAL
from sensorgraph.effects.set_up import depth_edge_error
from sensorgraph.types import Bools, Floats
from sensorgraph.world.ray_intersection import nearest_from_each
from sensorgraph.world.ray_order import neighbouring_rays
from sensorgraph.world.scene import Scene

N_SPREAD = 33
"""Number of rays that sample one beam at an edge."""
GRAZING = 1.5  # [rad] limit of the incidence in the estimate of a flat wall
STEP = 0.02  # [m] depth step below which the wall is bent, without an edge

GAMMAS = np.radians([0.12, 0.2, 0.35, 0.6, 1.0, 1.6])
"""[rad] Half angles that are tested."""
SIGMAS = 5.0
"""Minimum distance [sigma] of a reading from both sides of a depth step, and from the expected reading."""
DEPTH = 0.2
"""[m] Minimum depth step."""

EDGE = 0.1
"""[m] Difference between the ranges of neighbouring rays at a depth edge."""


def transform(scene: Scene, a: Amendment) -> None:
    """Average the readings of rays over the beam where there is a depth step between its sides and its centre."""
    gamma = a["gamma"]
    if gamma == 0.0:
        return
    beams = scene.beams
    both = np.stack([beams.ranges, scene.shoot(-gamma).ranges, scene.shoot(gamma).ranges])
    seen = np.isfinite(both)
    step = np.where(seen.all(axis=0), np.ptp(np.where(seen, both, 0.0), axis=0), 0.0)
    alpha = np.minimum(beams.incidence, GRAZING - gamma)
    flat = beams.ranges * np.cos(alpha) * (1 / np.cos(alpha + gamma) - 1 / np.cos(alpha - gamma))
    edge = step > flat + STEP
    if not edge.any():
        return
    ranges = _spread(scene, edge, gamma)
    mean = np.where(np.isfinite(ranges).all(axis=1), ranges.mean(axis=1), beams.ranges[edge])
    beams.bent()[edge] = False
    beams.reading = beams.reading.copy()
    beams.reading[edge] += mean - beams.ranges[edge]


def _spread(scene: Scene, edge: Bools, gamma: float) -> Floats:
    """Return the ranges (k, N_SPREAD) [m] of rays spread evenly over each beam of `edge`."""
    beams = scene.beams
    ox, oy = (np.broadcast_to(o, edge.shape)[edge] for o in (beams.ox, beams.oy))
    ux, uy = beams.ux[edge], beams.uy[edge]
    turn = gamma * (2 * (np.arange(N_SPREAD) + 0.5) / N_SPREAD - 1)
    c, s = np.cos(turn), np.sin(turn)
    vx, vy = ux[:, None] * c - uy[:, None] * s, uy[:, None] * c + ux[:, None] * s
    return nearest_from_each(scene.walls, ox[:, None], oy[:, None], vx, vy)[0]


def sweep(residuals: Residuals) -> list[list[Mapping[str, float]]]:
    """Return half angles if enough readings at depth steps are between the ranges of the two sides."""
    known = any(a.name == "mixed_pixels" for a in residuals.model)
    if known or _between(residuals) < PROPOSAL.min_rays:
        return []
    return [[{"gamma": float(gamma)} for gamma in GAMMAS]]


def _between(residuals: Residuals) -> int:
    """Count readings at depth steps that are between the ranges of the two sides."""
    r_max, z = residuals.sensor.range_max, residuals.z
    mu = np.where(residuals.aimed, np.minimum(residuals.mu, r_max), r_max)
    low, high = mu.copy(), mu.copy()
    right, left = neighbouring_rays(residuals.sensor)
    for a, b in ((left, right), (right, left)):
        low[:, a] = np.minimum(low[:, a], mu[:, b])
        high[:, a] = np.maximum(high[:, a], mu[:, b])
    margin = SIGMAS * residuals.sigma
    with np.errstate(invalid="ignore"):
        inside = residuals.returned & (z > low + margin) & (z < high - margin) & (high - low > DEPTH)
        return int((inside & (np.abs(z - residuals.mu) > margin)).sum())


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the depth edges between neighbouring rays."""
    gamma = typical["gamma"]
    bearings = exposure.sensor.bearings
    gap = float(np.median(np.abs(np.diff(bearings)))) if len(bearings) > 1 else np.inf
    right, left = neighbouring_rays(exposure.sensor)
    step = np.abs(exposure.range[:, left] - exposure.range[:, right]) > EDGE
    edges = step & exposure.seen[:, left] & exposure.seen[:, right]
    n = float(edges.sum()) * min(1.0, 2 * gamma / gap)
    if UNEXPECTED * n >= need:
        return ""
    return f"only {int(edges.sum())} pairs of neighbouring rays have a depth edge between them"


MIXED_PIXELS = Effect(
    name="mixed_pixels",
    title="mixed pixels",
    channel="scan",
    stage="optics",
    physics="A beam of half angle gamma returns the mean range over the lit area, so that readings at edges are between near and far.",
    equation="z = mean of r over θ ± γ",
    source="Tuley, Vandapel and Hebert (2005), analysis and removal of artifacts in 3-D ladar data",
    varies="the angle to depth edges, within gamma",
    rivals={
        "moved_obstacle": "pass an edge with a large depth step slowly",
        "mount_yaw": "mixed pixels do not change walls without edges",
    },
    parameters=(
        Parameter(
            name="gamma",
            unit="rad",
            doc="half angle of the beam",
            materiality=0.0020944,
            low=0.0,
            search_step=0.003,
            hidden=depth_edge_error,
        ),
    ),
    transform=transform,
    absorber=True,
    diagnostics=Diagnostics(
        at_edges=True,
        unobservable=unobservable,
        sweep=sweep,
        leftover_share=0.03,
        leftovers=dict.fromkeys(("people", "random_outliers", "range_noise", "glass", "black_surface"), 0.15),
        misfit_share=0.06,
    ),
)
