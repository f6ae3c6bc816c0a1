"""Most likely poses of a run whose reference is inaccurate, or that its own scans located; its casts are made there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners.arena import wrap
from sensorgraph.diagnosis.scan.fit import bare_fit
from sensorgraph.diagnosis.scan.nuisance import as_pose_errors, errors_of_laser
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects.nuisance import POSE_LIKE
from sensorgraph.types import Bools, Floats
from sensorgraph.world.ray_order import neighbouring_rays
from sensorgraph.world.robot import Tolerances


def at_likely_poses(data: ScanData, noise_bounds: NoiseBounds, *, even_rays: bool = False) -> ScanData:
    """Return scans that are cast at the poses of a fit without effects, if the reference is wide, or proves to be.

    Parameters
    ----------
    even_rays : Whether the poses are estimated only from every other ray, so that the others can test them.
    """
    return _cast_there(data, noise_bounds, even_rays) if _proves_wide(data, noise_bounds) else data


def _cast_there(data: ScanData, noise_bounds: NoiseBounds, even_rays: bool) -> ScanData:
    data = data.posed_by(np.zeros((data.n_scans, 3)))
    odd = np.arange(data.n_rays) % 2 == 1
    seen = data
    if even_rays:
        seen = replace(data, ranges=np.where(odd, np.nan, data.ranges), memo={})
    got = bare_fit(seen, noise_bounds)
    return data.posed_by(errors_of_laser(data, got.state))


def _proves_wide(data: ScanData, noise_bounds: NoiseBounds) -> bool:
    """Return whether the reference is wide, as stated, or by the mount error and the delay that poses absorb in a fit without effects."""
    if is_reference_wide(data):
        return True
    errors = errors_of_laser(data, bare_fit(data, noise_bounds).state)
    x, y, yaw = np.sqrt(np.mean(_of_mount_and_delay(data, errors) ** 2, axis=0))
    return _is_wide(data, np.hypot(x, y), yaw)


def _of_mount_and_delay(data: ScanData, errors: Floats) -> Floats:
    """Return the part of pose errors (n_scans, 3) that one mount error and one delay of all scans explain."""
    columns = np.stack([as_pose_errors(data, unit) for unit in np.eye(len(POSE_LIKE))], axis=-1)
    t = data.tolerances
    weight = 1 / np.array([t.pose_xy, t.pose_xy, t.pose_yaw])
    rows = (weight[:, None] * columns).reshape(-1, len(POSE_LIKE))
    return np.asarray(columns @ np.linalg.lstsq(rows, (weight * errors).ravel(), rcond=None)[0])


def is_reference_wide(data: ScanData) -> bool:
    """Return whether the pose error that robot.yaml states exceeds the noise of a reading, or the spacing of the rays.

    In this case other rays meet the outlines than at the reference poses.
    """
    return _is_wide(data, data.tolerances.pose_xy, data.tolerances.pose_yaw)


def _is_wide(data: ScanData, xy: float, yaw: float) -> bool:
    far = data.ranges[data.returned]
    if not len(far):
        return False
    usual, (right, left) = float(np.median(far)), neighbouring_rays(data.sensor)
    apart = wrap(data.sensor.bearings[left] - data.sensor.bearings[right])
    to_the_next = usual * float(np.median(apart)) if len(apart) else np.inf
    return bool(np.hypot(xy, yaw * usual) > min(data.sensor.sigma, to_the_next))


def fitted_and_held_out(data: ScanData, held: Bools, noise_bounds: NoiseBounds) -> tuple[ScanData, ScanData]:
    """Split scans into those for fits and the held-out ones (n_scans,), both at their most likely poses or both not."""
    train, unseen = data.subset(~held), data.subset(held)
    if not _proves_wide(train, noise_bounds):
        return train, unseen
    return _cast_there(train, noise_bounds, False), _cast_there(unseen, noise_bounds, True)


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
