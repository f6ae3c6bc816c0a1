"""Dead time."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Let commands wait."""
    drivetrain.delay = max(drivetrain.delay + a["L"], 0.0)


DEAD_TIME = Effect(
    name="dead_time",
    title="dead time",
    channel="drive",
    stage="motors",
    physics="A command acts L later than robot.yaml says.",
    equation="v(t) = u(t − L₀ − L)",
    source="Billings (2013), Nonlinear System Identification, section 2.3: pure delay",
    varies="command against odometry: a pure shift",
    rivals={"actuator_lag": "a step: a lag bends it"},
    parameters=(Parameter(name="L", unit="s", doc="added to the dead time of robot.yaml", materiality=0.02),),
    transform=transform,
    diagnostics=Diagnostics(why_unseen="too few changes of the commands"),
)
