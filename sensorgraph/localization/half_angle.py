"""Odometry whose quaternions do not have half the heading: z = sin(yaw), w = cos(yaw), or a quarter of it.

Its heading turns twice, or half, as fast as the scans. So does one of wheels with a wrong base, but these integrate their
positions with the heading that they state. Here the positions move another way: the course fits the heading times the factor.
A robot that drives backwards has the opposite course, so that courses are compared modulo a half turn.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.localization.course import MAX_UNALIGNED, MIN_ALIGNED, alignment, course_steps
from sensorgraph.types import Floats

FACTORS = (0.5, 2.0)
"""Factors from the stated heading to the true one."""


def heading_factor(poses: Floats) -> float:
    """Return the factor from the stated heading to that along which the positions move; 1 if none of `FACTORS` explains them.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] Odometry, its heading without jumps of a full turn.
    """
    if abs(alignment(poses, 1.0)) > MAX_UNALIGNED:
        return 1.0
    return next((factor for factor in FACTORS if abs(alignment(poses, factor)) > MIN_ALIGNED), 1.0)


def with_heading(poses: Floats, factor: float) -> Floats:
    """Return the poses (n, 3) with the heading times a factor, so that the robot drives ahead in most of its steps."""
    out = poses * [1.0, 1.0, factor]
    steps, heading = course_steps(out)
    off = np.arctan2(steps[:, 1], steps[:, 0]) - heading
    if (np.hypot(*steps.T) * np.cos(off)).sum() < 0:
        out[:, 2] += np.pi
    return np.asarray(out)


def heading_note(factor: float) -> str:
    """Return the note on a heading that was corrected by a factor."""
    rate, has = ("twice", "the whole heading") if factor < 1 else ("half", "a quarter of the heading")
    return (
        f"the odometry's heading turns {rate} as fast as the scans and its own course: its quaternions have {has} instead of "
        "half of it; corrected"
    )
