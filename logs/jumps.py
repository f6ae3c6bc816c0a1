"""Scans whose poses lie farther apart than the robot can have driven: wrong pairs, lost localisation, two logs in one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.types import Floats


@dataclass(frozen=True, kw_only=True)
class JumpLimits:
    """When two poses in a row cannot both be true; conventions, none is fitted to data."""

    speed: float = 5.0
    """[m/s] no robot here drives faster ..."""
    distance: float = 1.0
    """[m] ... and shorter steps may be noise of the reference."""
    untimed: float = 2.0
    """[m] between scans whose clock says nothing."""


JUMP_LIMITS = JumpLimits()


@dataclass(frozen=True, kw_only=True)
class Jumps:
    """The jumps of a run's poses."""

    count: int
    share: float
    """Of all steps from scan to scan."""
    farthest: float
    """[m]"""
    at: float
    """[s] stamp of the scan after the farthest."""

    def __str__(self) -> str:
        times = "once" if self.count == 1 else f"{self.count} times"
        return f"the pose jumps {times} between consecutive scans, the farthest {self.farthest:.1f} m at {self.at:.2f} s"


def find_jumps(stamps: Floats, poses: Floats, *, is_timed: bool = True) -> Jumps | None:
    """Return where consecutive scans are farther apart than `JUMP_LIMITS` allows; None: nowhere.

    Parameters
    ----------
    stamps : (n,) [s] of scans with a pose, in their order
    poses : (n, 3) [m, m, rad]
    is_timed : the stamps are a clock's, not an assumption
    """
    if len(stamps) < 2:
        return None
    steps, moved = np.diff(stamps), np.hypot(*np.diff(poses[:, :2], axis=0).T)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0  # clocks of whole seconds repeat
    allowed = np.maximum(JUMP_LIMITS.distance, JUMP_LIMITS.speed * np.maximum(steps, usual))
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
    )
