"""Odometry that begins after the scans or ends before them: a track of the scans alone continues it."""

from __future__ import annotations

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.front_end import track_part

MIN_MISSING = 1.0
"""[s] Shortest time without odometry that is filled; over shorter ones its last velocity is continued."""
MIN_SCANS = 3
"""Minimum number of scans in this time."""


def with_missing_ends(run: Run, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """Return the odometry with the motion of the scans alone before its first and after its last pose, and notes.

    An end where the scans cannot be followed stays as it is.
    """
    first, last = motion.stamps[0], motion.stamps[-1]
    inside = np.flatnonzero((run.stamps >= first) & (run.stamps <= last))
    if len(inside) == 0:
        return motion, ()
    since = run.stamps[0]
    ends = (  # the scans, which of them the odometry has, and where
        (slice(0, inside[0] + 1), -1, f"before {first - since:.1f} s"),
        (slice(inside[-1], run.n_scans), 0, f"after {last - since:.1f} s"),
    )
    notes: list[str] = []
    for part, edge, when in ends:
        stamps = np.delete(run.stamps[part], edge)
        if len(stamps) < MIN_SCANS or np.ptp(stamps) < MIN_MISSING:
            continue
        _, found = track_part(run, part)
        if not found.matched.all() or found.piece[0] != found.piece[-1]:
            continue
        known = motion.at(run.stamps[part][edge])
        poses = compose(known, compose(invert(found.poses[edge]), np.delete(found.poses, edge, axis=0)))
        at = len(motion.stamps) if edge == 0 else 0
        joined = np.insert(motion.poses, at, poses, axis=0)
        joined[:, 2] = np.unwrap(joined[:, 2])
        motion = Motion(stamps=np.insert(motion.stamps, at, stamps), poses=joined)
        notes.append(f"the log has no odometry {when}: the scans alone determine the motion there")
    return motion, tuple(notes)
