"""Motion reported by the wheels: increments of distance and heading between the stamps of the odometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.run import Run
from planners.arena import wrap
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats

MIN_STAMPS = 20
"""Minimum number of odometry stamps, and of commands, for a comparison."""
SAME_STAMP = 1e-6
"""[s] maximum difference between two stamps that count as one."""
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
    if len(keep) < MIN_STAMPS:
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
