"""Deviations of poses of a laser that sweeps slowly, where only its scans measure the motion during a sweep.

A pose is that at the first ray. The scans determine where a sweep was as a whole, and the motion during it follows from the scans
before and after. If their velocities differ by d, the velocity during a sweep of the duration T is uncertain by d, and so is the
pose at its first ray, T / 2 from its middle, by d T / 2.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.scan_track import turn_matrices
from sensorgraph.types import Floats


def with_sweep_motion(covariances: Floats, stamps: Floats, poses: Floats, duration: float) -> Floats:
    """Return the covariances (n_scans, 3, 3) of x, y, phi in map with those of the unknown motion during a sweep.

    Parameters
    ----------
    stamps, poses : (n_scans,) [s], (n_scans, 3) [m, m, rad]
    duration : [s] Of a sweep.
    """
    if duration <= 0.0 or len(poses) < 3:
        return covariances
    took = np.diff(stamps)
    steps = compose(invert(poses[:-1]), poses[1:])
    steps[:, 2] = wrap(steps[:, 2])
    steps[took > 0] /= took[took > 0, None]
    steps[took <= 0] = 0.0
    change = np.zeros_like(poses)
    change[1:-1] = np.abs(np.diff(steps, axis=0))
    change[0], change[-1] = change[1], change[-2]
    turn = turn_matrices(poses[:, 2])
    square = (0.5 * duration * change) ** 2
    return np.asarray(covariances + (turn * square[:, None, :]) @ turn.transpose(0, 2, 1))
