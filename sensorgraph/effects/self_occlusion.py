"""A part of the robot in view."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.places import in_sector
from sensorgraph.effects.set_up import between_rays
from sensorgraph.effects.shared import LOSS_LEFTOVERS
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Let the rays of the sector end at the robot itself."""
    beams = scene.beams
    sector = np.broadcast_to(in_sector(scene.bearings, a["theta1"], a["theta2"]), beams.reading.shape)
    hidden = sector & (beams.reading > a["r0"])
    beams.reading = np.where(hidden, a["r0"], beams.reading)
    beams.p_return = np.where(hidden, 1.0, beams.p_return)
    beams.bent()[hidden] = False


SELF_OCCLUSION = Effect(
    name="self_occlusion",
    title="a part of the robot in view",
    channel="scan",
    stage="detection",
    physics="A part of the robot stands r0 before the sensor and hides the sector from theta_1 to theta_2.",
    equation="z = r₀ for θ₁ ≤ θ ≤ θ₂",
    source="Dolgov et al.; common practice of laser filters (ROS laser_filters, angular bounds)",
    varies="bearing, whatever the pose",
    rivals={"min_range": "turn in free space"},
    parameters=(
        Parameter(
            name="r0",
            unit="m",
            doc="range of the robot's own part",
            neutral=None,
            low=0.0,
            step=1e-4,
            typical=0.25,
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
    diagnostics=Diagnostics(leftovers=LOSS_LEFTOVERS),
)
