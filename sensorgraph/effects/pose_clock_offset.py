"""Clock offset between pose and odometry."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Take the odometry earlier than its stamp says."""
    drivetrain.odometry_lag += a["tau"]


POSE_CLOCK_OFFSET = Effect(
    name="pose_clock_offset",
    title="clock offset between pose and odometry",
    channel="odometry",
    stage="wheels",
    physics="Odometry stamped t was taken at t - tau of the reference's clock.",
    equation="odometry(t) = motion(t − τ)",
    source="Olson (2010), a passive solution to the sensor synchronization problem",
    varies="odometry against pose, in proportion to acceleration",
    rivals={"latency": "the scans show it, or do not"},
    parameters=(
        Parameter(
            name="tau", unit="s", doc="how much older the odometry is than its stamp", materiality=0.005
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen="too little acceleration"),
)
