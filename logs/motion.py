"""Where the robot was at any time of a run, and so where each ray of a sweeping laser was taken."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from logs.run import Pairing, PoseFrame, RangeSensor, Run
from logs.transforms import compose, invert, wrap
from logs.types import Floats, Ints

MIN_ODOMETRY = 2
"""Odometry poses between two references, from which on the odometry says how the robot moved between them."""

MIN_JUDGED = 8
"""References by which odometry is held against interpolation; with fewer it is believed."""

SAME_STAMP = 1e-6
"""[s] Stamps nearer than this are one: rounding, between which there is no velocity."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A track of poses in map, with a steady velocity: monotone cubics between neighbours.

    These never leave the box of two neighbours, so that stamps in bursts do not throw the robot about.
    """

    stamps: Floats
    """(n,) [s] not decreasing."""
    poses: Floats
    """(n, 3) [m, m, rad] of the run's `pose_frame` in map; phi is unwrapped."""

    def at(self, times: Floats) -> Floats:
        """Return the poses (..., 3) at times (...) [s]; before the first and after the last, these."""
        if self._curve is None:
            return np.broadcast_to(self.poses[-1], (*np.shape(times), 3)).copy()
        found: Floats = self._curve(np.clip(times, self._curve.x[0], self._curve.x[-1]))
        return found

    @cached_property
    def _curve(self) -> CubicHermiteSpline | None:
        """The cubics, through the last of poses that share a stamp; None: all share one."""
        last = np.append(np.diff(self.stamps) > SAME_STAMP, True)
        stamps, poses = self.stamps[last], self.poses[last]
        return CubicHermiteSpline(stamps, poses, _velocities(stamps, poses)) if len(stamps) > 1 else None


def _velocities(stamps: Floats, poses: Floats) -> Floats:
    """Return velocities (n, 3) at poses: from the one before to the one after, as far as cubics stay monotone with them.

    Over both steps stamps that jitter weigh least. Where both go the same way, three times the slower one is the limit
    (de Boor and Swartz 1977); else the robot turns round.
    """
    step = np.diff(stamps)[:, None]
    slope = np.diff(poses, axis=0) / step
    if len(slope) == 1:
        return np.repeat(slope, 2, axis=0)
    before, after = slope[:-1], slope[1:]
    inner = (poses[2:] - poses[:-2]) / (stamps[2:] - stamps[:-2])[:, None]
    most = np.where(before * after > 0, 3 * np.minimum(np.abs(before), np.abs(after)), 0.0)
    return np.concatenate([slope[:1], np.clip(inner, -most, most), slope[-1:]])


def motion_of(run: Run, *, use_odometry: bool = True) -> Motion:
    """Return the motion by the reference poses, and by the odometry between references that are slow.

    Where `MIN_ODOMETRY` odometry poses or more lie between two references, the robot moved as they say; the
    difference to the second reference is spread evenly over the time between. That is so where odometry tells every other
    reference better than its neighbours do: coarse encoders tell less than a fast camera. Poses that are not finite are left
    out.

    Raises
    ------
    ValueError : the run has no finite reference pose
    """
    finite = np.isfinite(run.poses).all(axis=1)
    stamps, poses = run.pose_stamps[finite], run.poses[finite]
    if len(stamps) == 0:
        raise ValueError("the run has no reference pose")
    between = _between_references(run, stamps, poses) if use_odometry else None
    if between is not None:
        order = np.argsort(np.concatenate([stamps, between.stamps]), kind="stable")
        stamps = np.concatenate([stamps, between.stamps])[order]
        poses = np.concatenate([poses, between.poses])[order]
    return Motion(stamps=stamps, poses=_unwrapped(poses))


def ray_poses(run: Run, pairing: Pairing, scans: Ints, *, motion: Motion | None = None) -> Floats:
    """Return where the rays of some scans were taken.

    Parameters
    ----------
    pairing : of the run
    scans : (n,) indices of paired scans
    motion : of the run, where it is at hand; None: `motion_of(run)`

    Returns
    -------
    (n, n_rays, 3) [m, m, rad] pose of the run's `pose_frame` in map at the time of each ray of a sweep, moved to where
    the ray starts if several sensors are read as one; without either (n, 1, 3), one for all rays of a scan
    """
    if not run.sensor.has_ray_delays:
        return to_ray_starts(pairing.poses[scans][:, None], run.sensor, run.pose_frame)
    if len(scans) == 0:  # perhaps not one reference pose
        return np.zeros((0, run.sensor.n_rays, 3))
    motion = motion_of(run) if motion is None else motion
    poses = motion.at(run.stamps[scans][:, None] + run.sensor.ray_delays)
    poses[..., 2] = wrap(poses[..., 2])
    return to_ray_starts(poses, run.sensor, run.pose_frame)


