"""Warnings for a drive that is too fast for its log: poses per bin, and motion during a scan."""

from __future__ import annotations

import numpy as np

from planners.settings import LOG
from planners.trajectory import Trajectory


def sampling_warnings(
    trajectory: Trajectory, *, cell: float, headings: int, rate: float, sweep_time: float = 0.0
) -> list[str]:
    """Return one line for each limit that the drive exceeds.

    Parameters
    ----------
    cell : [m] Side of a cell.
    rate : [Hz] Rate of the log.
    sweep_time : [s] Duration of one scan.
    """
    twists = trajectory.twists
    v, omega = np.maximum(twists.max(axis=0), -twists.min(axis=0)).tolist()
    width, found = 2 * np.pi / headings, []
    if v > 0 and cell * rate / v < LOG.min_poses:
        found.append(
            f"at {v:.2f} m/s a log of {rate:g} Hz has {_down(cell * rate / v)} poses in a cell of {cell:g} m; for "
            f"{LOG.min_poses:g}, log at {_up(LOG.min_poses * v / cell)} Hz or more, drive at {_down(cell * rate / LOG.min_poses)} m/s or "
            "less, or use larger cells"
        )
    if omega > 0 and width * rate / omega < LOG.min_poses:
        found.append(
            f"at {omega:.2f} rad/s a log of {rate:g} Hz has {_down(width * rate / omega)} poses in a heading bin of "
            f"{np.degrees(width):.3g}°; for {LOG.min_poses:g}, log at {_up(LOG.min_poses * omega / width)} Hz or more, turn at "
            f"{_down(width * rate / LOG.min_poses)} rad/s or less, or use fewer headings"
        )
    if sweep_time * v > cell / 2:
        found.append(
            f"at {v:.2f} m/s the robot drives {sweep_time * v:.2g} m while a scan of {sweep_time:g} s is measured, "
            f"more than half a cell of {cell:g} m; drive at {_down(cell / 2 / sweep_time)} m/s or less, or use "
            "larger cells"
        )
    if sweep_time * omega > width / 2:
        found.append(
            f"at {omega:.2f} rad/s the robot turns {np.degrees(sweep_time * omega):.3g}° while a scan of "
            f"{sweep_time:g} s is measured, more than half a heading bin of {np.degrees(width):.3g}°; turn at "
            f"{_down(width / 2 / sweep_time)} rad/s or less, or use fewer headings"
        )
    return found


def _up(value: float) -> str:
    """Round up to two digits, so that following the advice suffices."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.ceil(value / digit - 1e-9) * digit:.3g}"


def _down(value: float) -> str:
    """Round down to two digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / digit + 1e-9) * digit:.3g}"
