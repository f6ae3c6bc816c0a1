"""Wheelbase."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import WheelMotion, WheelRegressor
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Scale the turn."""
    drivetrain.measured = np.diag([1.0, 1 / (1 + a["s"])]) @ drivetrain.measured


def column(motion: WheelMotion) -> tuple[Floats, Floats]:
    """Let the turn grow."""
    return np.zeros_like(motion.distance), motion.turn


WHEEL_BASE = Effect(
    name="wheel_base",
    title="wheelbase",
    channel="odometry",
    stage="wheels",
    physics="The odometry takes the wheels for (1 + s) times farther apart than they are: it turns 1 / (1 + s) as much.",
    equation="odometry ω = true ω / (1 + s)",
    source="Borenstein and Feng (1996), measurement and correction of systematic odometry errors: E_b",
    varies="error of heading against rotation, the same for both senses",
    rivals={"wheel_radius": "a straight run", "wheel_slip": "another place"},
    parameters=(Parameter(name="s", unit="", doc="relative error of the wheelbase", materiality=0.006),),
    transform=transform,
    diagnostics=Diagnostics(
        why_unseen="too little turning",
        wheel_regressor=WheelRegressor(
            column=column,
            tolerance=0.002,
            size=lambda coefficient, gain: (gain + coefficient) / gain - 1,
        ),
    ),
)
