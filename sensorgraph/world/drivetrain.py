"""Drivetrain: motors, wheels and floor of the simulated robot, including the effects on them."""

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
    """Conversion of commands to motion, and of motion to odometry."""

    tau: float
    """[s] Time constant of the motors."""
    delay: float
    """[s] Dead time."""
    base: float
    """[m] Distance between the wheels."""
    v_max: float = float("inf")
    """[m/s] Maximum speed of the motors."""
    measured: Floats = field(default_factory=lambda: np.eye(2))
    """(2, 2) Matrix from the true (v, omega) of the wheels to those of the odometry."""
    odometry_lag: float = 0.0
    """[s] Age of the odometry at its stamp."""
    patches: list[tuple[float, float, float, float]] = field(default_factory=list)
    """(x, y, radius, lost share of the motion) of slippery floor [m, m, m, 1]."""

    @classmethod
    def of(cls, robot: Robot, effects: Iterable[Transform] = ()) -> Drivetrain:
        """Return the drivetrain of robot.yaml, changed by effects."""
        drivetrain = cls(tau=robot.actuators.tau, delay=robot.actuators.delay, base=robot.wheels.base)
        for effect in sorted(effects, key=lambda effect: effect.key):
            effect(drivetrain)  # type: ignore[arg-type]
        return drivetrain

    def moved(self, v: float, omega: float, x: float, y: float, phi: float) -> tuple[float, float]:
        """Return the twist (v, omega) of a body at (x, y, phi) from that of its wheels, which slip independently."""
        if not self.patches:
            return v, omega
        half = self.base / 2
        aside_x, aside_y = -half * math.sin(phi), half * math.cos(phi)
        left = (v - half * omega) * self.grip(x + aside_x, y + aside_y)
        right = (v + half * omega) * self.grip(x - aside_x, y - aside_y)
        return (left + right) / 2, (right - left) / self.base

    def grip(self, x: float, y: float) -> float:
        """Return the share of its motion that a wheel at (x, y) [m] transfers to the floor."""
        share = 1.0
        for px, py, radius, lost in self.patches:
            if (x - px) ** 2 + (y - py) ** 2 <= radius**2:
                share *= 1.0 - lost
        return share
