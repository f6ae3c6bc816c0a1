"""The error of a reference that varies while the laser sweeps: its size, what readings have of it, and how it is drawn."""

from __future__ import annotations

import numpy as np

from logs.run import RangeSensor, Run
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats
from sensorgraph.world.robot import Tolerances

MIN_SHARE = 0.01
"""Of the reference's variance, that varies within a sweep; less is less than a tenth of the error of a pose, and none."""
MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a standard normal."""


def estimated_wobble(run: Run, sensor: RangeSensor, tolerances: Tolerances) -> tuple[float, float]:
    """Estimate how much the error of the reference varies within a sweep [m, rad].

    Second differences of the poses hold six times the variance of noise that is new in every pose, and hardly any of the
    motion; of noise that lasts they hold less, as do sweeps. Their median leaves out where the robot starts and stops. Where
    poses are rare they hold its turning, too: the noise is no more than stated.
    """
    poses = run.poses[np.isfinite(run.poses).all(axis=1)]
    share = share_within(references_in_sweep(run, sensor))
    if share < MIN_SHARE:
        return 0.0, 0.0
    unwrapped = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    bent = np.abs(np.diff(unwrapped, n=2, axis=0))
    noise = np.median(bent, axis=0) / (MEDIAN_OF_NORMAL * np.sqrt(6.0))
    x, y, phi = np.minimum(noise, [tolerances.pose_xy, tolerances.pose_xy, tolerances.pose_yaw])
    return float(np.sqrt(share) * max(x, y)), float(np.sqrt(share) * phi)


def references_in_sweep(run: Run, sensor: RangeSensor) -> float:
    """Return the time from the first ray to the last over that between references; 0: no sweep, or too few references."""
    stamps = run.pose_stamps[np.isfinite(run.poses).all(axis=1)]
    if sensor.scan_duration == 0 or len(stamps) < SCAN.intake.min_scans:
        return 0.0
    return float(sensor.scan_duration / max(float(np.median(np.diff(stamps))), 1e-6))


def share_within(count: float) -> float:
    """Return the share of a reference's variance that varies within a sweep that takes as long as so many references.

    Errors that are new in every pose and interpolated between poses have, at a random time, the covariance R of a cubic
    B-spline: 2/3, and 0 from two poses on. What is common to the sweep is no wobble, which leaves 2/3 less the mean of R
    over all pairs of times of the sweep.
    """
    if count <= 0:
        return 0.0
    near, beyond = min(count, 1.0), min(max(count - 1, 0.0), 1.0)
    # twice integrated, from 0 to 1, to 2, and beyond: the sum of (count - lag) R(lag)
    pairs = near**2 / 3 - near**4 / 12 + near**5 / 40
    pairs += 11 / 24 * beyond + ((1 - beyond) ** 5 - 1) / 120 + beyond / 24
    pairs += 1 / 2 * max(count - 2, 0.0)
    return 2 / 3 - 2 * pairs / count**2


def wobble_of_readings(wobble: tuple[float, float], pose: Floats) -> Floats:
    """Return the standard deviation (n_scans, n_rays) [m] of readings by what the reference's error varies within a sweep.

    Parameters
    ----------
    wobble : [m, rad] standard deviation of the error, along each axis and in heading
    pose : (n_scans, 3, n_rays) derivatives of the readings by x, y, phi; one pose error per scan holds what is common to its rays
    """
    if not any(wobble):
        return np.zeros(pose[:, 0].shape)
    xy, yaw = wobble
    spread = np.hypot(xy * np.hypot(pose[:, 0], pose[:, 1]), yaw * pose[:, 2])
    return np.minimum(spread, SCAN.nuisance.max_grazing_sigma)


def drawn_wobble(
    wobble: tuple[float, float], count: float, when: Floats, pose: Floats, rng: np.random.Generator
) -> Floats:
    """Draw by what readings (n_scans, n_rays) are off [m] while the reference's error varies: neighbouring rays share it.

    Between two references the error is interpolated, as the poses are. The mean of a scan is its pose error.

    Parameters
    ----------
    wobble : [m, rad] standard deviation of the error, along each axis and in heading
    count : references in a sweep
    when : (n_rays,) 0 to 1, of the time from the first ray to the last
    pose : (n_scans, 3, n_rays) derivatives of the readings by x, y, phi
    """
    sizes = np.array(wobble)[[0, 0, 1]] / np.sqrt(share_within(count))
    known = sizes[:, None] * rng.normal(size=(len(pose), 3, int(count) + 3))
    at = rng.random((len(pose), 1)) + count * when
    before, part = at.astype(np.intp)[:, None, :], (at % 1)[:, None, :]
    error = np.take_along_axis(known, before, axis=2) * (1 - part)
    error += np.take_along_axis(known, before + 1, axis=2) * part
    error -= error.mean(axis=2, keepdims=True)
    return np.asarray(np.einsum("nkm,nkm->nm", pose, error))
