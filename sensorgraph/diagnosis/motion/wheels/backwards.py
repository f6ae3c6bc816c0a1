"""Odometry that counts backwards: its distance, its turns, both, or one of its wheels.

With the wheels l and r, distance (l + r) / 2 and turn (r - l) / b, a left wheel that counts backwards exchanges distance
and turn; a right one does it with the opposite sign.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.wheels.signals import MotionSignals
from sensorgraph.types import Floats

WINDOW = 1.0
"""[s] Duration of the motions that are compared; long against the offset of a usual clock."""
MIN_WINDOWS = 10
"""Minimum number of windows for a statement."""
CERTAIN = 0.8
"""Correlation above which two motions are the same, and below minus which they are opposite."""
NONE = 0.5
"""Correlation below which two motions are different."""


def counts_backwards(signals: MotionSignals) -> str:
    """Return what of the odometry counts backwards, relative to the reference poses; empty if nothing does."""
    wheels, poses = signals.wheels, signals.poses
    first, last = max(wheels.start[0], signals.stamps[0]), min(wheels.end[-1], signals.stamps[-1])
    edges = np.arange(first, last, WINDOW)
    if len(edges) <= MIN_WINDOWS:
        return ""
    ends = np.append(wheels.start, wheels.end[-1])
    counted = [
        np.diff(np.interp(edges, ends, np.append(0.0, np.cumsum(part))))
        for part in (wheels.distance, wheels.turn)
    ]
    heading = np.unwrap(poses[:, 2])
    steps, middle = np.diff(poses[:, :2], axis=0), (heading[1:] + heading[:-1]) / 2
    ahead = np.append(0.0, np.cumsum(steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle)))
    seen = [np.diff(np.interp(edges, signals.stamps, part)) for part in (ahead, heading)]
    (way, cross), (other, turn) = ([_correlation(a, b) for b in counted] for a in seen)
    parts = [name for name, r in (("distance", way), ("turns", turn)) if r < -CERTAIN]
    if parts:
        found = " and ".join(parts)
        askew = ", or the reference poses look backwards" if parts == ["distance"] else ""
        swapped = " (left and right wheel exchanged)" if parts == ["turns"] else ""
        return f"the odometry counts its {found} backwards{swapped}{askew}"
    if max(abs(way), abs(turn)) < NONE and min(abs(cross), abs(other)) > CERTAIN and cross * other > 0:
        return f"the {'left' if cross > 0 else 'right'} wheel of the odometry counts backwards"
    return ""


def _correlation(a: Floats, b: Floats) -> float:
    """Return the correlation of two signals about zero; 0 if one of them does not move."""
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
