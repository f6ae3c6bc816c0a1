"""Interpolate the robot pose to any time of a run, and to the time of each ray of a sweeping laser.

Between neighbouring poses x_i, x_i+1 at times t_i, t_i+1 the motion is a monotone cubic Hermite curve with velocities
m_i = clip((x_i+1 - x_i-1) / (t_i+1 - t_i-1), -most, most). With s_i = (x_i+1 - x_i) / (t_i+1 - t_i), the limit is
most = 3 min(|s_i-1|, |s_i|) where both slopes have the same sign, otherwise 0 (de Boor and Swartz 1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from logs.sensor import PoseFrame, RangeSensor
from logs.transforms import compose, difference, invert, wrap
from logs.types import ROUNDING, Floats, Ints

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

MIN_ODOMETRY = 2
"""Minimum number of odometry poses between two reference poses; with fewer, odometry is not used between them."""

MIN_JUDGED = 8
"""Minimum number of reference poses for comparing odometry with interpolation; with fewer, odometry is used."""

SAME_STAMP = ROUNDING
"""[s] closer stamps count as equal: their difference is rounding and defines no velocity."""


class Recorded(Protocol):
    """What this module needs of `logs.run.Run`, which describes the fields."""

    @property
    def sensor(self) -> RangeSensor: ...
    @property
    def stamps(self) -> Floats: ...
    @property
    def ranges(self) -> Floats: ...
    @property
    def pose_stamps(self) -> Floats: ...
    @property
    def poses(self) -> Floats: ...
    @property
    def pose_frame(self) -> PoseFrame: ...
    @property
    def odom_stamps(self) -> Floats: ...
    @property
    def odometry(self) -> Floats: ...


class Paired(Protocol):
    """What this module needs of `logs.run.Pairing`."""

    @property
    def poses(self) -> Floats: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A trajectory in map with a continuous velocity: monotone cubics between neighbouring poses.

    Each coordinate stays between those of the two neighbours, so bursts of stamps cause no overshoot.
    """

    stamps: Floats
    """(n,) [s] not decreasing."""
    poses: Floats
    """(n, 3) [m, m, rad] of the run's `pose_frame` in map; phi is unwrapped."""

    def at(self, times: Floats) -> Floats:
        """Return the poses (..., 3) at times (...) [s].

        Outside the trajectory, the motion of its first or last step continues for one median step, as the rays of the
        last scan need; then the pose stays.
        """
        if self._curve is None:
            return np.broadcast_to(self.poses[-1], (*np.shape(times), 3)).copy()
        first, last = self._curve.x[0], self._curve.x[-1]
        step = float(np.median(np.diff(self._curve.x)))
        inside = np.clip(times, first, last)
        found: Floats = self._curve(inside)
        beyond = np.clip(times, first - step, last + step) - inside
        if beyond.any():
            found = 2 * found - self._curve(np.where(beyond != 0, inside - beyond, inside))
        return found

    @cached_property
    def _curve(self) -> CubicHermiteSpline | None:
        """The cubics; of several poses with one stamp, the last counts. None if all poses have the same stamp."""
        from scipy.interpolate import CubicHermiteSpline  # slow to import, and not needed for unswept scans

        last = np.append(np.diff(self.stamps) > SAME_STAMP, True)
        stamps, poses = self.stamps[last], self.poses[last]
        return CubicHermiteSpline(stamps, poses, _velocities(stamps, poses)) if len(stamps) > 1 else None


def _velocities(stamps: Floats, poses: Floats) -> Floats:
    """Return the velocities (n, 3) at the poses: central differences, limited so that the cubics stay monotone.

    A difference over two steps is the least sensitive to jitter of the stamps. If both steps have the same sign, the
    limit is three times the slower one (de Boor and Swartz 1977). Otherwise the motion reverses and the velocity is 0.
    """
    step = np.diff(stamps)[:, None]
    slope = np.diff(poses, axis=0) / step
    if len(slope) == 1:
        return np.repeat(slope, 2, axis=0)
    before, after = slope[:-1], slope[1:]
    inner = (poses[2:] - poses[:-2]) / (stamps[2:] - stamps[:-2])[:, None]
    most = np.where(before * after > 0, 3 * np.minimum(np.abs(before), np.abs(after)), 0.0)
    return np.concatenate([slope[:1], np.clip(inner, -most, most), slope[-1:]])


def motion_of(run: Recorded, *, use_odometry: bool = True) -> Motion:
    """Return the motion from the reference poses, with odometry between reference poses at a low rate.

    Odometry is used where at least `MIN_ODOMETRY` odometry poses lie between two reference poses. Its mismatch at the
    second reference pose is distributed linearly over the time between them. Odometry is used only if it predicts every
    second reference pose better than interpolation does, as coarse encoders are less accurate than a fast camera.
    Poses that are not finite are ignored.

    Raises
    ------
    ValueError : If the run has no finite reference pose.
    """
    finite = np.isfinite(run.poses).all(axis=1)
    stamps, poses = run.pose_stamps[finite], run.poses[finite]
    if len(stamps) == 0:
        raise ValueError("the run has no finite reference pose, expected at least one; locate the run first")
    between = _between_references(run, stamps, poses) if use_odometry else None
    if between is not None:
        order = np.argsort(np.concatenate([stamps, between.stamps]), kind="stable")
        stamps = np.concatenate([stamps, between.stamps])[order]
        poses = np.concatenate([poses, between.poses])[order]
    return Motion(stamps=stamps, poses=_unwrapped(poses))


