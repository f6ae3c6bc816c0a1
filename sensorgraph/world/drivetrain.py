"""Machine: motors, wheels and floor of the embedded robot, as effects may change them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot
from sensorgraph.world.scene import Transform


@dataclass(eq=False)
class Drivetrain:
    """What turns commands into motion, and motion into odometry."""

    tau: float
    """[s] time constant of the motors."""
    delay: float
    """[s] dead time."""
    base: float
    """[m] between the wheels."""
    v_max: float = float("inf")
    """[m/s] that the motors cannot exceed."""
    measured: Floats = field(default_factory=lambda: np.eye(2))
    """(2, 2) true (v, omega) of the wheels -> what the odometry takes them for."""
    odometry_lag: float = 0.0
    """[s] how much older the odometry is than its stamp."""
    patches: list[tuple[float, float, float, float]] = field(default_factory=list)
    """(x, y, radius, share of the motion that is lost) of slippery floor [m, m, m, 1]."""

    @classmethod
    def of(cls, robot: Robot, effects: Iterable[Transform] = ()) -> Drivetrain:
        """Return the drivetrain that robot.yaml describes, changed by effects."""
        drivetrain = cls(tau=robot.actuators.tau, delay=robot.actuators.delay, base=robot.wheels.base)
        for effect in sorted(effects, key=lambda effect: effect.key):
            effect(drivetrain)  # type: ignore[arg-type]
        return drivetrain

    def moved(self, v: float, omega: float, x: float, y: float, phi: float) -> tuple[float, float]:
        """Return the twist (v, omega) of a body at (x, y, phi) whose wheels turn as for the one given: each slips by itself."""
        if not self.patches:
            return v, omega
        half = self.base / 2
        aside_x, aside_y = -half * math.sin(phi), half * math.cos(phi)
        left = (v - half * omega) * self.grip(x + aside_x, y + aside_y)
        right = (v + half * omega) * self.grip(x - aside_x, y - aside_y)
        return (left + right) / 2, (right - left) / self.base

    def grip(self, x: float, y: float) -> float:
        """Return the share of its motion that a wheel at (x, y) [m] brings to the floor."""
        share = 1.0
        for px, py, radius, lost in self.patches:
            if (x - px) ** 2 + (y - py) ** 2 <= radius**2:
                share *= 1.0 - lost
        return share
