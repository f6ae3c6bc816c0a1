"""Poses with the same stamp as a scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from logs.types import Floats


def twins(stamps: Floats, pose_stamps: Floats) -> NDArray[np.intp]:
    """Return the index (n_scans,) of the pose with the same stamp as each scan, or -1.

    If as many poses as scans share one stamp, the k-th pose belongs to the k-th scan. Otherwise there is no such pose.
    """
    first = np.searchsorted(pose_stamps, stamps, side="left")
    n_poses = np.searchsorted(pose_stamps, stamps, side="right") - first
    before = np.searchsorted(stamps, stamps, side="left")
    n_scans = np.searchsorted(stamps, stamps, side="right") - before
    rank = np.arange(len(stamps)) - before
    return np.where(n_poses == n_scans, first + rank, -1)
