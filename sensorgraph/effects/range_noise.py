"""Range-dependent noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import falls_short
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import PROPOSAL, best_first
from sensorgraph.types import Floats
from sensorgraph.world.scene import Scene

GROWTHS = (0.0015, 0.003, 0.005, 0.008, 0.012, 0.02, 0.03)
"""[m/m] Values of k that are tested."""
CORES = (0.75, 0.85, 1.0, 1.15)
"""Scales of the nominal noise that are tested with each k."""
MIN_READINGS = 100
"""Minimum number of readings for an estimate of the spread."""


def transform(scene: Scene, a: Amendment) -> None:
    """Increase the standard deviation of each return by k r."""
    beams = scene.beams
    r = np.where(np.isfinite(beams.reading), beams.reading, 0.0)
    beams.sigma = np.sqrt(np.square(beams.sigma) + (a["k"] * r) ** 2)


def propose(residuals: Residuals) -> list[Proposal]:
    """Test values of the growth, with the scale of the nominal noise refitted."""
    ok = residuals.returned & residuals.aimed & (residuals.stray < 0.5)
    if ok.sum() <= MIN_READINGS:
        return []
    e, r, sigma = residuals.residual[ok], residuals.mu[ok], residuals.nominal_sigma[ok]
    gains = []
    for k in (0.0, *GROWTHS):
        spreads = [np.sqrt((core * sigma) ** 2 + (k * r) ** 2) for core in CORES]
        gains.append(max(_log_likelihood(e, s, residuals.tail) for s in spreads))
    found = [
        Proposal(values={"k": k}, gain=gain - gains[0]) for k, gain in zip(GROWTHS, gains[1:], strict=True)
    ]
    return best_first([p for p in found if p.gain > PROPOSAL.min_gain])[:1]


def _log_likelihood(e: Floats, s: Floats, tail: float) -> float:
    """Return the log-likelihood [nats] of residuals for a distribution with core and tail, without constants."""
    q = (e / s) ** 2
    return float(np.log(((1 - tail) * np.exp(-0.5 * q) + tail / 3 * np.exp(-0.5 * q / 9)) / s + 1e-3).sum())


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Compare the growth of the noise with the uncertainty of its nominal size."""
    k, sigma = typical["k"], exposure.sensor.sigma
    if sigma <= 0 or not exposure.n_seen:
        return ""
    ratio = 1 + (k * exposure.reading[exposure.seen] / sigma) ** 2
    scale = np.linspace(*exposure.core, 9)[:, None] ** 2
    counts, edges = np.histogram(ratio, bins=40)
    middle = (edges[1:] + edges[:-1]) / 2 / scale  # (9, 40)
    nats = float((0.5 * (middle - 1 - np.log(middle)) * counts).sum(axis=1).min())
    longest = float(np.percentile(exposure.reading[exposure.seen], 95))
    return "" if nats >= need else f"few ranges exceed {longest:.1f} m; {falls_short(nats, need)}"


RANGE_NOISE = Effect(
    name="range_noise",
    title="range-dependent noise",
    channel="scan",
    stage="noise",
    physics="The noise increases with the range: sigma^2 = sigma_0^2 + (k r)^2.",
    equation="σ² = σ₀² + (k r)²",
    source="Reina and Gonzales (1997), characterisation of a radial laser scanner",
    varies="range, in its variance",
    rivals={
        "random_outliers": "outliers have large errors and are rare at all ranges",
        "pose_clock_offset": "stand still in front of a far wall at normal incidence",
    },
    parameters=(
        Parameter(
            name="k", unit="m/m", doc="growth of the noise", materiality=0.0025, low=0.0, search_step=0.002
        ),
    ),
    transform=transform,
    absorber=True,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, site_start={"k": 0.004}),
)
