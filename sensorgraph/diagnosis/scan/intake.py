"""What of a run is compared: the sensor as described, tolerances above 0, and the scans of a long run.

The reference has velocities, and an error that varies during a sweep of the laser, its wobble:

    wobble = sqrt(share) noise,   noise = median |Δ² pose| / (0.6745 sqrt(6))
    share = R(0) - (2 / count²) ∫ (count - lag) R(lag) d lag   over lag = 0 … count

Here `count` is the number of reference poses in a sweep. R is the covariance of the interpolated reference error, a cubic B-spline.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.run import RangeSensor, Run
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.errors import SensorgraphError
from sensorgraph.robust import SIGMA_OF_MAD
from sensorgraph.types import Bools, Floats
from sensorgraph.world.described import completed
from sensorgraph.world.ray_order import bearings_text, with_rays_like
from sensorgraph.world.robot import Robot, Tolerances

GOLDEN_RATIO = (1 + np.sqrt(5)) / 2


def described_sensor(run: Run, robot: Robot, *, is_laser_frame: bool) -> RangeSensor:
    """Return the sensor of robot.yaml, with the ray order of the run; values that it does not state are the run's.

    Parameters
    ----------
    is_laser_frame : Whether the poses are those of the laser; its mount is then zero.

    Raises
    ------
    SensorgraphError
        If the run is of another sensor, or the sensor has too few rays or no noise.
    """
    robot = completed(robot, run.sensor)
    if robot.sensor.sigma <= 0:
        raise SensorgraphError(
            "sensor.sigma of robot.yaml is 0; expected the standard deviation [m] of a reading, above 0. Enter the value of "
            "the data sheet, such as sigma: 0.01"
        )
    settings, recorded = SCAN.intake, run.sensor.bearings
    described = with_rays_like(robot.sensor, recorded, tolerance=settings.max_bearing_mismatch)
    if described is None:
        raise SensorgraphError(
            "the rays of the run differ from those of robot.yaml "
            f"({bearings_text(recorded, robot.sensor.bearings)}); pass the robot that recorded it"
        )
    if described.n_rays < settings.min_rays:
        raise SensorgraphError(
            f"the sensor has {described.n_rays} rays; effects can only be distinguished with {settings.min_rays} or more"
        )
    factor, slack = settings.range_max_slack
    returned = np.where(np.isfinite(run.ranges), run.ranges, 0.0)
    beyond = float((returned > factor * described.range_max + slack).mean())
    if beyond > settings.max_share_beyond_range:
        raise SensorgraphError(
            f"{100 * beyond:.0f} % of the readings are beyond sensor.range_max = {described.range_max:g} m of "
            "robot.yaml; pass the robot that recorded the run"
        )
    several = run.sensor.is_composite or described.is_composite
    if (
        several
    ):  # use the sensor poses of the run: its transforms, or those of the robot file it was read with
        described = replace(described, mount=run.sensor.mount, origins=run.sensor.origins)
    if several or run.sensor.cones.any() or described.cones.any():
        described = replace(described, cones=run.sensor.cones)
    mount = np.zeros(3) if is_laser_frame else described.mount
    sigma = max(described.sigma, described.resolution / np.sqrt(12), settings.min_sigma)
    return replace(described, mount=mount, sigma=float(sigma))


def positive_tolerances(tolerances: Tolerances) -> Tolerances:
    """Return tolerances with a positive lower limit."""
    least = SCAN.intake.min_tolerances
    return replace(
        tolerances, **{name: max(getattr(tolerances, name), value) for name, value in vars(least).items()}
    )


def velocities(stamps: Floats, poses: Floats, when: Floats) -> Floats:
    """Return the slope (n, 3) [1/s] of a line fitted to the poses around each of n times."""
    window = SCAN.intake.velocity_window
    low = np.searchsorted(stamps, when - window)
    high = np.searchsorted(stamps, when + window, side="right")
    low = np.minimum(low, np.maximum(high - 2, 0))
    high = np.maximum(high, np.minimum(low + 2, len(stamps)))
    t = stamps - stamps[0]
    sums = [np.concatenate([[0.0], np.cumsum(v)]) for v in (np.ones_like(t), t, t * t)]
    n, s1, s2 = (c[high] - c[low] for c in sums)
    slopes = []
    for column in poses.T:
        c = column - column[0]
        y, ty = (np.concatenate([[0.0], np.cumsum(v)]) for v in (c, t * c))
        sy, sty = y[high] - y[low], ty[high] - ty[low]
        spread = n * s2 - s1 * s1
        slopes.append(
            np.where(spread > 1e-12, (n * sty - s1 * sy) / np.where(spread > 1e-12, spread, 1.0), 0.0)
        )
    return np.stack(slopes, axis=1)


def thinned_out(kept: Bools, n_rays: int) -> tuple[Bools, dict[str, int]]:
    """Keep one in n of the usable scans of a long run; return them, and the number of scans left out.

    One of each n successive scans is kept, at a position that changes by the golden ratio (Weyl 1916). At a
    fixed position, every n-th scan could belong to the same facet of a mirror.
    """
    count = int(kept.sum())
    step = min(-(-count * n_rays // SCAN.intake.max_readings), count // SCAN.intake.min_scans)
    if step <= 1:
        return kept, {}
    some, group = np.zeros_like(kept), np.arange(count // step)
    within = (step * (GOLDEN_RATIO * group % 1.0)).astype(np.intp)
    some[np.flatnonzero(kept)[step * group + within]] = True
    return some, {f"of a long run, of which one in {step} is used": count - int(some.sum())}


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
