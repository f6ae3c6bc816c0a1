"""Rows of the drive channel: motion of the wheels between two stamps, and the commands for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.motion.increments import (
    MIN_MOTION,
    MIN_STAMPS,
    ChannelSkippedError,
    WheelIncrements,
)
from sensorgraph.diagnosis.motion.regression import Rows
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.wheels.model import clock_sigma
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

TOP_QUANTILE = 0.999
"""Quantile of the commanded speeds that counts as the maximum, so that single odd commands do not matter."""
SETTLING_TIME = 0.3
"""[s] after the first command that is not compared, because earlier commands are unknown."""
MIN_CLOCK_OFFSET = 0.004
"""[s] minimum offset between the clocks of odometry and reference that is corrected."""
MAX_CLOCK_ERROR = 0.01
"""[s] upper limit of the standard error of that offset."""
MIN_ROWS = 100
"""Minimum number of rows; with fewer, the channel is skipped."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandSignal:
    """Commands of a run; each acts from its stamp."""

    stamps: Floats
    """(n,) [s]"""
    values: Floats
    """(n, 2) [m/s, rad/s]"""

    @property
    def top_speed(self) -> float:
        """Maximum commanded speed [m/s]."""
        return float(np.quantile(np.abs(self.values[:, 0]), TOP_QUANTILE))


def commands_of(run: Run) -> CommandSignal:
    """Return the commands of a run.

    Raises
    ------
    ChannelSkippedError
        There are too few, or they never change.
    """
    n = len(run.commands)
    good = np.isfinite(run.commands).all(axis=1) if n else np.zeros(0, dtype=np.bool_)
    stamps, values = run.cmd_stamps[good], run.commands[good]
    if len(stamps) < MIN_STAMPS:
        raise ChannelSkippedError(f"this run has {len(stamps)} commands, expected at least {MIN_STAMPS}")
    if np.ptp(values, axis=0).max() < MIN_MOTION:
        raise ChannelSkippedError("the commands of this run never change")
    return CommandSignal(stamps=stamps, values=values)


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveRows(Rows):
    """Mean rates between two stamps of the odometry, on the clock of the commands."""

    start: Floats
    """(n,) [s]"""
    end: Floats
    """(n,) [s]"""
    y: Floats
    """(2 n,) [m/s], then [rad/s]; 0 where not valid."""
    late: float
    """[s] correction of the odometry's clock."""
    clock_sigma: float
    """[s] standard deviation of the remaining clock offset."""
    has_reference: bool
    """Whether the clock offset is known from reference poses."""
    source: str
    """Origin of the odometry: `poses` or `twists`."""


def drive_rows(
    wheels: WheelIncrements, commands: CommandSignal, robot: Robot, clock: tuple[float, float] | None
) -> DriveRows:
    """Align the odometry with the clock of the commands.

    Parameters
    ----------
    clock : [s] Age of the odometry at its stamps, and its standard error; None if unknown.

    Raises
    ------
    ChannelSkippedError
        Commands and odometry hardly overlap.
    """
    sigma = clock_sigma(robot)
    offset, error = clock if clock is not None else (0.0, 0.0)
    is_late = abs(offset) > max(2 * sigma, 3 * error, MIN_CLOCK_OFFSET)
    late = offset if is_late else 0.0
    start, end = wheels.start - late, wheels.end - late
    stamps = commands.stamps
    gap = np.interp(end, stamps[1:], np.diff(stamps))
    valid: Bools = (
        (start > stamps[0] + SETTLING_TIME)
        & (end < stamps[-1])
        & (gap < EVIDENCE.max_gap)
        & (end - start < EVIDENCE.max_gap)
    )
    if int(valid.sum()) < MIN_ROWS:
        raise ChannelSkippedError(
            f"commands and odometry overlap in {int(valid.sum())} samples, expected at least {MIN_ROWS}"
        )
    return DriveRows(
        start=start,
        end=end,
        valid=valid,
        y=np.where(np.concatenate([valid, valid]), wheels.rates.T.ravel(), 0.0),
        late=late,
        clock_sigma=float(np.hypot(sigma, min(error, MAX_CLOCK_ERROR) if is_late else 0.0)),
        has_reference=clock is not None,
        source=wheels.source,
    )
