"""Bias of a sector of rays."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter, Telltale
from sensorgraph.effects.places import in_sector
from sensorgraph.effects.set_up import between_rays
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Add b to the rays of the sector."""
    scene.beams.reading = scene.beams.reading + a["b"] * in_sector(scene.bearings, a["theta1"], a["theta2"])


SECTOR_BIAS = Effect(
    name="sector_bias",
    title="bias of a sector of rays",
    channel="scan",
    stage="range",
    physics="Rays of one sector of bearings are biased: z = r + b for theta_1 <= theta <= theta_2.",
    equation="z = r + b for θ₁ ≤ θ ≤ θ₂",
    source="Pandey et al. (2011), per-beam calibration of multi-beam lidars",
    varies="bearing only",
    rivals={
        "mount_xy": "a cosine over all bearings",
        "moved_wall": "spin in place: the wall's offset leaves the sector",
    },
    parameters=(
        Parameter(
            name="theta1", unit="rad", doc="first bearing, laser frame", neutral=None, hidden=between_rays
        ),
        Parameter(
            name="theta2", unit="rad", doc="last bearing, laser frame", neutral=None, hidden=between_rays
        ),
        Parameter(name="b", unit="m", doc="added inside the sector", materiality=0.006, step=1e-3),
    ),
    transform=transform,
    place="sector",
    diagnostics=Diagnostics(
        telltale=Telltale(
            least=2, statement="the bias varies with the bearing in a way that no single sector describes"
        )
    ),
)
