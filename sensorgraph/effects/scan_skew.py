"""Skew of a rolling scan."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import speeds
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Delay each ray by its share of the sweep."""
    scene.delay = scene.delay + a["T"] * scene.sensor.sweep_share


SCAN_SKEW = Effect(
    name="scan_skew",
    title="skew of a rolling scan",
    channel="scan",
    stage="time",
    physics="Ray i of N, in the order of the sweep, is taken T i / N after the stamp, in addition to the sweep time in robot.yaml.",
    equation="zᵢ(t) = rᵢ(pose(t + T i / N))",
    source="Zhang and Singh (2014), LOAM, section V",
    varies="turn rate times ray index",
    rivals={"latency": "compare the first and the last rays at one turn rate"},
    parameters=(
        Parameter(
            name="T",
            unit="s",
            doc="additional duration of a sweep",
            materiality=0.01,
            step=1e-4,
            jump=300.0,
            nuisance=Nuisance.SKEW,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=speeds),
)
