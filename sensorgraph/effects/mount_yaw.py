"""Mounting yaw."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import Exposure
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene

SLANT = float(np.radians(20))
"""[rad] Incidence above which a turn of the laser is visible."""


def transform(scene: Scene, a: Amendment) -> None:
    """Turn the laser."""
    scene.mount = scene.mount + [0.0, 0.0, a["delta"]]


def slants(exposure: Exposure) -> str:
    """Return a text on the share of returns at oblique incidence."""
    oblique = exposure.incidence[exposure.seen] > SLANT
    share = float(oblique.mean()) if exposure.n_seen else 0.0
    return f"only {100 * share:.0f} % of the returns have an incidence above {np.degrees(SLANT):.0f} degrees"


MOUNT_YAW = Effect(
    name="mount_yaw",
    title="mounting yaw",
    channel="scan",
    stage="mount",
    physics="The laser is turned about its axis: each ray has the bearing theta + delta.",
    equation="θ → θ + δ",
    source="Censi, Franchi, Marchionni and Oriolo (2013), simultaneous calibration of odometry and sensor parameters",
    varies="r tan(incidence), with opposite signs on the two sides of a wall's normal, and not the turn rate",
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
