"""Robot part in view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import UNEXPECTED
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.places import in_sector
from sensorgraph.effects.proposals import LOSS_LEFTOVERS, half_spacing
from sensorgraph.effects.set_up import between_rays, range_bias
from sensorgraph.types import Bools, Ints
from sensorgraph.world.ray_order import is_full_turn
from sensorgraph.world.scene import Scene

MIN_SHORT = 0.3
"""Minimum share of scans in which a ray is short."""

QUANTILES = 0.0, 0.25, 0.5, 0.75, 1.0
"""Quantiles of the medians of the rays that are tested as the range of the robot part."""
CLEAR = 0.05
"""[m] Distance behind the robot part beyond which a return is from another surface."""


def transform(scene: Scene, a: Amendment) -> None:
    """Let the rays of the sector end at the robot part."""
    beams = scene.beams
    sector = np.broadcast_to(in_sector(scene.bearings, a["theta1"], a["theta2"]), beams.reading.shape)
    hidden = sector & (beams.reading > a["r0"])
    beams.reading = np.where(hidden, a["r0"], beams.reading)
    beams.p_return = np.where(hidden, 1.0, beams.p_return)
    beams.bent()[hidden] = False


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for neighbouring rays with the same reading at all poses."""
    z, short = residuals.z, residuals.short
    odd = short.sum(axis=0) > MIN_SHORT * len(z)
    if not odd.any():
        return []
    found = []
    bearings = residuals.sensor.bearings
    first_ray = int(odd.argmin()) if is_full_turn(bearings) else 0  # no sector contains it
    rays = (np.arange(len(odd)) + first_ray) % len(odd)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], odd[rays].astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        sector = rays[first : last + 1]
        some = np.zeros(z.shape, dtype=np.bool_)
        some[:, sector] = True
        each = [np.median(z[:, ray][short[:, ray]]) for ray in sector]
        tried = {np.median(z[:, sector][short[:, sector]]), *np.quantile(each, QUANTILES, method="nearest")}
        best = max(
            (_likeliest_run(residuals, some, sector, float(r0)) for r0 in tried),
            key=lambda p: p.gain,
        )
        found.append(best)
    return found


def _likeliest_run(residuals: Residuals, some: Bools, sector: Ints, r0: float) -> Proposal:
    """Return the neighbouring rays of a sector (`some` in all scans) with the largest likelihood of reading r0 [m].

    Rays next to them may be short because of clutter.
    """
    at = np.where(residuals.aimed, residuals.mu, np.inf)[some]
    gains = np.zeros(some.shape)
    gains[some] = residuals.likely(np.minimum(at, r0), some) - residuals.log_p[some]
    sums = np.concatenate([[0.0], np.cumsum(gains[:, sector].sum(axis=0))])
    over = np.subtract.outer(sums, sums)  # from the second index to before the first
    over[np.triu_indices(len(sums))] = -np.inf
    end, begin = np.unravel_index(over.argmax(), over.shape)
    bearings, half = residuals.sensor.bearings[sector], half_spacing(residuals)
    ends = {"theta1": float(bearings[begin] - half), "theta2": float(bearings[end - 1] + half)}
    return Proposal(values={"r0": r0, **ends}, gain=float(over[end, begin]))


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the rays with too few returns from behind the robot part."""
    r0, sensor = typical["r0"], exposure.sensor
    beyond = exposure.seen & (exposure.reading > r0 + CLEAR)
    few = UNEXPECTED * beyond.sum(axis=0) < need
    if not few.any():
        return ""
    return f"{int(few.sum())} of {sensor.n_rays} rays have too few returns from beyond {r0:.2f} m"


SELF_OCCLUSION = Effect(
    name="self_occlusion",
    title="robot part in view",
    channel="scan",
    stage="detection",
    physics="A part of the robot at range r0 hides the sector from theta_1 to theta_2.",
    equation="z = r₀ for θ₁ ≤ θ ≤ θ₂",
    source="Dolgov et al.; common practice of laser filters (ROS laser_filters, angular bounds)",
    varies="bearing, at all poses",
    rivals={"min_range": "turn in free space"},
    parameters=(
        Parameter(
            name="r0",
            unit="m",
            doc="range of the robot part",
            neutral=None,
            low=0.0,
            step=1e-4,
            typical=0.25,
            hidden=range_bias,
        ),
        Parameter(
            name="theta1", unit="rad", doc="first bearing, laser frame", neutral=None, hidden=between_rays
        ),
        Parameter(
            name="theta2", unit="rad", doc="last bearing, laser frame", neutral=None, hidden=between_rays
        ),
    ),
    transform=transform,
    place="sector",
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, leftovers=LOSS_LEFTOVERS),
)
