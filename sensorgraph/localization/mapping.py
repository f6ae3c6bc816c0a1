"""`map_run`: estimate the poses of all scans of a run in a place without a map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.contrast import contrast_notes
from sensorgraph.localization.covariances import key_frame_covariances
from sensorgraph.localization.dead_reckoning import with_dead_reckoning, with_sweep_motion
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.loop_closures import close_loops, spread
from sensorgraph.localization.map_states import map_numbers, map_states, state_notes, with_unknown_motion
from sensorgraph.localization.matching import match
from sensorgraph.localization.moving_returns import verdict_on, with_motion_of_scans, without_moving_returns
from sensorgraph.localization.point_rows import FramePoints
from sensorgraph.localization.refinement import Refined, refine
from sensorgraph.localization.result import Localization, Status
from sensorgraph.localization.scan_track import ScanTrack, is_covered, settled, turn_matrices
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import FRONT_END, MATCH, LineMatchSettings
from sensorgraph.localization.smoothing import SmoothedPoses, smooth, steps_of
from sensorgraph.localization.tracked_run import track_run
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Bools, Floats, Ints, Progress, ProgressBars, no_progress

NARROW_VIEW = float(np.radians(44.0))
"""[rad] Field of view up to which no pose is certain. In a room, poses from 38° were silently wrong by up to 2 m; from 45°,
they were right within 6 cm."""
TRACK_COVARIANCE = np.diag(np.square([0.03, 0.03, 0.015]))
"""(3, 3) [m, m, rad] Of the track between two key frames, as prior of the scans between them."""
MIN_VARIANCE = 1e-8
"""[m², rad²] Added to the independent variances of scans, since those of key frames are 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlacedScans:
    """Scans that are matched to the refined map one by one."""

    poses: Floats
    """(n_scans, 3) [m, m, rad]"""
    shared: Floats
    """(n_scans, 3, 3) Covariances that neighbouring scans share, such as the errors of the map."""
    own: Floats
    """(n_scans, 3, 3) Independent covariances."""
    matched: Bools
    """(n_scans,) The scan fits the map."""
    surfaces: LineMap
    missed: Bools
    """(n_scans,) The scan fits the map, but tracking missed it: the odometry before or after it slips."""
    wheels: Floats
    """(3,) Standard deviations of distance scale, turn scale and heading bias."""


def map_run(run: Run, *, seed: int = 0, progress: ProgressBars = no_progress) -> Localization:
    """Estimate the pose of each scan of a run, from its scans and its odometry alone.

    Reference poses of the run are ignored. The first scan has the pose of the odometry, or 0 without
    odometry.

    Parameters
    ----------
    seed : Seed of the bootstrap of the covariances.
    progress : Opens a progress bar for each stage.

    Raises
    ------
    ValueError : The run has no scan.
    """
    if run.n_scans == 0:
        raise ValueError("the run has no scans, expected at least one; check the topic of the scans")
    followed = with_motion_of_scans(track_run(run, progress), progress)
    followed = without_moving_returns(followed, progress)
    odometry, scans, tracked = followed.odometry, followed.scans, followed.track
    if len(tracked.key_frames) == 0:
        return _without_returns(run, tracked)
    with progress("closing loops", "submaps") as bar:
        closed = close_loops(scans, tracked, bar)
    projections = settled(tracked.projections)
    tracked = replace(tracked, is_carried=closed.is_carried, projections=projections)
    frames = FramePoints.of(scans, tracked.key_frames, tracked.projections)
    steps = WheelSteps.of(odometry, tracked, run.stamps)
    with progress("refining", "steps") as bar:
        refined = refine(frames, closed.poses, steps, (closed.steps, closed.closures), bar)
    maps = map_numbers(tracked, closed)
    with progress("placing scans", "scans") as bar:
        placed = _place_all(scans, tracked, refined, maps[tracked.piece], np.random.default_rng(seed), bar)
    has_odometry = odometry is not None
    smoothed = _smoothed(tracked, placed, has_odometry=has_odometry)
    if not placed.matched.all():
        placed = _placed_again(scans, tracked, placed, smoothed)
        smoothed = _smoothed(tracked, placed, has_odometry=has_odometry)
    wheels = steps.parameters(refined.poses, placed.wheels)
    reckoned = with_dead_reckoning(placed.shared, tracked, refined, wheels)
    placed = replace(placed, shared=reckoned)
    verdict = verdict_on(run, scans, smoothed.poses, odometry, wheels)
    if verdict.is_false.any():  # a few surfaces fit a wrong place
        placed = replace(placed, matched=placed.matched & ~verdict.is_false)
        smoothed = _smoothed(tracked, placed, has_odometry=has_odometry)
    matched = placed.matched
    covariances = placed.shared + np.where(matched[:, None, None], placed.own, smoothed.covariances)
    covariances = covariances + verdict.doubt[:, :, None] ** 2 * np.eye(3)
    origin = np.zeros(3) if odometry is None else odometry[0]
    poses, covariances = followed.between_middles(smoothed.poses, covariances, matched, tracked.is_continuous)
    poses, covariances = _moved_to(poses, covariances, origin)
    seen = _turned(refined.system.rows.projections, np.asarray(poses[0, 2] - smoothed.poses[0, 2]))
    if not has_odometry:
        covariances = with_unknown_motion(covariances, run.stamps, tracked, seen)
        duration = followed.run.sensor.scan_duration
        covariances = with_sweep_motion(covariances, run.stamps, poses, duration)
    states = map_states(tracked, closed, poses, covariances, maps, matched, seen, has_odometry=has_odometry)
    narrow = _narrow_view(run)
    uncertain: dict[Status, Status] = {"ok": "ambiguous"} if narrow else {}
    return Localization(
        t=run.stamps,
        poses=poses,
        covariances=covariances,
        status=tuple(uncertain.get(one, one) for one in states.status),
        maps=states.maps,
        kept=closed.kept,
        refused=closed.refused,
        wheels=wheels,
        rivals=states.rivals,
        notes=(
            *narrow,
            *_notes(run, tracked, odometry is None),
            *state_notes(run.stamps, tracked, states),
            *contrast_notes(run, poses, odometry, states.status, wheels),
            *followed.notes,
            *followed.offset.notes(),
        ),
        sensor=followed.run.sensor,
        range_offset=followed.offset.value,
    )


