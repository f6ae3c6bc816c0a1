"""Mounting yaw."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene

SLANT = float(np.radians(20))
"""[rad] of incidence from which on a turn of the laser shows."""


def transform(scene: Scene, a: Amendment) -> None:
    """Turn the laser."""
    scene.mount = scene.mount + [0.0, 0.0, a["delta"]]


def slants(exposure: Exposure) -> str:
    """Say how many returns are from walls met slanting."""
    slanting = exposure.incidence[exposure.seen] > SLANT
    share = float(slanting.mean()) if exposure.n_seen else 0.0
    return (
        f"{100 * share:.0f} % of the returns are from walls met at more than {np.degrees(SLANT):.0f} degrees"
    )


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
    diagnostics=Diagnostics(why_unseen=slants, tolerance="mount_yaw", question_rank=2),
)
