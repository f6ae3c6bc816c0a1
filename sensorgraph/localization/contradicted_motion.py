"""Deskewing where the odometry contradicts the scans: its wheels slip or are blocked, its driver hangs, or the robot is pushed.

There the odometry does not measure the motion during a sweep either; a robot that turns by ω while its odometry stands would be
located ω T / 2 off its heading at the stamp of a sweep of the duration T. The track of the scans measures this motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.localization.contrast import Contrast
from sensorgraph.localization.front_end import track
from sensorgraph.localization.missing_odometry import is_measured, without_jumps
from sensorgraph.localization.moving_returns import learned_wheels, verdict_on
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.ray_times import TrackedRun, motion_of_track
from sensorgraph.localization.scans import scan_points
from sensorgraph.types import Progress


def with_motion_of_scans(followed: TrackedRun, progress: Progress) -> TrackedRun:
    """Return a tracked run whose sweeps are deskewed by the track where it contradicts the odometry, and tracked again.

    Sweeps stay as they are where readings show that the odometry is right, or do not decide.
    """
    run, odometry, tracked = followed.run, followed.odometry, followed.track
    measured = odometry_of(run) if run.sensor.has_ray_delays else None
    if odometry is None or measured is None or tracked.wheels is None:
        return followed
    wheels, usable = learned_wheels(followed), is_measured(measured, run.stamps)
    contrast = Contrast.of(run.stamps, tracked.poses, odometry, usable, wheels)
    is_between_pieces = tracked.within(np.diff(tracked.piece) != 0)  # their frames differ
    chosen = contrast.contradicted(run.n_scans) & tracked.matched & ~is_between_pieces
    if not chosen.any():
        return followed
    verdict = verdict_on(run, followed.scans, tracked.poses, odometry, wheels)
    chosen &= ~verdict.is_false & ~verdict.doubt.any(axis=1)
    motion = motion_of_track(run, tracked, without_jumps(measured))
    scans = followed.scans.with_scans_of(scan_points(run, motion), chosen)
    return replace(followed, scans=scans, track=track(scans, run.stamps, odometry, progress))