def ray_poses(run: Recorded, pairing: Paired, scans: Ints, *, motion: Motion | None = None) -> Floats:
    """Return the poses from which the rays of some scans are taken.

    Parameters
    ----------
    pairing : Pairing of the run.
    scans : (n,) indices of paired scans.
    motion : Motion of the run; None: `motion_of(run)`.

    Returns
    -------
    (n, n_rays, 3) [m, m, rad] pose of `pose_frame` in map at the time of each ray.
    For several sensors read as one, each pose is moved to the origin of its ray.
    A single sensor without ray delays gives (n, 1, 3): one pose for all rays of a scan.
    """
    if not run.sensor.has_ray_delays:
        return to_ray_starts(pairing.poses[scans][:, None], run.sensor, run.pose_frame)
    if len(scans) == 0:  # there may be no reference pose
        return np.zeros((0, run.sensor.n_rays, 3))
    motion = motion_of(run) if motion is None else motion
    poses = motion.at(run.stamps[scans][:, None] + run.sensor.ray_delays)
    poses[..., 2] = wrap(poses[..., 2])
    return to_ray_starts(poses, run.sensor, run.pose_frame)


def to_ray_starts(poses: Floats, sensor: RangeSensor, frame: PoseFrame) -> Floats:
    """Move poses (n, n_rays or 1, 3) of a frame so that its laser is at the origin of each ray of several sensors.

    Returns (n, n_rays, 3), or the unchanged poses if all rays start at one point.
    """
    if not sensor.is_composite:
        return poses
    phi = poses[..., 2] + (0.0 if frame == "laser" else sensor.mount[2])
    cos, sin = np.cos(phi), np.sin(phi)
    x, y = sensor.origins.T
    moved = (poses[..., 0] + cos * x - sin * y, poses[..., 1] + sin * x + cos * y)
    return np.stack([*moved, np.broadcast_to(poses[..., 2], moved[0].shape)], axis=-1)


def _unwrapped(poses: Floats) -> Floats:
    """Return poses (n, 3) with unwrapped headings [rad]."""
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])


def _between_references(run: Recorded, stamps: Floats, poses: Floats) -> Motion | None:
    """Return the odometry poses between reference poses, transformed to map; None if odometry is not used."""
    known = np.isfinite(run.odometry).all(axis=1)
    when, odometry = run.odom_stamps[known], run.odometry[known]
    if len(when) < MIN_ODOMETRY or len(stamps) < 2:
        return None
    if run.pose_frame == "laser":
        odometry = compose(odometry, run.sensor.mount)
    odometry = _unwrapped(odometry)
    there = Motion(stamps=when, poses=odometry).at(stamps)  # odometry at the reference poses
    right = np.searchsorted(stamps, when, side="left")
    left = right - 1
    inside = (left >= 0) & (right < len(stamps))
    left, right = np.where(inside, left, 0), np.where(inside, right, 1)
    inside &= (when < stamps[right]) & (stamps[left] >= when[0]) & (stamps[right] <= when[-1])
    count = np.bincount(left[inside], minlength=len(stamps))
    inside &= count[left] >= MIN_ODOMETRY
    if not inside.any() or not _odometry_is_better(stamps, poses, there):
        return None
    left, right, when, odometry = left[inside], right[inside], when[inside], odometry[inside]
    share = (when - stamps[left]) / (stamps[right] - stamps[left])
    found = _between(poses[left], poses[right], there[left], odometry, there[right], share)
    return Motion(stamps=when, poses=found)


def _between(first: Floats, last: Floats, begin: Floats, now: Floats, end: Floats, share: Floats) -> Floats:
    """Return poses (n, 3) between two reference poses: first ∘ begin⁻¹ ∘ now + share * mismatch.

    The mismatch of odometry at the second reference pose is last - first ∘ begin⁻¹ ∘ end.

    Parameters
    ----------
    first, last : (n, 3) reference poses in map
    begin, now, end : (n, 3) odometry at the first reference pose, in between, and at the last one
    share : (n,) elapsed share of the time between the two reference poses
    """
    mismatch = difference(last, compose(first, compose(invert(begin), end)))
    return np.asarray(compose(first, compose(invert(begin), now)) + share[:, None] * mismatch)


def _odometry_is_better(stamps: Floats, poses: Floats, odometry: Floats) -> bool:
    """Return whether odometry (n, 3) predicts every second reference pose better than interpolation does.

    The criterion is the sum of squared errors of x, y and phi. One radian counts as one metre, which is the shift of
    a reading at 1 m range.
    """
    first, middle, last = (slice(k, len(stamps) - 2 + k, 2) for k in range(3))
    if len(stamps[middle]) < MIN_JUDGED:
        return True
    share = (stamps[middle] - stamps[first]) / np.maximum(stamps[last] - stamps[first], SAME_STAMP)
    by_odometry = _between(
        poses[first], poses[last], odometry[first], odometry[middle], odometry[last], share
    )
    interpolated = Motion(stamps=stamps[::2], poses=_unwrapped(poses)[::2]).at(stamps[middle])

    def squared_error(predicted: Floats) -> float:
        return float(np.square(difference(predicted, poses[middle])).sum())

    return squared_error(by_odometry) < squared_error(interpolated)
