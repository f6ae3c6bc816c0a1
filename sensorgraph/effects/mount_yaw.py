"""Mounting yaw."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Turn the laser."""
    scene.mount = scene.mount + [0.0, 0.0, a["delta"]]


MOUNT_YAW = Effect(
    name="mount_yaw",
    title="mounting yaw",
    channel="scan",
    stage="mount",
    physics="The laser is turned about its own axis: every ray leaves at bearing theta + delta.",
    equation="θ → θ + δ",
    source="Censi, Franchi, Marchionni and Oriolo (2013), simultaneous calibration of odometry and sensor parameters",
    varies="r tan(incidence), with opposite signs either side of a wall's normal; not with turn rate",
    rivals={"latency": "turn left and right", "scan_skew": "turn left and right"},
    parameters=(
        Parameter(
            name="delta",
            unit="rad",
            doc="turn of the laser, counter-clockwise",
            materiality=0.0017453,
            step=1e-4,
            jump=300.0,
            nuisance=Nuisance.MOUNT_YAW,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(tolerance="mount_yaw", question_rank=2),
)
