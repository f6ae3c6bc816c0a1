"""Treat poses that were located with the same scans, and thus absorb errors that move a scan as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.likely_poses import at_likely_poses
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.world.robot import Tolerances


def freed_of_scans(data: ScanData, noise_bounds: NoiseBounds) -> ScanData:
    """Return located scans with pose tolerances that cover the shift that an effect may have caused.

    Poses that were located with a range bias of 2 cm fit best with that bias. As an independent reference
    they would contradict the bias, and a mount error that compensates it would be named instead. Mount and
    delay move all poses and are therefore not estimated. If the laser is off its poses by more than
    `located_pose` in the median, the poses do not come from these scans. The data are then returned
    unchanged.
    """
    free = replace(data, from_scans=True, tolerances=freed_tolerances(data.tolerances), memo={})
    errors = at_likely_poses(free, noise_bounds).pose_start
    c, s = np.cos(data.poses[:, 2]), np.sin(data.poses[:, 2])
    ahead, aside = c * errors[:, 0] + s * errors[:, 1], c * errors[:, 1] - s * errors[:, 0]
    (xy, yaw), t = SCAN.intake.located_pose, data.tolerances
    off = np.abs([np.median(ahead), np.median(aside), np.median(errors[:, 2])])
    may_be_off = [max(t.pose_xy, xy), max(t.pose_xy, xy), max(t.pose_yaw, yaw)]
    return data if (off > may_be_off).any() else free


def freed_tolerances(told: Tolerances) -> Tolerances:
    """Return tolerances that allow the shift that an effect may have caused in located poses."""
    xy, yaw = np.array(SCAN.intake.located_pose) * SCAN.intake.located_freedom
    return replace(told, pose_xy=max(told.pose_xy, xy), pose_yaw=max(told.pose_yaw, yaw))
