"""The task of a controller, and the measured quantities of a drive: wall distance, speed, smoothness, contacts, laps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import stdtrit

from sensorgraph.errors import SensorgraphError
from sensorgraph.identification.population_drive import RIGHT_OFFSET
from sensorgraph.types import Floats
from sensorgraph.world.drive import STANDSTILL, Clearance, ExecutedDrive
from sensorgraph.world.robot import Robot

DIGITS = 3
"""Significant digits of a quantity. Drives at constant speed differ by 1e-6 m/s, which no robot keeps."""
WALL_SIGMA = 0.002
"""[m] Standard deviation of the walls of a graph and of distance tables, in addition to the noise of the drives."""
SAMPLE_STEP = 0.1
"""[s] Time step between the measured samples of a drive."""
MIN_WALL_ON_RIGHT = 0.75
"""Minimum share of the time with the wall on the right: between 1 and the half of a robot that turns in a circle."""


@dataclass(frozen=True, kw_only=True)
class DesignTask:
    """The requested behaviour."""

    wall_distance: float
    """[m] Distance from the centre of the robot to the nearest wall, which is on its right."""
    speed: float
    """[m/s] Driving speed."""
    smoothness: float = 1.0
    """[rad/s^2] Maximum root mean square change of the commanded turn rate."""
    duration: float = 90.0
    """[s] Duration of a predicted drive."""

    def check(self, robot: Robot) -> None:
        """Refuse a task that exceeds the limits of the robot.

        Raises
        ------
        SensorgraphError : A value is outside the range of the robot.
        """
        limits = (
            ("wall distance", self.wall_distance, robot.footprint_radius, 2.0, "m"),
            ("speed", self.speed, 0.0, robot.limits.v, "m/s"),
            ("smoothness", self.smoothness, 0.0, np.inf, "rad/s^2"),
            ("duration", self.duration, 1.0, 3600.0, "s"),
        )
        for name, value, low, high, unit in limits:
            if not low < value <= high:
                raise SensorgraphError(
                    f"{name} is {value:g} {unit}, expected more than {low:g} and at most {high:g} for {robot.name}"
                )


@dataclass(frozen=True, kw_only=True)
class DriveQuantities:
    """Quantities of one drive."""

    wall_distance_m: float
    """Mean over time."""
    wall_distance_5_m: float
    """5 % quantile over time."""
    wall_distance_95_m: float
    """95 % quantile over time."""
    speed_m_s: float
    turn_change_rad_s2: float
    """Root mean square change of the commanded turn rate."""
    contacts: float
    lap_s: float
    """[s] Duration of one turn around the centre of the floor; nan if the drive did not complete one."""


def quantities(drive: ExecutedDrive, clearance: Clearance, middle: Floats, period: float) -> DriveQuantities:
    """Measure a drive; `middle` (2,) [m] is the centre of the laps, `period` [s] the period of the scans."""
    end = float(drive.stamps[-1]) - STANDSTILL  # after that, the command is to stand
    t = np.arange(0.0, end, SAMPLE_STEP)
    poses = drive.at(t)
    distance = np.array([clearance(x, y) for x, y in poses[:, :2]])
    moved = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
    angle = np.unwrap(np.arctan2(*(poses[:, :2] - middle).T[::-1]))
    turned = abs(float(angle[-1] - angle[0]))
    every = max(1, round(period / float(np.diff(drive.cmd_stamps[:2])[0])))
    change = np.diff(drive.commands[drive.cmd_stamps <= end][::every, 1]) / period
    low, high = np.quantile(distance, [0.05, 0.95])
    return DriveQuantities(
        wall_distance_m=float(distance.mean()), wall_distance_5_m=float(low),
        wall_distance_95_m=float(high), speed_m_s=float(moved / max(t[-1] - t[0], 1e-9)),
        turn_change_rad_s2=float(np.sqrt(np.mean(change**2))), contacts=float(drive.contacts),
        lap_s=float(2 * np.pi * (t[-1] - t[0]) / turned) if turned >= 2 * np.pi else float("nan"),
    )  # fmt: skip


def follows_wall(drive: ExecutedDrive, clearance: Clearance) -> bool:
    """Return whether the robot keeps the wall on its right, without contact; a robot that turns in a circle does not."""
    poses = drive.at(np.arange(0.0, float(drive.stamps[-1]) - STANDSTILL, SAMPLE_STEP))
    right = poses[:, :2] + RIGHT_OFFSET * np.column_stack([np.sin(poses[:, 2]), -np.cos(poses[:, 2])])
    nearer = [clearance(*there) < clearance(*here) for there, here in zip(right, poses[:, :2], strict=True)]
    return drive.contacts == 0 and float(np.mean(nearer)) > MIN_WALL_ON_RIGHT


@dataclass(frozen=True, kw_only=True)
class Interval:
    """Prediction of a quantity of the next drive."""

    mean: float
    low: float
    high: float
    """95 % prediction interval over drives (Student's t)."""

    def holds(self, value: float) -> bool:
        """Return whether the interval contains a value, all rounded to DIGITS as they are printed.

        An unknown interval contains only an unknown value.
        """
        if np.isnan(self.mean) or np.isnan(value):
            return bool(np.isnan(self.mean) and np.isnan(value))
        low, at, high = (float(shown(one)) for one in (self.low, value, self.high))
        return low <= at <= high


def shown(value: float) -> str:
    """Return a quantity with DIGITS significant digits."""
    return f"{value:.{DIGITS}g}"


def predicted(drives: Sequence[DriveQuantities]) -> dict[str, Interval]:
    """Return the prediction interval mean ± t_(n-1, 0.975) sigma sqrt(1 + 1/n) of each quantity from n drives."""
    out = {}
    for field in fields(DriveQuantities):
        values = np.array([getattr(drive, field.name) for drive in drives])
        n, mean = len(values), float(values.mean())
        if n < 2:
            out[field.name] = Interval(mean=mean, low=np.nan, high=np.nan)
            continue
        sigma = np.hypot(values.std(ddof=1), WALL_SIGMA if field.name.startswith("wall_distance") else 0.0)
        half = float(stdtrit(n - 1, 0.975) * sigma * np.sqrt(1 + 1 / n))
        out[field.name] = Interval(mean=mean, low=mean - half, high=mean + half)
    return out
