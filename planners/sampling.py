"""Whether a log can serve the bins: how often a bin is logged as the robot passes, and how far a scan smears."""

from __future__ import annotations

import numpy as np

from planners.trajectory import Trajectory

LEAST = 2.0
"""Logged poses that each passage through a bin should have."""


def warnings(
    trajectory: Trajectory, *, cell: float, headings: int, rate: float, sweep_time: float = 0.0
) -> list[str]:
    """Return a line for each way in which the drive is too fast for its log.

    Parameters
    ----------
    cell : [m]
    rate : [Hz] of the log
    sweep_time : [s] that one entry of the log takes to measure
    """
    v, omega = (float(most) for most in abs(trajectory.twists).max(axis=0))
    width, found = 2 * np.pi / headings, []
    if v > 0 and cell * rate / v < LEAST:
        found.append(
            f"at {v:.2f} m/s a log of {rate:g} Hz has {cell * rate / v:.1f} poses in a cell of {cell:g} m; for "
            f"{LEAST:g}, log at {LEAST * v / cell:.2g} Hz or more, or drive at {cell * rate / LEAST:.2g} m/s or less"
        )
    if omega > 0 and width * rate / omega < LEAST:
        found.append(
            f"at {omega:.2f} rad/s a log of {rate:g} Hz has {width * rate / omega:.1f} poses in a heading bin of "
            f"{np.degrees(width):.3g}°; for {LEAST:g}, log at {LEAST * omega / width:.2g} Hz or more, or turn at "
            f"{width * rate / LEAST:.2g} rad/s or less"
        )
    if sweep_time * omega > width / 2:
        found.append(
            f"at {omega:.2f} rad/s the robot turns {np.degrees(sweep_time * omega):.3g}° while a scan of "
            f"{sweep_time:g} s is measured, more than half a heading bin of {np.degrees(width):.3g}°; turn at "
            f"{width / 2 / sweep_time:.2g} rad/s or less, or use fewer headings"
        )
    return found
