"""Speed saturation."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Cap the speed."""
    drivetrain.v_max = min(drivetrain.v_max, a["v_max"])


SPEED_SATURATION = Effect(
    name="speed_saturation",
    title="speed saturation",
    channel="drive",
    stage="motors",
    physics="The robot does not drive faster than v_max, though robot.yaml allows more.",
    equation="|v| ≤ v_max",
    source="Siegwart, Nourbakhsh and Scaramuzza (2011), Introduction to Autonomous Mobile Robots, section 3.6",
    varies="only at high commands",
    rivals={"actuator_lag": "a sweep of speeds"},
    parameters=(Parameter(name="v_max", unit="m/s", doc="largest speed", neutral=None, low=0.0),),
    transform=transform,
)
