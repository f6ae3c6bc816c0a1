"""Wheelbase."""

from __future__ import annotations

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import DrivenMotion, Regressor
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain


def transform(drivetrain: Drivetrain, a: Amendment) -> None:
    """Scale the turn."""
    drivetrain.measured = np.diag([1.0, 1 / (1 + a["s"])]) @ drivetrain.measured


def column(motion: DrivenMotion) -> tuple[Floats, Floats]:
    """Return zero for the distance, and the turn itself for the turn."""
    return np.zeros_like(motion.distance), motion.turn


WHEEL_BASE = Effect(
    name="wheel_base",
    title="wheelbase",
    channel="odometry",
    stage="wheels",
    physics="The odometry assumes a wheelbase that is (1 + s) times the true one, so that its turn is 1 / (1 + s) times the true turn.",
    equation="odometry ω = true ω / (1 + s)",
    source="Borenstein and Feng (1996), measurement and correction of systematic odometry errors: E_b",
    varies="rotation, equally in both directions",
    rivals={"wheel_radius": "drive straight", "wheel_slip": "turn at another place"},
    parameters=(Parameter(name="s", unit="", doc="relative error of the wheelbase", materiality=0.006),),
    transform=transform,
    diagnostics=Diagnostics(
        why_unseen="the robot turns too little",
        regressor=Regressor(
            column=column,
            tolerance=0.002,
            size=lambda coefficient, gain: (gain + coefficient) / gain - 1,
        ),
    ),
)
