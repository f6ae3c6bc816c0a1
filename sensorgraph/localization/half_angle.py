"""Odometry whose quaternions do not have half the heading: z = sin(yaw), w = cos(yaw), or a quarter of it.

Its heading turns twice, or half, as fast as the scans. So does one of wheels with a wrong base, but these integrate their
positions with the heading that they state. Here the positions move another way: the course fits the heading times the factor.
A robot that drives backwards has the opposite course, so that courses are compared modulo a half turn.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import wrap
from sensorgraph.types import Floats

FACTORS = (0.5, 2.0)
"""Factors from the stated heading to the true one."""
MIN_STEP = 0.05
"""[m] Length of the steps whose course is compared, well above the resolution of an odometry."""
MIN_ALIGNED = 0.9
"""Mean resultant length of the differences of course and heading, doubled, from which the robot drives along its heading ..."""
MAX_UNALIGNED = 0.6
"""... and below which it does not: 1 for equal angles, 0 for random ones (Mardia and Jupp 2000)."""


def heading_factor(poses: Floats) -> float:
    """Return the factor from the stated heading to that along which the positions move; 1 if none of `FACTORS` explains them.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] Odometry, its heading without jumps of a full turn.
    """
    if _aligned(poses, 1.0) > MAX_UNALIGNED:
        return 1.0
    return next((factor for factor in FACTORS if _aligned(poses, factor) > MIN_ALIGNED), 1.0)


def with_heading(poses: Floats, factor: float) -> Floats:
    """Return the poses (n, 3) with the heading times a factor, so that the robot drives ahead in most of its steps."""
    out = poses * [1.0, 1.0, factor]
    steps, heading = _steps(out)
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


def _steps(poses: Floats) -> tuple[Floats, Floats]:
    """Return steps (m, 2) [m] of `MIN_STEP` or more, and the mean heading (m,) [rad] during each."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    ends = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], MIN_STEP)))
    chosen = poses[ends]
    return np.diff(chosen[:, :2], axis=0), (chosen[1:, 2] + chosen[:-1, 2]) / 2.0


def _aligned(poses: Floats, factor: float) -> float:
    """Return how well the course fits the heading times a factor, up to a constant: 0 to 1."""
    steps, heading = _steps(poses)
    length = np.hypot(*steps.T)
    if length.sum() < MIN_STEP:
        return 1.0
    off = 2.0 * wrap(np.arctan2(steps[:, 1], steps[:, 0]) - factor * heading)
    return float(np.abs((length * np.exp(1j * off)).sum()) / length.sum())
