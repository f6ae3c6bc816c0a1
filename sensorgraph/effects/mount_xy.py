"""Mounting offset."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import count_of_returns
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Shift the laser in base_link."""
    scene.mount = scene.mount + [a["dx"], a["dy"], 0.0]


MOUNT_XY = Effect(
    name="mount_xy",
    title="mounting offset",
    channel="scan",
    stage="mount",
    physics="The laser is shifted by (dx, dy) in base_link from its position in robot.yaml.",
    equation="laser at (x₀ + dx, y₀ + dy)",
    source="Censi, Franchi, Marchionni and Oriolo (2013), simultaneous calibration of odometry and sensor parameters",
    varies="-(dx cos theta + dy sin theta) / cos(incidence), in the frame of the robot",
    rivals={
        "range_bias": "an offset depends on the cosine of the bearing",
        "latency": "vary the speed, forward and backward",
    },
    parameters=(
        Parameter(
            name="dx", unit="m", doc="forward", materiality=0.005, step=1e-4, nuisance=Nuisance.MOUNT_X
        ),
        Parameter(
            name="dy", unit="m", doc="to the left", materiality=0.005, step=1e-4, nuisance=Nuisance.MOUNT_Y
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=count_of_returns, tolerance="mount_xy"),
)
