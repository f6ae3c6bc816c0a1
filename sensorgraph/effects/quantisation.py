"""Coarse quantisation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import count_of_returns
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.types import Floats
from sensorgraph.world.scene import Scene

FINEST = 1e-4
"""[m] Resolution of a reading if robot.yaml gives none."""
MIN_REPEATS = 3
"""Minimum number of occurrences of a value of the lattice."""
MIN_VALUES, MIN_READINGS = 5, 200
"""Minimum numbers of distinct values and of readings for a lattice."""
MIN_SHARE = 0.9
"""Minimum share of the readings with repeated values."""
MIN_STEPS = 1.7
"""Minimum ratio of the step of a lattice to the resolution of the sensor."""
ON_LATTICE = 0.95
"""Minimum share of the readings on the lattice."""


def transform(scene: Scene, a: Amendment) -> None:
    """Round to a lattice."""
    scene.lattice = max(scene.lattice, a["q"])


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for a few distinct values with a constant step."""
    z = residuals.z[residuals.returned]
    finest = max(residuals.sensor.resolution, FINEST)
    cells, counts = np.unique(np.round(z / FINEST).astype(np.int64), return_counts=True)
    often = counts >= MIN_REPEATS
    values = cells[often] * np.float64(FINEST)
    if len(values) < MIN_VALUES or len(z) < MIN_READINGS or counts[often].sum() < MIN_SHARE * len(z):
        return []
    q = float(np.median(np.diff(values)))
    if q < MIN_STEPS * finest:
        return []
    q = _refined(q, values)
    on = np.abs(z - np.round(z / q) * q) <= 0.5 * finest + 1e-6
    if on.mean() < ON_LATTICE:
        return []
    return [Proposal(values={"q": q}, gain=len(z) * max(np.log(q / finest), 0.1) * 0.5)]


def _refined(q: float, values: Floats) -> float:
    """Refine the step of a lattice on distinct values (n,) [m], short ranges first, so that steps are counted correctly."""
    grid = q * (1 + np.linspace(-0.08, 0.08, 641))
    few = values[values < max(0.05 / 0.08 * q * 8, values[0] + 12 * q)]
    for _ in range(6):
        turn = np.exp(2j * np.pi * few[None] / grid[:, None]).mean(axis=1).real
        q = float(grid[int(turn.argmax())])
        width = 0.2 * q / max(few[-1], q)
        grid = q * (1 + np.linspace(-width, width, 201))
        if len(few) == len(values):
            break
        few = values[values < 2.5 * few[-1]]
    return q


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Compare the lattice with the resolution of the log."""
    q, resolution = typical["q"], exposure.sensor.resolution
    if resolution >= q:
        return f"the readings in the log have steps of {1000 * resolution:.0f} mm"
    if exposure.n_seen * np.log(q / max(resolution, FINEST)) >= need:
        return ""
    return count_of_returns(exposure)


QUANTISATION = Effect(
    name="quantisation",
    title="coarse quantisation",
    channel="scan",
    stage="noise",
    physics="Returns are rounded to multiples of q, coarser than specified in the data sheet.",
    equation="z = q round(r / q)",
    source="Widrow and Kollar (2008), quantization noise",
    varies="the lattice of the readings, not the geometry",
    rivals={"range_noise": "plot a histogram of the readings at standstill"},
    parameters=(Parameter(name="q", unit="m", doc="step of the lattice", low=0.0, typical=0.01),),
    transform=transform,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, is_lattice=True, is_forecast=False),
)
