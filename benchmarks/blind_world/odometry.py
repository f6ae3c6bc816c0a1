"""What encoders make of the wheels, in the conventions that drivers have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.blind_world.base import RIM_LEFT, RIM_RIGHT
from benchmarks.blind_world.drive import Driven
from benchmarks.blind_world.robots import Robot
from benchmarks.blind_world.rooms import Floats


@dataclass(frozen=True, kw_only=True)
class Convention:
    """How a driver counts, adds up and stamps; all of these are right."""

    integration: str = "exact"
    """exact, mid or rect: along the arc, or along the heading at the middle or at the start of a period."""
    twist: str = "back"
    """back: of the last period; smooth: the mean of the last two."""
    age: float = 0.0
    """[s] how much older a reading is than its stamp."""
    phase: float = 0.0
    """Share of a period before the first stamp."""
    skew: float = 0.0
    """By how much the rate differs from the data sheet."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Odometry:
    """What is logged."""

    stamps: Floats
    """(n,) [s]"""
    poses: Floats
    """(n, 3) [m, m, rad], phi not wrapped."""
    twists: Floats
    """(n, 2) [m/s, rad/s]"""


def count(
    robot: Robot,
    driven: Driven,
    rng: np.random.Generator,
    convention: Convention,
    *,
    gyro_bias: Callable[[Floats], Floats] | None = None,
    lost_above: float = np.inf,
    lost_share: float = 0.0,
) -> Odometry:
    """Return the odometry of a drive.

    Parameters
    ----------
    gyro_bias : [rad/s] at stamps, of a gyro that gives the heading
    lost_above, lost_share : the right encoder loses this share of its ticks above this speed [m/s]
    """
    rate = robot.odometry_rate * (1 + convention.skew)
    stamps = np.arange(0.1 + convention.phase / rate, driven.duration - 0.1, 1 / rate)
    taken = stamps - convention.age
    right, left = np.diff(driven.at(taken, RIM_RIGHT)), np.diff(driven.at(taken, RIM_LEFT))
    right = np.where(right * rate > lost_above, right * (1 - lost_share), right)
    right, left = np.r_[0, np.cumsum(right)] + 0.3e-3, np.r_[0, np.cumsum(left)] + 0.1e-3
    step_right = np.diff(np.floor(right / robot.tick) * robot.tick)
    step_left = np.diff(np.floor(left / robot.tick) * robot.tick)
    moves = (np.abs(step_right) + np.abs(step_left)) > 0
    n = moves.size
    way = 0.5 * (step_right + step_left) + rng.normal(0, robot.noise_v / rate, n) * moves
    turn = (step_right - step_left) / robot.wheel_base + rng.normal(0, robot.noise_omega / rate, n) * moves
    if gyro_bias is not None:
        turn = turn + gyro_bias(stamps[1:]) / rate
    phi = np.r_[0, np.cumsum(turn)]
    heading = phi[:-1] + {"exact": 0.5 * turn, "mid": 0.5 * turn, "rect": 0 * turn}[convention.integration]
    chord = way * (np.sinc(turn / 2 / np.pi) if convention.integration == "exact" else 1.0)
    x, y = np.cumsum(chord * np.cos(heading)), np.cumsum(chord * np.sin(heading))
    v, omega = way * rate, turn * rate
    if convention.twist == "smooth":
        v = np.convolve(np.r_[v[0], v], [0.5, 0.5], "valid")
        omega = np.convolve(np.r_[omega[0], omega], [0.5, 0.5], "valid")
    return Odometry(
        stamps=stamps[1:], poses=np.column_stack([x, y, phi[1:]]), twists=np.column_stack([v, omega])
    )
