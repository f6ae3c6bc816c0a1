"""Signals of the odometry channel: reference poses of base_link, and increments of the wheels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from logs.run import Run
from planners.arena import wrap
from sensorgraph.diagnosis.motion.increments import (
    SAME_STAMP,
    ChannelSkippedError,
    WheelIncrements,
    require_reference,
    wheel_increments,
)
from sensorgraph.types import Bools, Floats

MIN_TRAVEL = 0.02
"""[m] minimum extent of the reference along one axis, unless it turns by `min_rotation`; otherwise it
does not move."""
MIN_ROTATION = 0.05
"""[rad] minimum rotation of the reference."""
MIN_ROWS = 60
"""Minimum number of rows, and of reference poses; with fewer, the channel is skipped."""
MIN_OVERLAP = 0.9
"""Share of the run during which poses and odometry overlap, below which a note reports it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionSignals:
    """Both sides of the comparison, and notes."""

    stamps: Floats
    """(n,) [s] of the reference."""
    poses: Floats
    """(n, 3) reference poses of base_link, yaw unwrapped."""
    wheels: WheelIncrements
    notes: Mapping[str, object]
    """Plain data for the report."""


def motion_signals(run: Run) -> MotionSignals:
    """Return reference poses and odometry of a run.

    Raises
    ------
    ChannelSkippedError
        The run lacks one of them, one of them does not move, or the poses are the odometry.
    """
    require_reference(run)
    wheels = wheel_increments(run)
    good: Bools = np.asarray(np.isfinite(run.poses).all(axis=1))
    good[1:] &= np.diff(run.pose_stamps) > SAME_STAMP
    stamps, poses = run.pose_stamps[good], run.poses[good].copy()
    if len(stamps) < MIN_ROWS:
        raise ChannelSkippedError(f"this run has {len(stamps)} reference poses, expected at least {MIN_ROWS}")
    travel, rotation = np.ptp(poses[:, :2], axis=0).max(), np.ptp(wrap(poses[:, 2] - poses[0, 2]))
    if travel < MIN_TRAVEL and rotation < MIN_ROTATION:
        raise ChannelSkippedError("the reference poses of this run do not move")
    poses[:, 2] = np.unwrap(poses[:, 2])
    if run.pose_frame == "laser":
        mount = run.sensor.mount
        poses[:, 2] -= mount[2]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        poses[:, :2] -= np.stack([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1)
    notes: dict[str, object] = {"odometry_from": wheels.source}
    first, last = max(stamps[0], wheels.start[0]), min(stamps[-1], wheels.end[-1])
    whole = max(stamps[-1], wheels.end[-1]) - min(stamps[0], wheels.start[0])
    if last - first < MIN_OVERLAP * whole:
        notes["overlap"] = (
            f"poses and odometry overlap from {first:.1f} to {last:.1f} s, {last - first:.1f} of {whole:.1f} s; the rest is not used"
        )
    return MotionSignals(stamps=stamps, poses=poses, wheels=wheels, notes=notes)
