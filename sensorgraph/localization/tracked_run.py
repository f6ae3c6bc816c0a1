"""Track a run with the laser that it shows: ray times, bearings and the offset of the ranges are estimated in the first track.

Where the run contradicts what its log states of these, it is tracked again with the values that it shows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert
from sensorgraph.localization.bearing_scale import LEAST, BearingScale, estimated_scale, kept_ray
from sensorgraph.localization.course import direction_of
from sensorgraph.localization.front_end import track
from sensorgraph.localization.missing_odometry import with_missing_stretches, without_jumps
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.older_rays import identify_older_rays
from sensorgraph.localization.range_offset import OffsetOfRanges, identify_range_offset, with_ranges
from sensorgraph.localization.ray_times import identify_ray_times, small_sample
from sensorgraph.localization.scan_lag import LATENCY, MIN_LAG, N_STEPS, ScanLag, scan_lag, with_stamp_of
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.scans import ScanPoints, scan_points
from sensorgraph.localization.sweep_middles import SweepMiddles
from sensorgraph.localization.turning_pieces import (
    MIN_GAIN,
    MIN_PIECES,
    PIECE_FRAMES,
    LinearisedPieces,
    TurningPieces,
)
from sensorgraph.types import Bools, Floats, ProgressBars, no_progress

ROUNDS = 3
"""Maximum number of times that ray times and bearings are estimated in turn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedRun:
    """A run with tracked scans."""

    run: Run
    """The run; its sensor has the identified ray times."""
    odometry: Floats | None
    """(n_scans, 3) [m, m, rad] Odometry at the scans; None: unusable."""
    scans: ScanPoints
    track: ScanTrack
    notes: tuple[str, ...] = ()
    """Notes about the ray times."""
    offset: OffsetOfRanges = field(default_factory=OffsetOfRanges)
    """Of the ranges of the log; those of `run` are corrected."""
    middles: SweepMiddles | None = None
    """Of the sweeps that the odometry deskewed; None: without odometry, or of a laser without a sweep."""

    def between_middles(
        self, poses: Floats, covariances: Floats, matched: Bools, is_continuous: Bools
    ) -> tuple[Floats, Floats]:
        """Return poses (n_scans, 3) and covariances (n_scans, 3, 3) between the middles of two sweeps (`sweep_middles`).

        Parameters
        ----------
        matched, is_continuous : (n_scans,) The scan fits the map, and continues the one before.
        """
        if self.middles is None:
            return poses, covariances
        follows = matched & np.append(False, matched[:-1]) & is_continuous
        return self.middles.placed(poses, covariances, follows)


def track_run(run: Run, progress: ProgressBars = no_progress) -> TrackedRun:
    """Track all scans, with the ray times and ranges of the log or, if the run contradicts them, with those that it shows.

    Ray times of a robot.yaml are not tested, nor are the bearings beside them. Rays are deskewed with the velocity of the odometry.
    Without odometry, a first track without deskewing gives the velocity, and the scans are tracked again.
    """
    measured, odometry_motion, filled = odometry_of(run), None, tuple[str, ...]()
    if measured is not None:
        odometry_motion, filled = with_missing_stretches(run, measured)
    odometry = None
    if odometry_motion is not None:
        odometry = odometry_at_scans(run, odometry_motion)  # with its jumps, which the tracking leaves out
        odometry_motion = without_jumps(odometry_motion)
    scans = scan_points(run, odometry_motion)
    tracked = track(scans, run.stamps, odometry, progress)
    if len(tracked.key_frames) == 0 or run.sensor.is_composite:
        return TrackedRun(run=run, odometry=odometry, scans=scans, track=tracked, notes=filled)
    motion = odometry_motion or motion_of_track(run, tracked)
    is_given = run.meta.get("ray_times") == "robot.yaml"
    sensor, offset, notes = run.sensor, OffsetOfRanges(), tuple[str, ...]()
    with progress("estimating ray times", ""):
        dense = _with_more_key_frames(tracked, scans, run.stamps, odometry)
        pieces = TurningPieces.of(run, odometry, dense)
        if pieces is not None:
            keys, turned = tracked.key_frames, None
            if odometry is not None:
                seen, driven = (compose(invert(p[keys[:-1]]), p[keys[1:]]) for p in (tracked.poses, odometry))
                turned = direction_of(seen, driven)
            sensor, offset, notes = _corrected(
                run.sensor, pieces, motion, None if turned is None else turned[0], is_given=is_given
            )
    is_new, notes = sensor is not run.sensor or offset.value != 0, (*filled, *notes)
    run = with_ranges(replace(run, sensor=sensor), offset.value)
    if is_new or (odometry is None and run.sensor.has_ray_delays):
        scans = scan_points(run, motion)
        tracked = track(scans, run.stamps, odometry, progress)
        if odometry is None:  # the velocity of a track that was not deskewed has errors of its own
            motion = motion_of_track(run, tracked, motion)
            scans = scan_points(run, motion)
            tracked = track(scans, run.stamps, odometry, progress)
    if measured is not None and odometry is not None and not is_given:
        lag = scan_lag(run, measured, tracked)
        shifted, more = (run, ()) if lag is None else with_stamp_of(run, lag)
        if shifted is not run:
            run, scans = shifted, scan_points(shifted, motion)
            tracked = track(scans, run.stamps, odometry, progress)
        elif lag is not None and more and odometry_motion is not None:
            lag, odometry, tracked = _at_equal_times(
                run, measured, odometry_motion, lag, scans, tracked, progress
            )
            more = with_stamp_of(run, lag)[1]
        notes = (*notes, *more)
    middles = None if odometry_motion is None else SweepMiddles.of(run, odometry_motion)
    return TrackedRun(
        run=run, odometry=odometry, scans=scans, track=tracked, notes=notes, offset=offset, middles=middles
    )


