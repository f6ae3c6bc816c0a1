"""Speed saturation."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Limit the speed."""
    drivetrain.v_max = min(drivetrain.v_max, a["v_max"])


SPEED_SATURATION = Effect(
    name="speed_saturation",
    title="speed saturation",
    channel="drive",
    stage="motors",
    physics="The robot does not drive faster than v_max, although the limit in robot.yaml is higher.",
    equation="|v| ≤ v_max",
    source="Siegwart, Nourbakhsh and Scaramuzza (2011), Introduction to Autonomous Mobile Robots, section 3.6",
    varies="commanded speed above the limit",
    rivals={"actuator_lag": "command several speeds up to the limit"},
    parameters=(Parameter(name="v_max", unit="m/s", doc="largest speed", neutral=None, low=0.0),),
    transform=transform,
)
