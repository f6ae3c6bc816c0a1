"""Wheel radius difference."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import DrivenMotion, Regressor
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Add a turn in proportion to speed."""
    drivetrain.measured = np.array([[1.0, 0.0], [a["s"] / drivetrain.base, 1.0]]) @ drivetrain.measured


def column(motion: DrivenMotion) -> tuple[Floats, Floats]:
    """Return zero for the distance, and the negative path over the wheelbase for the turn."""
    return np.zeros_like(motion.turn), -motion.path / motion.base


WHEEL_RADIUS_DIFF = Effect(
    name="wheel_radius_diff",
    title="wheel radius difference",
    channel="odometry",
    stage="wheels",
    physics="One wheel is larger than the other, so that the odometry has an additional turn rate of s v / base.",
    equation="odometry ω = true ω + s v / base",
    source="Borenstein and Feng (1996), measurement and correction of systematic odometry errors: E_d",
    varies="distance, in the heading",
    rivals={"wheel_base": "drive a long straight line"},
    parameters=(Parameter(name="s", unit="", doc="relative difference of the radii", materiality=0.003),),
    transform=transform,
    diagnostics=Diagnostics(
        why_unseen="the robot drives straight too little",
        regressor=Regressor(
            column=column,
            tolerance=0.001,
            size=lambda coefficient, gain: coefficient / gain,
        ),
    ),
)