def _turned(projections: Floats | None, angle: Floats) -> Floats | None:
    """Return projections (n, 3, 3) of a motion x, y, phi in a map that is turned by an angle () [rad]."""
    turn = turn_matrices(angle)
    return None if projections is None else turn @ projections @ turn.T


def _smoothed(tracked: ScanTrack, placed: _PlacedScans, *, has_odometry: bool) -> SmoothedPoses:
    """Smooth the poses of all scans; the track or the odometry carries those that fit nowhere.

    Where the track is not continuous, its step is not measured: if both scans fit the map, their places determine the motion.
    """
    poses = placed.poses
    information = np.linalg.inv(placed.own + MIN_VARIANCE * np.eye(3)).astype(np.float64)
    information[~placed.matched] = 0.0
    breaks = ~tracked.is_continuous
    if has_odometry:  # it measures the motion, except across its jumps and while the robot is carried
        both_fit = placed.matched & np.append(False, placed.matched[:-1])
        breaks &= both_fit | tracked.within((np.diff(tracked.piece) > 0) & ~tracked.is_carried)
        breaks[list(tracked.jumps)] = True
    breaks |= placed.missed
    breaks[1:] |= placed.missed[:-1]
    return smooth(poses, *steps_of(tracked, breaks), poses, information)


def _place_all(
    scans: ScanPoints,
    tracked: ScanTrack,
    refined: Refined,
    maps: Ints,
    rng: np.random.Generator,
    progress: Progress,
) -> _PlacedScans:
    """Match all scans to the refined map.

    Errors that neighbouring scans share do not move one against another. Key frames were already placed together
    with the odometry, so that their independent covariance is 0.
    """
    keys, n = tracked.key_frames, scans.n_scans
    key_covariances, shared, by_wheels = key_frame_covariances(refined, maps, rng)
    poses = spread(tracked, refined.poses)
    matching = MATCH.for_spacing(scans.spacing)
    normals = refined.frames.placed(refined.poses)[1]
    surfaces = line_map(*thinned(refined.system.rows.surface, normals), side=matching.first_radius)
    left, right, share = tracked.between_key_frames()
    share = share[:, None, None]
    covariances = (1 - share) * shared[left] + share * shared[right]
    covariances[keys] = key_covariances
    own, matched = np.zeros((n, 3, 3)), tracked.matched.copy()
    is_key = np.zeros(n, dtype=np.bool_)
    is_key[keys] = len(keys) > 1  # a single one is as uncertain as any other scan
    for k in np.flatnonzero(~is_key):
        poses[k], own[k], fits = _place(scans, int(k), surfaces, poses[k], TRACK_COVARIANCE, matching)
        matched[k] &= fits
        if k % 50 == 0:
            progress(int(k), n)
    missed = np.zeros(n, dtype=np.bool_)
    return _PlacedScans(
        poses=poses,
        shared=covariances,
        own=own,
        matched=matched,
        surfaces=surfaces,
        missed=missed,
        wheels=by_wheels,
    )


