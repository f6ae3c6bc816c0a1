"""Wheel odometry at the stamps of the scans, or none if it never moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from logs.types import ROUNDING
from sensorgraph.types import Floats


def odometry_of(run: Run) -> Motion | None:
    """Return the odometry of a run, preferably from the scan lines; None if it is missing or never moves.

    Poses with non-finite values are dropped.
    """
    for stamps, poses in _sources(run):
        known = np.isfinite(poses).all(axis=1)
        stamps, poses = stamps[known], poses[known]
        if len(stamps) > 1 and (np.ptp(poses, axis=0) > ROUNDING).any():
            return Motion(stamps=stamps, poses=np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
    return None


def _sources(run: Run) -> list[tuple[Floats, Floats]]:
    sources = [(run.odom_stamps, run.odometry)]
    if run.meta.get("pose_source") == "odometry":  # CARMEN: each scan line contains a pose
        poses = run.poses
        if run.pose_frame == "laser":
            poses = compose(poses, invert(run.sensor.mount))
        sources.insert(0, (run.pose_stamps, poses))
    return sources


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
