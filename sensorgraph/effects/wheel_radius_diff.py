"""Difference of the wheels' radii."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import WheelMotion, WheelRegressor
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Turn in proportion to speed."""
    drivetrain.measured = np.array([[1.0, 0.0], [a["s"] / drivetrain.base, 1.0]]) @ drivetrain.measured


def column(motion: WheelMotion) -> tuple[Floats, Floats]:
    """Turn in proportion to the path."""
    return np.zeros_like(motion.turn), -motion.path / motion.base


WHEEL_RADIUS_DIFF = Effect(
    name="wheel_radius_diff",
    title="difference of the wheels' radii",
    channel="odometry",
    stage="wheels",
    physics="One wheel is larger: the odometry turns by s v / base while driving.",
    equation="odometry ω = true ω + s v / base",
    source="Borenstein and Feng (1996), measurement and correction of systematic odometry errors: E_d",
    varies="error of heading against distance",
    rivals={"wheel_base": "a long straight"},
    parameters=(Parameter(name="s", unit="", doc="relative difference of the radii", materiality=0.003),),
    transform=transform,
    diagnostics=Diagnostics(
        why_unseen="too little straight driving",
        wheel_regressor=WheelRegressor(
            column=column,
            tolerance=0.001,
            size=lambda coefficient, gain: coefficient / gain,
        ),
    ),
)
