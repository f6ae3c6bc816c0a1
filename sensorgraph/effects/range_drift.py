"""Range drift."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene

MIN_SPAN = 30.0
"""[s] Minimum duration of a run for a drift."""


def transform(scene: Scene, a: Amendment) -> None:
    """Add a bias that grows with time."""
    tau = a.parameters.get("tau", 0.0)
    t = scene.stamps - scene.begin
    share = 1 - np.exp(-t / tau) if tau > 0 else t / max(scene.span, 1e-9)
    scene.beams.reading = scene.beams.reading + a["b1"] * share[:, None]


def warm_up(span: float) -> dict[str, float]:
    """Return start values of a warm-up that ends early in a run of duration `span` [s]."""
    return {"tau": 0.2 * span}


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return a text if the run is too short."""
    return f"the run lasts {exposure.span:.0f} s, too short for a drift" if exposure.span < MIN_SPAN else ""


def duration(exposure: Exposure) -> str:
    """Return a text on the duration of the run."""
    return f"the run lasts only {exposure.span:.0f} s"


RANGE_DRIFT = Effect(
    name="range_drift",
    title="range drift",
    channel="scan",
    stage="range",
    physics="The bias grows during the run: b(t) = b1 t / T, or b1 (1 - exp(-t / tau)) while the sensor warms up. Time t starts at the first scan, and T is the time of the last scan.",
    equation="z = r + b₁ t / T, or b₁ (1 − exp(−t / τ)) where τ > 0",
    source="Reina and Gonzales (1997), characterisation of a radial laser scanner: warm-up",
    varies="time",
    rivals={
        "moved_wall": "return to the first pose at the end",
        "range_bias": "return to the first pose at the end",
    },
    parameters=(
        Parameter(
            name="b1",
            unit="m",
            doc="bias at the end (linear) or after warm-up",
            materiality=0.006,
            step=1e-3,
            nuisance=Nuisance.DRIFT,
        ),
        Parameter(
            name="tau",
            unit="s",
            doc="time constant of the warm-up; 0: linear",
            neutral=0.0,
            low=0.0,
            search_step=3.0,
            absent_at_zero=True,
            refit=True,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(
        unobservable=unobservable, why_unseen=duration, second_start=warm_up, hidden_by_slam=True
    ),
)
