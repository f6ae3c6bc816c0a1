"""Actuator lag."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Increase the time constant of the motors."""
    drivetrain.tau = max(drivetrain.tau + a["tau"], 0.0)


ACTUATOR_LAG = Effect(
    name="actuator_lag",
    title="actuator lag",
    channel="drive",
    stage="motors",
    physics="The time constant of the motors is longer than specified in robot.yaml, by tau.",
    equation="(τ₀ + τ) dv/dt = u − v",
    source="Siegwart, Nourbakhsh and Scaramuzza (2011), Introduction to Autonomous Mobile Robots, section 3.6",
    varies="changes of the command, with an exponential response",
    rivals={"dead_time": "command a step: dead time shifts the response without changing its shape"},
    parameters=(
        Parameter(
            name="tau", unit="s", doc="increase of the time constant over robot.yaml", materiality=0.015
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(why_unseen="the commands change too rarely"),
)