def to_ray_starts(poses: Floats, sensor: RangeSensor, frame: PoseFrame) -> Floats:
    """Move poses (n, n_rays or 1, 3) of a frame so that its laser is where each ray of several sensors starts.

    Returns (n, n_rays, 3); the poses as they are if all rays start in one place.
    """
    if not sensor.is_composite:
        return poses
    phi = poses[..., 2] + (0.0 if frame == "laser" else sensor.mount[2])
    cos, sin = np.cos(phi), np.sin(phi)
    x, y = sensor.origins.T
    moved = (poses[..., 0] + cos * x - sin * y, poses[..., 1] + sin * x + cos * y)
    return np.stack([*moved, np.broadcast_to(poses[..., 2], moved[0].shape)], axis=-1)


def _unwrapped(poses: Floats) -> Floats:
    """Return poses (n, 3) whose headings [rad] follow each other without a jump."""
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])


def _between_references(run: Run, stamps: Floats, poses: Floats) -> Motion | None:
    """Return the odometry poses between slow references, moved into map; None where there are none."""
    known = np.isfinite(run.odometry).all(axis=1)
    when, odometry = run.odom_stamps[known], run.odometry[known]
    if len(when) < MIN_ODOMETRY or len(stamps) < 2:
        return None
    if run.pose_frame == "laser":
        odometry = compose(odometry, run.sensor.mount)
    odometry = _unwrapped(odometry)
    there = Motion(stamps=when, poses=odometry).at(stamps)  # odometry at the references
    right = np.searchsorted(stamps, when, side="left")
    left = right - 1
    inside = (left >= 0) & (right < len(stamps))
    left, right = np.where(inside, left, 0), np.where(inside, right, 1)
    inside &= (when < stamps[right]) & (stamps[left] >= when[0]) & (stamps[right] <= when[-1])
    count = np.bincount(left[inside], minlength=len(stamps))
    inside &= count[left] >= MIN_ODOMETRY
    if not inside.any() or not _odometry_tells_more(stamps, poses, there):
        return None
    left, right, when, odometry = left[inside], right[inside], when[inside], odometry[inside]
    share = (when - stamps[left]) / (stamps[right] - stamps[left])
    found = _spread(poses[left], poses[right], there[left], odometry, there[right], share)
    return Motion(stamps=when, poses=found)


def _spread(first: Floats, last: Floats, begin: Floats, now: Floats, end: Floats, share: Floats) -> Floats:
    """Return poses (n, 3) between two references, by odometry, the difference to the second spread evenly over the time.

    Parameters
    ----------
    first, last : (n, 3) references in map
    begin, now, end : (n, 3) odometry at the first, between, and at the last
    share : (n,) of the time between them
    """
    miss = last - compose(first, compose(invert(begin), end))
    miss[:, 2] = wrap(miss[:, 2])
    return np.asarray(compose(first, compose(invert(begin), now)) + share[:, None] * miss)


def _odometry_tells_more(stamps: Floats, poses: Floats, odometry: Floats) -> bool:
    """Tell whether odometry (n, 3) at the references says better than their neighbours where every other reference is.

    Judged by the root mean square, a radian counting as a metre: as a reading of a metre sees it.
    """
    first, middle, last = (slice(k, len(stamps) - 2 + k, 2) for k in range(3))
    if len(stamps[middle]) < MIN_JUDGED:
        return True
    share = (stamps[middle] - stamps[first]) / np.maximum(stamps[last] - stamps[first], SAME_STAMP)
    by_odometry = _spread(poses[first], poses[last], odometry[first], odometry[middle], odometry[last], share)
    by_neighbours = Motion(stamps=stamps[::2], poses=_unwrapped(poses)[::2]).at(stamps[middle])

    def error(told: Floats) -> float:
        off = told - poses[middle]
        off[:, 2] = wrap(off[:, 2])
        return float(np.square(off).sum())

    return error(by_odometry) < error(by_neighbours)
