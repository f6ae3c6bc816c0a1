"""Clock offset between pose and odometry."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Move the time of the odometry back."""
    drivetrain.odometry_lag += a["tau"]


POSE_CLOCK_OFFSET = Effect(
    name="pose_clock_offset",
    title="clock offset between pose and odometry",
    channel="odometry",
    stage="wheels",
    physics="Odometry stamped t was taken at time t - tau of the clock of the reference poses.",
    equation="odometry(t) = motion(t − τ)",
    source="Olson (2010), a passive solution to the sensor synchronization problem",
    varies="acceleration, in proportion",
    rivals={"latency": "a latency is visible in the scans, a clock offset of the odometry is not"},
    parameters=(Parameter(name="tau", unit="s", doc="age of the odometry at its stamp", materiality=0.005),),
    transform=transform,
    diagnostics=Diagnostics(why_unseen="the robot accelerates too little"),
)
