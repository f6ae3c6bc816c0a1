"""`map_run`: estimate the poses of all scans of a run in a place without a map."""

from __future__ import annotations

import numpy as np

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.covariances import key_frame_covariances
from sensorgraph.localization.front_end import ScanTrack, information_at
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.loop_closures import ClosedTrack, close_loops, spread
from sensorgraph.localization.matching import match
from sensorgraph.localization.point_rows import FramePoints
from sensorgraph.localization.ray_times import track_run
from sensorgraph.localization.refinement import Refined, refine
from sensorgraph.localization.result import Localization, Status, interval_notes
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import FINAL, MATCH, LineMatchSettings
from sensorgraph.localization.smoothing import smooth, steps_of
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.types import Bools, Floats, Ints, Progress, ProgressBars, no_progress

MIN_VARIANCE = 1e-8
"""[m², rad²] Added to the independent variances of scans, since those of key frames are 0."""


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
    with progress("tracking", "scans") as bar:
        followed = track_run(run, bar)
    odometry, scans, tracked = followed.odometry, followed.scans, followed.track
    if len(tracked.key_frames) == 0:
        return _without_returns(run, tracked)
    with progress("closing loops", "submaps") as bar:
        closed = close_loops(scans, tracked, bar)
    frames = FramePoints.of(scans, tracked.key_frames)
    steps = WheelSteps.of(odometry, tracked)
    with progress("refining", "steps") as bar:
        refined = refine(frames, closed.poses, steps, (closed.steps, closed.closures), bar)
    with progress("placing scans", "scans") as bar:
        poses, covariances, own, matched = _place_all(
            scans, tracked, refined, np.random.default_rng(seed), bar
        )
    poses = smooth(
        poses, *steps_of(tracked), poses, np.linalg.inv(own + MIN_VARIANCE * np.eye(3)).astype(np.float64)
    ).poses
    origin = np.zeros(3) if odometry is None else odometry[0]
    poses, covariances = _moved_to(poses, covariances, origin)
    joined = _joined(tracked, closed)
    piece = tracked.piece[
        np.clip(np.searchsorted(tracked.key_frames, np.arange(run.n_scans), side="right") - 1, 0, None)
    ]
    is_lost = ~matched | ~joined[piece]
    rivals, is_ambiguous = _rivals(tracked, closed, poses, joined, piece)
    words = np.where(is_ambiguous, "ambiguous", np.where(is_lost, "lost", "ok"))
    status: tuple[Status, ...] = tuple(words.tolist())
    return Localization(
        t=run.stamps,
        poses=poses,
        covariances=covariances,
        status=status,
        kept=closed.kept,
        refused=closed.refused,
        wheels=steps.parameters(refined.poses),
        rivals=rivals,
        notes=(
            *_notes(run, tracked, joined, odometry is None),
            *followed.notes,
            *interval_notes(run.stamps, status, "ambiguous"),
        ),
        sensor=followed.run.sensor,
    )


def _place_all(
    scans: ScanPoints, tracked: ScanTrack, refined: Refined, rng: np.random.Generator, progress: Progress
) -> tuple[Floats, Floats, Floats, Bools]:
    """Return poses, covariances, independent covariances, and whether each scan fits the map, for all scans.

    Errors that neighbouring scans share, such as those of the map, do not move one against another. Key
    frames were already placed together with the odometry, so that their independent covariance is 0.
    """
    keys, n = tracked.key_frames, scans.n_scans
    key_covariances, shared = key_frame_covariances(refined, rng)
    poses = spread(tracked, refined.poses)
    matching = MATCH.for_spacing(scans.spacing)
    normals = refined.frames.placed(refined.poses)[1]
    surfaces = line_map(*thinned(refined.system.surface, normals), side=matching.first_radius)
    index = np.arange(n)
    left = np.clip(np.searchsorted(keys, index, side="right") - 1, 0, len(keys) - 1)
    right = np.minimum(left + 1, len(keys) - 1)
    share = np.clip((index - keys[left]) / np.maximum(keys[right] - keys[left], 1), 0.0, 1.0)[:, None, None]
    covariances = (1 - share) * shared[left] + share * shared[right]
    covariances[keys] = key_covariances
    own, matched = np.zeros((n, 3, 3)), tracked.matched.copy()
    is_key = np.zeros(n, dtype=np.bool_)
    is_key[keys] = True
    for k in index[~is_key]:
        poses[k], own[k], fits = _place(scans, int(k), surfaces, poses[k], matching)
        matched[k] &= fits
        if k % 50 == 0:
            progress(int(k), n)
    return poses, covariances + own, own, matched


