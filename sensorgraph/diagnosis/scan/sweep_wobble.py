"""Reference error that varies during a sweep of the laser: its size, and its effect on readings.

    wobble = sqrt(share) noise,   noise = median |Δ² pose| / (0.6745 sqrt(6))
    share = R(0) - (2 / count²) ∫ (count - lag) R(lag) d lag   over lag = 0 … count

Here `count` is the number of reference poses in a sweep. R is the covariance of the interpolated reference
error, a cubic B-spline.
"""

from __future__ import annotations

import numpy as np

from logs.run import RangeSensor, Run
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.robust import SIGMA_OF_MAD
from sensorgraph.types import Floats
from sensorgraph.world.robot import Tolerances


def estimated_wobble(run: Run, sensor: RangeSensor, tolerances: Tolerances) -> tuple[float, float]:
    """Estimate the standard deviation of the reference error within a sweep [m, rad].

        noise = 1.4826 median |Δ² pose| / sqrt(6),   wobble = sqrt(share) noise

    Second differences of the poses contain six times the variance of noise that is independent in every pose,
    and hardly any motion. They contain less of correlated noise, and so do sweeps. The median excludes starts and
    stops. If poses are rare, second differences also contain the turning of the robot; the noise is therefore
    limited to the specified tolerance.
    """
    poses = run.poses[np.isfinite(run.poses).all(axis=1)]
    share = share_within(references_in_sweep(run, sensor))
    if share <= 0.0:
        return 0.0, 0.0
    unwrapped = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    bent = np.abs(np.diff(unwrapped, n=2, axis=0))
    noise = SIGMA_OF_MAD * np.median(bent, axis=0) / np.sqrt(6.0)
    x, y, phi = np.minimum(noise, [tolerances.pose_xy, tolerances.pose_xy, tolerances.pose_yaw])
    return float(np.sqrt(share) * max(x, y)), float(np.sqrt(share) * phi)


def references_in_sweep(run: Run, sensor: RangeSensor) -> float:
    """Return the duration of a sweep over the interval between references; 0 without a sweep, or with too few references."""
    stamps = run.pose_stamps[np.isfinite(run.poses).all(axis=1)]
    if sensor.scan_duration == 0 or len(stamps) < SCAN.intake.min_scans:
        return 0.0
    return float(sensor.scan_duration / max(float(np.median(np.diff(stamps))), 1e-6))


def share_within(count: float) -> float:
    """Return the share of the reference variance that varies within a sweep of `count` reference intervals.

        share = R(0) - (2 / count²) ∫ (count - lag) R(lag) d lag   over lag = 0 … count

    Errors that are independent in every pose and interpolated between poses have the covariance R of a cubic
    B-spline at a random time: R(0) = 2/3, and R = 0 above a lag of two poses. The second term is the mean of
    R over all pairs of times of the sweep. It is the part that all rays share, which belongs to the pose
    error.
    """
    if count <= 0:
        return 0.0
    near, beyond = min(count, 1.0), min(max(count - 1, 0.0), 1.0)
    # the integral of (count - lag) R(lag), in pieces: 0 to 1, 1 to 2, and beyond
    pairs = near**2 / 3 - near**4 / 12 + near**5 / 40
    pairs += 11 / 24 * beyond + ((1 - beyond) ** 5 - 1) / 120 + beyond / 24
    pairs += 1 / 2 * max(count - 2, 0.0)
    return 2 / 3 - 2 * pairs / count**2


def wobble_of_readings(wobble: tuple[float, float], pose: Floats) -> Floats:
    """Return the standard deviation (n_scans, n_rays) [m] of readings from the reference error within a sweep.

    Parameters
    ----------
    wobble : [m, rad] standard deviation of the error, along each axis and in heading
    pose : (n_scans, 3, n_rays) derivatives of the readings by x, y, phi; the common part of a scan is its pose error
    """
    if not any(wobble):
        return np.zeros(pose[:, 0].shape)
    xy, yaw = wobble
    return np.asarray(np.hypot(xy * np.hypot(pose[:, 0], pose[:, 1]), yaw * pose[:, 2]))
