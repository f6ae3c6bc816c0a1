"""Wheel odometry of a run, and its poses at the stamps of the scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert, twists_of, wrap
from logs.types import ROUNDING
from sensorgraph.types import Floats


def odometry_of(run: Run) -> Motion | None:
    """Return the odometry of a run; None if it is missing or never moves.

    A CARMEN log states it twice: in ODOM lines, and in each scan line. The scan lines are better where the logger interpolated
    the odometry to their time, or where the clock does not run. Where they repeat the last ODOM line, the stamp of that line
    is the time of the pose, and that of the scan is up to 0.3 s later.

    Poses with non-finite values are dropped.
    """
    sources = [(run.odom_stamps, run.odometry)]
    if _has_poses_in_scans(run):  # which come first, if they are better
        poses = compose(run.poses, invert(run.sensor.mount)) if run.pose_frame == "laser" else run.poses
        is_later = "clock" not in run.meta and _repeats(poses, run.odometry)
        sources.insert(1 if is_later else 0, (run.pose_stamps, poses))
    for stamps, poses in sources:
        known = np.isfinite(poses).all(axis=1)
        stamps, poses = stamps[known], poses[known]
        if len(stamps) > 1 and (np.ptp(poses, axis=0) > ROUNDING).any():
            return Motion(stamps=stamps, poses=np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
    return None


def with_one_odometry(run: Run) -> Run:
    """Return the run with the odometry of `odometry_of` as its only one, so that later steps use the same as `locate`."""
    motion = odometry_of(run) if _has_poses_in_scans(run) else None
    if motion is None or np.array_equal(motion.stamps, run.odom_stamps):
        return run
    poses = np.column_stack([motion.poses[:, :2], wrap(motion.poses[:, 2])])
    return replace(
        run, odom_stamps=motion.stamps, odometry=poses, odom_twists=twists_of(motion.stamps, motion.poses)
    )


def _has_poses_in_scans(run: Run) -> bool:
    """Tell whether the poses of a run are the odometry in its scan lines."""
    return run.meta.get("pose_source") == "odometry"


def _repeats(poses: Floats, odometry: Floats) -> bool:
    """Tell whether most poses of a robot that moves are among those of the odometry."""
    moved = poses[1:][np.abs(np.diff(poses, axis=0)).max(axis=1, initial=0.0) > ROUNDING]
    moved = moved[np.isfinite(moved).all(axis=1)]
    known = odometry[np.isfinite(odometry).all(axis=1)]
    if len(moved) == 0 or len(known) == 0:
        return False
    return bool(np.mean(KDTree(known).query(moved, p=np.inf)[0] < ROUNDING) > 0.5)


def odometry_at_scans(run: Run, motion: Motion) -> Floats:
    """Return the odometry (n_scans, 3) [m, m, rad] at the stamps of the scans, with phi unwrapped.

    If scans and odometry poses have the same number and stamps, they are paired in order.
    """
    if _has_own_poses(run, motion):
        return motion.poses
    return motion.at(run.stamps)


def with_spread_stamps(run: Run) -> Run:
    """Return the run with repeated scan stamps distributed evenly up to the next stamp (coarse clock).

    A run with an odometry pose for each scan is returned unchanged.
    """
    motion, n = odometry_of(run), run.n_scans
    if (np.diff(run.stamps) > 0).all() or (motion is not None and _has_own_poses(run, motion)):
        return run
    first = np.flatnonzero(np.concatenate([[True], np.diff(run.stamps) > 0]))  # first scan of each group
    counts = np.diff(np.append(first, n))
    lengths = np.append(np.diff(run.stamps[first]), counts[-1] / run.sensor.rate)
    group = np.repeat(np.arange(len(first)), counts)
    share = (np.arange(n) - first[group]) / counts[group]
    return replace(run, stamps=run.stamps + share * lengths[group])


def _has_own_poses(run: Run, motion: Motion) -> bool:
    return len(motion.stamps) == run.n_scans and np.array_equal(motion.stamps, run.stamps)
