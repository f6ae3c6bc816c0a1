"""Detect jumps: consecutive poses that are farther apart than the robot can drive.

Typical causes are wrong pairs of scan and pose, lost localisation, and two logs in one file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.sensor import usual_step
from logs.types import Floats, Ints


@dataclass(frozen=True, kw_only=True)
class JumpLimits:
    """Limits for the step between consecutive poses; conventions, not fitted to data."""

    speed: float = 5.0
    """[m/s] maximum speed; mobile robots are slower."""
    noise: float = 0.1
    """[m] shorter steps are noise, slip, or scatter of the stamps."""
    distance: float = 1.0
    """[m] shorter steps may be noise of the reference pose."""
    untimed: float = 2.0
    """[m] maximum step between scans without a usable clock."""


JUMP_LIMITS = JumpLimits()


@dataclass(frozen=True, kw_only=True, eq=False)
class Jumps:
    """The jumps of the poses of a run."""

    count: int
    share: float
    """Share of all steps from scan to scan."""
    farthest: float
    """[m] largest jump."""
    at: float
    """[s] stamp of the scan after the largest jump."""
    after: Ints
    """(count,) index of the scan after each jump."""

    def __str__(self) -> str:
        times = "once" if self.count == 1 else f"{self.count} times"
        return f"the pose jumps {times} between consecutive scans, at most {self.farthest:.1f} m at {self.at:.2f} s"


def find_jumps(
    stamps: Floats, poses: Floats, *, least: float = JUMP_LIMITS.distance, is_timed: bool = True
) -> Jumps | None:
    """Return the steps between consecutive poses that are farther than a robot drives; None if there is no such step.

    Parameters
    ----------
    stamps : (n,) [s] in order
    poses : (n, 3) [m, m, rad]
    least : [m] shorter steps are no jumps
    is_timed : whether the stamps come from a clock; False if they are assumed
    """
    if len(stamps) < 2:
        return None
    steps, moved = np.diff(stamps), np.hypot(*np.diff(poses[:, :2], axis=0).T)
    allowed = np.maximum(least, JUMP_LIMITS.speed * np.maximum(steps, usual_step(stamps)))
    if not is_timed:
        allowed[:] = JUMP_LIMITS.untimed
    jumps = moved > allowed
    if not jumps.any():
        return None
    farthest = int(np.argmax(np.where(jumps, moved, 0.0)))
    return Jumps(
        count=int(jumps.sum()),
        share=float(jumps.mean()),
        farthest=float(moved[farthest]),
        at=float(stamps[farthest + 1]),
        after=np.flatnonzero(jumps) + 1,
    )
