"""Latency between pose and scan."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import speeds
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Move the time of each ray back."""
    scene.delay = scene.delay - a["tau"]


LATENCY = Effect(
    name="latency",
    title="latency between pose and scan",
    channel="scan",
    stage="time",
    physics="A scan stamped t was taken at the pose of t - tau.",
    equation="z(t) = r(pose(t − τ))",
    source="Olson (2010), a passive solution to the sensor synchronization problem",
    varies="omega r tan(incidence) and v cos(bearing)",
    rivals={
        "scan_skew": "compare the first and the last rays at one turn rate",
        "mount_yaw": "stand still, and vary v and omega in both directions",
        "mount_xy": "vary the speed",
    },
    parameters=(
        Parameter(
            name="tau",
            unit="s",
            doc="age of the scan at its stamp",
            materiality=0.005,
            step=1e-4,
            jump=300.0,
            nuisance=Nuisance.DELAY,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen=speeds, tolerance="stamp", hidden_by_slam=True, question_rank=1),
)