def _corrected(
    sensor: RangeSensor, pieces: TurningPieces, motion: Motion, turned: float | None, *, is_given: bool
) -> tuple[RangeSensor, OffsetOfRanges, tuple[str, ...]]:
    """Return the sensor with the ray times and bearings that the run shows, the offset of the ranges, and notes about them.

    Parameters
    ----------
    is_given : A robot.yaml states the ray times; only the ranges are tested.
    """
    widening, notes = small_sample(int(pieces.piece[-1]) + 1), tuple[str, ...]()
    if is_given:
        start = pieces.linearised(sensor.ray_delays, motion)
    else:
        sensor, start, notes = _with_times_and_bearings(sensor, pieces, motion, turned, widening)
    return sensor, identify_range_offset(sensor, pieces, start, motion, widening), notes


def _with_times_and_bearings(
    sensor: RangeSensor, pieces: TurningPieces, motion: Motion, turned: float | None, widening: float
) -> tuple[RangeSensor, LinearisedPieces, tuple[str, ...]]:
    """Return the sensor with the ray times and the bearings that the run shows, the pieces linearised at these, and notes.

    Wrong bearings disturb the ray times, and the other way round, so that both are estimated in turn.
    """
    timed, start, notes = _with_ray_times(sensor, pieces, motion, widening)
    as_stated, scale, here = (timed, start, notes), BearingScale(value=1.0, stderr=0.0, kept="first"), pieces
    for _ in range(ROUNDS):
        found = estimated_scale(timed, here, start, motion)
        if found is None:
            return as_stated
        value, stderr = scale.value * found[0], found[1]
        scale = BearingScale(value=value, stderr=stderr, kept=kept_ray(sensor, value, turned))
        if abs(found[0] - 1.0) < LEAST:
            break
        scaled = scale.of(sensor)
        here = replace(pieces, run=replace(pieces.run, sensor=scaled))
        timed, start, notes = _with_ray_times(scaled, here, motion, widening)
    off = abs(scale.value - 1.0)
    if off < LEAST or off**2 <= widening * MIN_GAIN * scale.stderr**2:
        return as_stated
    return timed, start, (scale.line, *notes)


def _with_ray_times(
    sensor: RangeSensor, pieces: TurningPieces, motion: Motion, widening: float
) -> tuple[RangeSensor, LinearisedPieces, tuple[str, ...]]:
    """Return the sensor with the ray times that the run shows, the pieces linearised at these, and notes about them."""
    start = pieces.linearised(sensor.ray_delays, motion)
    notes: tuple[str, ...] = ()
    older = identify_older_rays(sensor, pieces, start, motion, widening)
    found = None if older else identify_ray_times(sensor, pieces, start, motion)
    if found is not None:
        sensor, notes = found.sensor, (found.line,)
        start = pieces.linearised(sensor.ray_delays, motion)
        older = identify_older_rays(sensor, pieces, start, motion, widening)
    if older is not None:
        sensor, notes = older.sensor, (*notes, older.line)
        start = pieces.linearised(sensor.ray_delays, motion)
    return sensor, start, notes


def _at_equal_times(
    run: Run,
    measured: Motion,
    motion: Motion,
    lag: ScanLag,
    scans: ScanPoints,
    tracked: ScanTrack,
    progress: ProgressBars,
) -> tuple[ScanLag, Floats, ScanTrack]:
    """Return the lag of the scans, the odometry at their times, and the track.

    As a prior, late odometry bends the track towards its own lag. Beyond `LATENCY`, the scans are tracked again with the
    odometry at their times until the lag stays.

    Parameters
    ----------
    measured, motion : The odometry without and with the stretches that the scans fill.
    """
    for _ in range(N_STEPS if abs(lag.value) > LATENCY else 0):
        tracked = track(scans, run.stamps, motion.at(run.stamps + lag.value), progress)
        last, lag = lag, scan_lag(run, measured, tracked) or lag
        if abs(lag.value - last.value) < MIN_LAG:
            break
    return lag, motion.at(run.stamps + lag.value), tracked


def _with_more_key_frames(
    tracked: ScanTrack, scans: ScanPoints, stamps: Floats, odometry: Floats | None
) -> ScanTrack:
    """Track a short log again with key frames so close together that they suffice for the pieces."""
    share = len(tracked.key_frames) / (MIN_PIECES * PIECE_FRAMES)
    if share >= 1:
        return tracked
    return track(scans, stamps, odometry, no_progress, spacing=share)


def motion_of_track(run: Run, tracked: ScanTrack, deskewed_by: Motion | None = None) -> Motion:
    """Return the motion of a track; its velocity deskews rays where there is no odometry.

    A scan determines the pose in the middle of its sweep. The poses at the stamps follow from the velocity, so that their
    differences would amplify its errors.

    Parameters
    ----------
    deskewed_by : Motion that deskewed the scans of the track; None: they were not deskewed.
    """
    middle, poses = run.stamps + run.sensor.ray_delays.mean(), tracked.poses
    if deskewed_by is not None:
        moved = compose(invert(deskewed_by.at(run.stamps)), deskewed_by.at(middle))
        poses = compose(poses, moved)
    return Motion(stamps=middle, poses=np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
