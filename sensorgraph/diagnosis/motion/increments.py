"""Signals of the motion channels: increments of the wheels, commands, and rows of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.run import Run
from planners.arena import wrap
from sensorgraph.diagnosis.motion.regression import Rows
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

MIN_ROWS = 60
"""Minimum number of stamps, and of rows; with fewer, the channel is skipped."""
SAME_STAMP = 1e-6
"""[s] maximum difference between two stamps that count as one."""
MAX_GAP = 0.35
"""[s] maximum gap in poses, odometry or commands, across which motion is compared."""
MIN_MOTION = 1e-3
"""[m or rad], of twists [m/s or rad/s]: range of a signal, below which it does not move."""


class ChannelSkippedError(SensorgraphError):
    """Raised if a run lacks the data of a channel; the message gives the reason."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WheelIncrements:
    """Motion that the wheels report between consecutive stamps."""

    start: Floats
    """(n,) [s]"""
    end: Floats
    """(n,) [s]"""
    distance: Floats
    """(n,) [m] along the path, signed."""
    turn: Floats
    """(n,) [rad]"""
    source: str
    """Origin: `poses` or `twists` of the odometry."""

    @property
    def middle(self) -> Floats:
        """(n,) [s]"""
        return (self.start + self.end) / 2

    @property
    def rates(self) -> Floats:
        """(n, 2) [m/s, rad/s]"""
        return np.stack([self.distance, self.turn], axis=1) / (self.end - self.start)[:, None]

    def sides(self, base: float) -> tuple[Floats, Floats]:
        """Return the distances (n,), (n,) [m] of the left and the right wheel, `base` [m] apart."""
        half_turn = self.turn * base / 2
        return self.distance - half_turn, self.distance + half_turn


def wheel_increments(run: Run) -> WheelIncrements:
    """Return the increments of the odometry between its stamps.

    Poses are preferred, because the meaning of their stamps is unambiguous. Twists replace poses that do not
    move.

    Raises
    ------
    ChannelSkippedError
        The run has no odometry, or none that moves.
    """
    n = len(run.odom_stamps)
    is_new = np.concatenate([[True], np.diff(run.odom_stamps) > SAME_STAMP]) if n else np.zeros(0)
    keep = np.flatnonzero(is_new)
    said = "this run has no odometry that moves" if n else "this run has no odometry"
    nothing = ChannelSkippedError(said)
    if len(keep) < MIN_ROWS:
        raise nothing
    stamps, poses, twists = run.odom_stamps[keep], run.odometry[keep], run.odom_twists[keep]
    dt = np.diff(stamps)
    if np.isfinite(poses).all() and np.ptp(poses, axis=0).max() > MIN_MOTION:
        turn = np.asarray(wrap(np.diff(poses[:, 2])))
        step = np.diff(poses[:, :2], axis=0)
        heading = poses[:-1, 2] + turn / 2
        chord = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
        distance = chord / np.sinc(turn / (2 * np.pi))
        source = "poses"
    elif np.isfinite(twists).all() and np.ptp(twists, axis=0).max() > MIN_MOTION:
        distance, turn, source = twists[1:, 0] * dt, twists[1:, 1] * dt, "twists"
    else:
        raise nothing
    return WheelIncrements(start=stamps[:-1], end=stamps[1:], distance=distance, turn=turn, source=source)


def require_reference(run: Run) -> None:
    """Reject a run whose poses are its odometry.

    Raises
    ------
    ChannelSkippedError
        The odometry has no separate reference.
    """
    source = run.meta.get("pose_source", "")
    is_said = source.partition(" ")[0].strip("/") in ("odom", "odometry")
    is_same = (
        len(run.pose_stamps) == len(run.odom_stamps) > 0
        and np.array_equal(run.pose_stamps, run.odom_stamps)
        and np.array_equal(run.poses, run.odometry, equal_nan=True)
    )
    if is_said or is_same:
        named = f" ({source})" if source else ""
        raise ChannelSkippedError(
            f"the poses of this run are its odometry{named}; expected a separate reference for the comparison"
        )


def clock_sigma(robot: Robot) -> float:
    """Return the standard deviation of a clock offset that needs no effect [s]: uniform within the tolerance of a stamp."""
    return robot.tolerances.stamp / float(np.sqrt(3))


# commands -----------------------------------------------------------------------------------------------------------


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
        return float(np.abs(self.values[:, 0]).max())


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
    if len(stamps) < MIN_ROWS:
        raise ChannelSkippedError(f"this run has {len(stamps)} commands, expected at least {MIN_ROWS}")
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

    @property
    def stamps(self) -> Floats:
        """(n,) [s]"""
        return self.start


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
    is_late = abs(offset) > max(2 * sigma, 3 * error)
    late = offset if is_late else 0.0
    start, end = wheels.start - late, wheels.end - late
    stamps = commands.stamps
    gap = np.interp(end, stamps[1:], np.diff(stamps))
    valid: Bools = (
        (start > stamps[0] + MAX_GAP) & (end < stamps[-1]) & (gap < MAX_GAP) & (end - start < MAX_GAP)
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
        clock_sigma=float(np.hypot(sigma, error if is_late else 0.0)),
        has_reference=clock is not None,
        source=wheels.source,
    )
