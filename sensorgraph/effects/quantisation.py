"""Coarse quantisation."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Round to a lattice."""
    scene.lattice = max(scene.lattice, a["q"])


QUANTISATION = Effect(
    name="quantisation",
    title="coarse quantisation",
    channel="scan",
    stage="noise",
    physics="Returns are rounded to multiples of q, coarser than the data sheet says.",
    equation="z = q round(r / q)",
    source="Widrow and Kollar (2008), quantization noise",
    varies="the lattice of the readings, nothing in the geometry",
    rivals={"range_noise": "a histogram at standstill"},
    parameters=(Parameter(name="q", unit="m", doc="step of the lattice", low=0.0, typical=0.01),),
    transform=transform,
    diagnostics=Diagnostics(is_lattice=True, is_forecast=False),
)
