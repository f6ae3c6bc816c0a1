"""Poses that were found from these very scans in this map: they have taken along what moves a scan as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.likely_poses import at_likely_poses
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.world.robot import Tolerances


def freed_of_scans(data: ScanData, noise_bounds: NoiseBounds) -> ScanData:
    """Return located scans with poses that are free by as much as an effect may have pulled them.

    Scans that were located with a bias of 2 cm have poses that fit best with it; as a reference of its own, they would contradict
    the bias, and a mount would be named that brings them back. So the mount and the delay are not looked for, which move
    all poses. Where the laser of all scans is off its poses by more than that, they are not those of these scans.
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
    """Return tolerances whose poses may be off by what an effect has pulled them."""
    xy, yaw = np.array(SCAN.intake.located_pose) * SCAN.intake.located_freedom
    return replace(told, pose_xy=max(told.pose_xy, xy), pose_yaw=max(told.pose_yaw, yaw))
