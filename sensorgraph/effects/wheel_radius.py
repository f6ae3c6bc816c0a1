"""Wheel radius."""

from __future__ import annotations

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import DrivenMotion, Regressor
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Scale distance and turn."""
    drivetrain.measured = (1 + a["s"]) * drivetrain.measured


def column(motion: DrivenMotion) -> tuple[Floats, Floats]:
    """Return the distance and the turn themselves."""
    return motion.distance, motion.turn


WHEEL_RADIUS = Effect(
    name="wheel_radius",
    title="wheel radius",
    channel="odometry",
    stage="wheels",
    physics="Both wheels are smaller than the odometry assumes, so that it reports (1 + s) times the true distance and turn.",
    equation="odometry (v, ω) = (1 + s) × true (v, ω)",
    source="Borenstein and Feng (1996), measurement and correction of systematic odometry errors",
    varies="distance and turn, in proportion",
    rivals={"wheel_base": "turn in place, then drive straight"},
    parameters=(
        Parameter(
            name="s", unit="", doc="relative excess of the odometry over the motion", materiality=0.005
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(
        why_unseen="the robot drives too little",
        regressor=Regressor(
            column=column,
            tolerance=0.0015,
            size=lambda coefficient, gain: 1 / gain - 1,
            stderr=lambda error, gain: error / gain**2,
        ),
    ),
)
