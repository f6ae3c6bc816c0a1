"""What the wheels say at the stamps of the scans, or that they say nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.types import Floats

STANDS_STILL = 1e-6
"""[m, rad] odometry that moves less in all of a run is a dummy."""


def odometry_of(run: Run) -> Motion | None:
    """Return the odometry of a run, the one in the scans' own lines first; None: there is none, or it never moves.

    Poses that are not finite are left out.
    """
    for stamps, poses in _sources(run):
        known = np.isfinite(poses).all(axis=1)
        stamps, poses = stamps[known], poses[known]
        if len(stamps) > 1 and (np.ptp(poses, axis=0) > STANDS_STILL).any():
            return Motion(stamps=stamps, poses=np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
    return None


def _sources(run: Run) -> list[tuple[Floats, Floats]]:
    sources = [(run.odom_stamps, run.odometry)]
    if run.meta.get("pose_source") == "odometry":  # CARMEN: each scan's line has its own
        poses = run.poses
        if run.pose_frame == "laser":
            poses = compose(poses, invert(run.sensor.mount))
        sources.insert(0, (run.pose_stamps, poses))
    return sources


def odometry_at_scans(run: Run, motion: Motion) -> Floats:
    """Return the odometry (n_scans, 3) [m, m, rad] at the scans' stamps, phi unwrapped.

    Scans that share their stamps with as many odometry poses take these in their order.
    """
    if _has_own_poses(run, motion):
        return motion.poses
    return motion.at(run.stamps)


def with_spread_stamps(run: Run) -> Run:
    """Return the run with scans that share a stamp spread evenly up to the next stamp: its clock was too coarse.

    A run whose scans have each their own odometry pose is left as it is.
    """
    motion, n = odometry_of(run), run.n_scans
    if (np.diff(run.stamps) > 0).all() or (motion is not None and _has_own_poses(run, motion)):
        return run
    first = np.flatnonzero(np.concatenate([[True], np.diff(run.stamps) > 0]))  # of each group
    counts = np.diff(np.append(first, n))
    lengths = np.append(np.diff(run.stamps[first]), counts[-1] / run.sensor.rate)
    group = np.repeat(np.arange(len(first)), counts)
    share = (np.arange(n) - first[group]) / counts[group]
    return replace(run, stamps=run.stamps + share * lengths[group])


def _has_own_poses(run: Run, motion: Motion) -> bool:
    return len(motion.stamps) == run.n_scans and np.array_equal(motion.stamps, run.stamps)
