"""Skew of a rolling scan."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import speeds
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Take later rays later."""
    scene.delay = scene.delay + a["T"] * scene.sensor.sweep_share


SCAN_SKEW = Effect(
    name="scan_skew",
    title="skew of a rolling scan",
    channel="scan",
    stage="time",
    physics="Ray i of N, in the order of the sweep, is taken T i / N after the stamp, beyond what robot.yaml says.",
    equation="zᵢ(t) = rᵢ(pose(t + T i / N))",
    source="Zhang and Singh (2014), LOAM, section V",
    varies="turn rate times ray index; nothing at the first ray",
    rivals={"latency": "compare the first rays with the last at one turn rate"},
    parameters=(
        Parameter(
            name="T",
            unit="s",
            doc="of a sweep of N rays",
            materiality=0.01,
            step=1e-4,
            jump=300.0,
            nuisance=Nuisance.SKEW,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=speeds),
)
