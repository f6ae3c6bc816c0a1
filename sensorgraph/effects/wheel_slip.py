"""Wheel slip."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Effect, Parameter
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Add a slippery patch of the floor."""
    drivetrain.patches.append((a["x"], a["y"], a["r"], a["s"]))


WHEEL_SLIP = Effect(
    name="wheel_slip",
    title="wheel slip",
    channel="odometry",
    stage="wheels",
    physics="On a slippery patch, the true distance of a wheel is (1 - s) times its rotation; each wheel slips separately.",
    equation="true distance of a wheel = (1 − s) × its rotation, while it is within r of (x, y)",
    source="Ojeda, Cruz, Reina and Borenstein (2006), current-based slippage detection",
    varies="place",
    rivals={
        "wheel_radius": "an error of the radius acts everywhere",
        "wheel_base": "cross the patch again slowly",
    },
    parameters=(
        Parameter(name="s", unit="", doc="lost share of the motion", materiality=0.05, low=0.0, high=1.0),
        Parameter(name="x", unit="m", doc="x of the centre of the patch", neutral=None),
        Parameter(name="y", unit="m", doc="y of the centre of the patch", neutral=None),
        Parameter(name="r", unit="m", doc="radius of the patch", neutral=None, low=0.0),
    ),
    transform=transform,
    place="spot",
)
