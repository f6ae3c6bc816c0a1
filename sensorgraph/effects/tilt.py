"""Tilted scan plane."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.shared import LOSS_LEFTOVERS
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Dip the plane of the rays."""
    beams = scene.beams
    dip = a["beta"] * np.cos(scene.bearings - a["theta0"])  # (n_rays,)
    with np.errstate(divide="ignore"):
        floor = np.where(dip > 0, scene.sensor.height / np.sin(np.maximum(dip, 1e-12)), np.inf)
    stretch = 1 / np.cos(dip)
    down = beams.reading * stretch > floor
    beams.reading = np.where(down, floor, beams.reading * stretch)
    beams.slope = np.where(down, 0.0, stretch) * beams.slope
    beams.bent()[down] = False


TILT = Effect(
    name="tilt",
    title="tilted scan plane",
    channel="scan",
    stage="optics",
    physics="The plane dips by beta towards theta_0: rays meet the floor at h / sin(beta cos(theta - theta_0)), others are stretched by 1 / cos.",
    equation="z = min(r / cos ψ, h / sin ψ), ψ = β cos(θ − θ₀)",
    source="geometry of a plane at height h; Kohlbrecher et al. (2011), Hector SLAM, section III",
    varies="range capped in dependence of the bearing, only where the room is deep",
    rivals={
        "max_range": "returns exist there",
        "unmapped_obstacle": "it moves with the robot: a long open view, and a spin",
    },
    parameters=(
        Parameter(
            name="beta",
            unit="rad",
            doc="dip",
            low=0.0,
            high=0.5,
            step=1e-5,
            search_step=0.003,
            jump=5e3,
            typical=float(np.radians(3.0)),
            hidden=lambda _: 1e-5,
        ),
        Parameter(
            name="theta0",
            unit="rad",
            doc="bearing of the deepest dip, laser frame",
            neutral=0.0,
            step=1e-5,
            search_step=0.05,
            jump=5e3,
            hidden=lambda _: 5e-4,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(leftovers=LOSS_LEFTOVERS),
)
