"""Dead time."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Delay the commands."""
    drivetrain.delay = max(drivetrain.delay + a["L"], 0.0)


DEAD_TIME = Effect(
    name="dead_time",
    title="dead time",
    channel="drive",
    stage="motors",
    physics="A command acts later than specified in robot.yaml, by L.",
    equation="v(t) = u(t − L₀ − L)",
    source="Billings (2013), Nonlinear System Identification, section 2.3: pure delay",
    varies="changes of the command, with a delayed response",
    rivals={"actuator_lag": "command a step: a lag changes the shape of the response"},
    parameters=(
        Parameter(name="L", unit="s", doc="increase of the dead time over robot.yaml", materiality=0.02),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen="the commands change too rarely"),
)
