"""Actuator lag."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Slow the motors down."""
    drivetrain.tau = max(drivetrain.tau + a["tau"], 0.0)


ACTUATOR_LAG = Effect(
    name="actuator_lag",
    title="actuator lag",
    channel="drive",
    stage="motors",
    physics="The motors follow a command with a time constant tau longer than robot.yaml says.",
    equation="(τ₀ + τ) dv/dt = u − v",
    source="Siegwart, Nourbakhsh and Scaramuzza (2011), Introduction to Autonomous Mobile Robots, section 3.6",
    varies="command against odometry: an exponential step",
    rivals={"dead_time": "a step, not a ramp: dead time shifts it whole"},
    parameters=(
        Parameter(name="tau", unit="s", doc="added to the time constant of robot.yaml", materiality=0.015),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen="too few changes of the commands"),
)
