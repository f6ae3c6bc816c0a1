"""Bias of a sector."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import listed
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.places import in_sector
from sensorgraph.effects.proposals import best_first, half_spacing
from sensorgraph.effects.set_up import between_rays
from sensorgraph.types import Floats
from sensorgraph.world.ray_order import is_full_turn
from sensorgraph.world.scene import Scene

MAX_SHARE = 0.8
"""Maximum share of the rays in a sector; a larger share is the whole sensor."""
BROAD = 6.0
"""Deviation [sigma] at which a reading has half the weight."""

N_SECTORS, SECTOR = 6, float(np.radians(30.0))
"""Number and width [rad] of the sectors in which a bias should be visible."""


def transform(scene: Scene, a: Amendment) -> None:
    """Add b to the rays of the sector."""
    scene.beams.reading = scene.beams.reading + a["b"] * in_sector(scene.bearings, a["theta1"], a["theta2"])


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for the sequence of neighbouring rays whose mean residual explains most."""
    bearings = residuals.sensor.bearings
    valid = residuals.valid & residuals.returned
    found = []
    for weight in (residuals.weight, _broad_weight(residuals)):
        w = np.where(valid, weight, 0.0)
        num, den = (w * residuals.residual).sum(axis=0), w.sum(axis=0)
        n = len(num)
        turns = 2 if is_full_turn(bearings) else 1  # a sector may include the last ray and the first
        cn, cd = (np.concatenate([[0.0], np.cumsum(np.tile(part, turns))]) for part in (num, den))
        i, j = np.triu_indices(turns * n + 1, 1)
        few = ((j - i) <= MAX_SHARE * n) & (i < n)
        i, j = i[few], j[few]
        s, d = cn[j] - cn[i], cd[j] - cd[i]
        score = 0.5 * s**2 / np.maximum(d, 1e-9) - 1.5 * np.log(n)
        at = int(score.argmax())
        half = half_spacing(residuals)
        values = {
            "theta1": float(bearings[i[at]] - half),
            "theta2": float(bearings[(j[at] - 1) % n] + half),
            "b": float(s[at] / max(d[at], 1e-9)),
        }
        found.append(Proposal(values=values, gain=float(score[at])))
    return best_first(found)[:1]


def _broad_weight(residuals: Residuals) -> Floats:
    """Return weights (n_scans, n_rays) [1/m²] that decrease slowly with the residual."""
    e, sigma = residuals.residual, residuals.sigma
    heavy = sigma**2 * (1 + (e / (BROAD * sigma)) ** 2) * BROAD
    return np.asarray(np.where(residuals.returned, 1 / heavy, 0.0))


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return the sectors with too little evidence, nuisances refitted."""
    bearings = exposure.sensor.bearings
    centres = bearings[0] + (np.arange(N_SECTORS) + 0.5) / N_SECTORS * (bearings[-1] - bearings[0])
    inside = np.array([in_sector(bearings, c - SECTOR / 2, c + SECTOR / 2) for c in centres])
    columns = np.where(exposure.valid[:, None] & inside[None], 1.0, 0.0)
    nats = exposure.nats_of_columns(columns, typical["b"])
    blind = [f"{np.degrees(c):.0f}" for c, value in zip(centres, nats, strict=True) if value < need]
    if not blind:
        return ""
    return f"there are too few returns or headings at the bearings {listed(blind)} degrees"


SECTOR_BIAS = Effect(
    name="sector_bias",
    title="bias of a sector",
    channel="scan",
    stage="range",
    physics="Returns in one sector of bearings have an offset: z = r + b for theta_1 <= theta <= theta_2.",
    equation="z = r + b for θ₁ ≤ θ ≤ θ₂",
    source="Pandey et al. (2011), per-beam calibration of multi-beam lidars",
    varies="bearing only",
    rivals={
        "mount_xy": "a mounting offset depends on the cosine of the bearing",
        "moved_wall": "spin in place, so that the wall leaves the sector",
    },
    parameters=(
        Parameter(
            name="theta1", unit="rad", doc="first bearing, laser frame", neutral=None, hidden=between_rays
        ),
        Parameter(
            name="theta2", unit="rad", doc="last bearing, laser frame", neutral=None, hidden=between_rays
        ),
        Parameter(name="b", unit="m", doc="offset inside the sector", materiality=0.006, step=1e-3),
    ),
    transform=transform,
    place="sector",
    diagnostics=Diagnostics(
        unobservable=unobservable,
        propose=propose,
    ),
)