def _place(
    scans: ScanPoints, k: int, surfaces: LineMap, prior: Floats, matching: LineMatchSettings
) -> tuple[Floats, Floats, bool]:
    """Return pose, covariance from scan and wheels alone, and whether it fits, of one scan between key frames."""
    own, settings = scans.of(k), FINAL
    information = information_at(prior, np.array([settings.place_sd, settings.place_sd, settings.turn_sd]))
    found = match(
        scans.points[own],
        scans.normals[own],
        surfaces,
        prior,
        prior_information=information,
        settings=matching,
    )
    fits = found.inliers >= settings.inliers and found.overlap >= settings.overlap
    if not fits:
        return prior, np.linalg.inv(information).astype(np.float64), False
    lowest = max(-float(np.linalg.eigvalsh(found.information)[0]), 0.0)
    covariance = np.linalg.inv(found.information + lowest * np.eye(3) + information)
    return found.pose, covariance.astype(np.float64), True


def _moved_to(poses: Floats, covariances: Floats, origin: Floats) -> tuple[Floats, Floats]:
    """Move all poses so that the first is at the origin (3,)."""
    move = compose(origin, invert(poses[0]))
    cos, sin = np.cos(move[2]), np.sin(move[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    moved = compose(np.broadcast_to(move, poses.shape), poses)
    moved[:, 2] = wrap(moved[:, 2])
    return moved, turn @ covariances @ turn.T


def _joined(tracked: ScanTrack, closed: ClosedTrack) -> Bools:
    """Return which track segments are connected to the longest by kept closures; a single closure can be false."""
    n_pieces = int(tracked.piece[-1]) + 1
    label = np.arange(n_pieces)
    between = np.zeros((n_pieces, n_pieces), dtype=np.intp)
    np.add.at(between, (tracked.piece[closed.closures.first], tracked.piece[closed.closures.second]), 1)
    between += between.T
    for a, b in zip(*np.nonzero(between >= FINAL.min_joining_closures), strict=True):
        label[label == label[b]] = label[a]
    weight = np.bincount(label[tracked.piece], minlength=n_pieces)
    return np.asarray(label == int(weight.argmax()))


def _rivals(
    tracked: ScanTrack, closed: ClosedTrack, poses: Floats, joined: Bools, piece: Ints
) -> tuple[dict[int, Floats], Bools]:
    """Return the other places (n, 3) in map of some scans, and which scans (n_scans,) they make ambiguous.

    A track segment that did not join the map is ambiguous as a whole. In a joined segment, all scans after
    the submap are ambiguous, unless a later closure in the segment resolves them.
    """
    keys, scans = tracked.key_frames, np.arange(len(poses))
    held = np.concatenate([closed.closures.first, closed.closures.second, [-1]])
    rivals: dict[int, Floats] = {}
    is_ambiguous = np.zeros(len(poses), dtype=np.bool_)
    for one in closed.rivals:
        own = int(tracked.piece[one.newer])
        is_known = joined[tracked.piece[one.older]]
        if is_known.sum() < 2:
            continue
        depends = piece == own
        if joined[own]:
            if held[tracked.piece[held] == own].max(initial=-1) > one.newer:
                continue
            depends &= scans >= keys[one.newer]
        rivals[int(keys[one.newer])] = compose(poses[keys[one.older]], one.relative)[is_known]
        is_ambiguous |= depends
    return rivals, is_ambiguous


def _notes(run: Run, tracked: ScanTrack, joined: Bools, without_odometry: bool) -> tuple[str, ...]:
    notes = []
    if without_odometry:
        notes.append("no usable odometry: located by scan matching alone")
    n_same = int((np.diff(run.stamps) == 0).sum())
    if n_same:
        notes.append(f"{n_same} scans repeat the previous stamp: used in the order of the log")
    if tracked.jumps:
        first = run.stamps[tracked.jumps[0]]
        notes.append(f"the odometry jumps {len(tracked.jumps)} times, first at {first:.1f} s: not used there")
    n_pieces = len(joined)
    if n_pieces > 1:
        ends = [int(tracked.key_frames[np.flatnonzero(tracked.piece == k)[0]]) for k in range(1, n_pieces)]
        times = ", ".join(f"{run.stamps[k]:.1f} s" for k in ends[:5])
        found = (
            "loop closures join all segments"
            if joined.all()
            else f"{int((~joined).sum())} segments remain unconnected"
        )
        notes.append(f"tracking was interrupted {n_pieces - 1} times (at {times}): {found}")
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
        notes=("no scan has a return within the range limits of the sensor: no pose can be estimated",),
    )