def _placed_again(
    scans: ScanPoints, tracked: ScanTrack, placed: _PlacedScans, smoothed: SmoothedPoses
) -> _PlacedScans:
    """Match the scans that a track segment missed once more, from the poses that the scans around them give them.

    Slip of the wheels keeps a scan from its neighbours before it; those after it show where it is.
    """
    poses, own, matched = placed.poses.copy(), placed.own.copy(), placed.matched.copy()
    matching = MATCH.for_spacing(scans.spacing)
    deviations = np.sqrt(np.einsum("nii->ni", smoothed.covariances)[:, :2].max(axis=1))
    is_between = tracked.within(np.diff(tracked.piece) == 0)
    for k in np.flatnonzero(~matched & is_between & (deviations < matching.first_radius)).tolist():
        if is_covered(scans, k):
            continue
        prior = smoothed.covariances[k] + TRACK_COVARIANCE  # slip is larger than the odometry's deviations
        pose, covariance, fits = _place(scans, k, placed.surfaces, smoothed.poses[k], prior, matching)
        if fits:
            poses[k], own[k], matched[k] = pose, covariance, True
    return replace(placed, poses=poses, own=own, matched=matched, missed=matched & ~placed.matched)


def _place(
    scans: ScanPoints,
    k: int,
    surfaces: LineMap,
    prior: Floats,
    prior_covariance: Floats,
    matching: LineMatchSettings,
) -> tuple[Floats, Floats, bool]:
    """Return pose, covariance from scan and prior alone, and whether it fits, of one scan between key frames."""
    own = scans.of(k)
    information = np.linalg.inv(prior_covariance).astype(np.float64)
    found = match(
        scans.points[own],
        scans.normals[own],
        surfaces,
        prior,
        prior_information=information,
        settings=matching,
    )
    fits = found.inliers >= MAJORITY and found.overlap >= FRONT_END.min_overlap
    if not fits:
        return prior, prior_covariance, False
    covariance = np.linalg.inv(found.information + information)
    return found.pose, covariance.astype(np.float64), True


def _moved_to(poses: Floats, covariances: Floats, origin: Floats) -> tuple[Floats, Floats]:
    """Move all poses so that the first is at the origin (3,)."""
    move = compose(origin, invert(poses[0]))
    turn = turn_matrices(move[2])
    return compose(np.broadcast_to(move, poses.shape), poses), turn @ covariances @ turn.T


def _narrow_view(run: Run) -> tuple[str, ...]:
    """Return a note if the laser sees too little for a certain pose; empty if not."""
    view = float(np.ptp(run.sensor.bearings)) if run.sensor.n_rays else 0.0
    if run.sensor.is_composite or view > NARROW_VIEW:
        return ()
    return (
        f"the laser sees {np.degrees(view):.0f}° only: few surfaces fit many places, so no pose is certain; use a wider "
        "field of view",
    )


def _notes(run: Run, tracked: ScanTrack, without_odometry: bool) -> tuple[str, ...]:
    notes = []
    if without_odometry:
        notes.append("no usable odometry: located by scan matching alone")
    n_same = int((np.diff(run.stamps) == 0).sum())
    if n_same:
        notes.append(f"{n_same} scans repeat the previous stamp: used in the order of the log")
    if tracked.jumps:
        first = run.stamps[tracked.jumps[0]]
        notes.append(f"the odometry jumps {len(tracked.jumps)} times, first at {first:.1f} s: not used there")
    return tuple(notes)


def _without_returns(run: Run, tracked: ScanTrack) -> Localization:
    """Return a localization without any return: all scans are lost."""
    n = run.n_scans
    status: tuple[Status, ...] = tuple("lost" for _ in range(n))
    return Localization(
        t=run.stamps,
        poses=tracked.poses,
        covariances=np.broadcast_to(np.eye(3) * 1e6, (n, 3, 3)).copy(),
        status=status,
        maps=np.zeros(n, dtype=np.intp),
        notes=("no scan has a return within the range limits of the sensor: no pose can be estimated",),
    )
