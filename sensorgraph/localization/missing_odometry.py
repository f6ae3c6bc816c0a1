"""Odometry that begins after the scans or ends before them: a track of the scans alone continues it."""

from __future__ import annotations

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.front_end import track
from sensorgraph.localization.scans import scan_points

MIN_MISSING = 1.0
"""[s] Shortest time without odometry that is filled; over shorter ones its last velocity is continued."""


def with_missing_ends(run: Run, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """Return the odometry with the motion of the scans alone before its first and after its last pose, and notes.

    Poses of a run whose scans cannot be followed there are left out, so that the robot stands in them as before.
    """
    notes: list[str] = []
    first, last = motion.stamps[0], motion.stamps[-1]
    for is_early in (True, False):
        missing = np.flatnonzero(run.stamps < first if is_early else run.stamps > last)
        if len(missing) < 3 or np.ptp(run.stamps[missing]) < MIN_MISSING:
            continue
        edge = missing[-1] + 1 if is_early else missing[0] - 1  # the scan that both have
        if not 0 <= edge < run.n_scans:
            continue
        part = slice(missing[0], edge + 1) if is_early else slice(edge, missing[-1] + 1)
        scans = run.take_scans(part)
        found = track(scan_points(scans), scans.stamps, None, lambda done, total: None)
        if len(found.poses) < 3 or not found.matched.all() or found.piece[0] != found.piece[-1]:
            continue
        k = -1 if is_early else 0
        poses = compose(motion.at(run.stamps[edge]), compose(invert(found.poses[k]), found.poses))
        stamps = scans.stamps
        poses, stamps = (poses[:-1], stamps[:-1]) if is_early else (poses[1:], stamps[1:])
        parts = [(stamps, poses), (motion.stamps, motion.poses)]
        all_stamps, all_poses = zip(*(parts if is_early else parts[::-1]), strict=True)
        joined = np.concatenate(all_poses)
        joined[:, 2] = np.unwrap(joined[:, 2])
        motion = Motion(stamps=np.concatenate(all_stamps), poses=joined)
        when = f"before {first - run.stamps[0]:.1f} s" if is_early else f"after {last - run.stamps[0]:.1f} s"
        notes.append(f"the log has no odometry {when}: the scans alone determine the motion there")
    return motion, tuple(notes)
