"""Most likely poses of a run whose reference is inaccurate, or that its own scans located; its casts are made there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners.arena import wrap
from sensorgraph.diagnosis.scan.cast_place import errors_of_laser
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.types import Bools
from sensorgraph.world.ray_order import neighbouring_rays
from sensorgraph.world.robot import Tolerances


def at_likely_poses(data: ScanData, noise_bounds: NoiseBounds, *, even_rays: bool = False) -> ScanData:
    """Return scans that are cast at the poses of a fit without effects, if the reference is wide.

    Parameters
    ----------
    even_rays : Whether the poses are estimated only from every other ray, so that the others can test them.
    """
    if not is_reference_wide(data):
        return data
    data = data.posed_by(np.zeros((data.n_scans, 3)))
    odd = np.arange(data.n_rays) % 2 == 1
    seen = data
    if even_rays:
        seen = replace(data, ranges=np.where(odd, np.nan, data.ranges), memo={})
    state = start_state(seen, noise_bounds)
    got = fit(seen, (), state, noise_bounds)
    return data.posed_by(errors_of_laser(data, got.state))


def is_reference_wide(data: ScanData) -> bool:
    """Return whether the typical pose error exceeds the noise of a reading, or the spacing of the rays.

    In this case other rays meet the outlines than at the reference poses.
    """
    t, far = data.tolerances, data.ranges[data.returned]
    if not len(far):
        return False
    usual, (right, left) = float(np.median(far)), neighbouring_rays(data.sensor)
    apart = wrap(data.sensor.bearings[left] - data.sensor.bearings[right])
    to_the_next = usual * float(np.median(apart)) if len(apart) else np.inf
    return bool(np.hypot(t.pose_xy, t.pose_yaw * usual) > min(data.sensor.sigma, to_the_next))


def fitted_and_held_out(data: ScanData, held: Bools, noise_bounds: NoiseBounds) -> tuple[ScanData, ScanData]:
    """Split scans into those for fits and the held-out ones (n_scans,), each at its most likely poses."""
    return (
        at_likely_poses(data.subset(~held), noise_bounds),
        at_likely_poses(data.subset(held), noise_bounds, even_rays=True),
    )


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
