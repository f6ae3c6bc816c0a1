"""Readings of the robot itself, such as of posts, cables or a lid in the view of the laser.

A part of the robot stays where it is in the frame of the laser, whatever the robot does. So does a wall that the robot follows, or
a round room in which it turns. The other rays decide: from elsewhere they look through the places where a part of the robot was,
and not through a wall. If the robot does not move, nothing decides, and all readings are kept.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from logs.motion import Motion
from logs.run import Pairing, Run
from logs.transforms import compose, invert, wrap
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.front_end import track_part
from sensorgraph.localization.global_search import evenly
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.odometry_check import with_checked_odometry
from sensorgraph.localization.scan_track import ScanTrack, determines_all, settled
from sensorgraph.localization.scans import (
    MIN_VISIBLE,
    NOISE_MARGIN,
    crossed_by,
    laser_rays,
    moved_points,
    scan_points,
    view_of,
)
from sensorgraph.localization.tracked_run import motion_of_track
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Bools, Floats, Ints

REACH = 1.0
"""[m] Maximum distance of a part of the robot from its laser."""
MARGIN = 0.05
"""[m] Deviation from the usual range of a ray within which its readings are the same: noise, and parts that vibrate."""
INTERVALS = 5
"""Number of equal parts of a log in which the readings of a ray are counted ..."""
MIN_INTERVALS = 0.8
"""... share of these parts in which some of the readings must be the same, since the robot has its parts all the time ..."""
MIN_SAME = 0.03
"""... and the share of the readings of such a part that must be."""
ELSEWHERE = ((0.5, 0.5), (1.0, 1.0), (2.0, 2.0))
"""[m, rad] Motions between a reading and a scan that looks at its place; a wide part needs large turns."""
MIN_OF_ALL = 0.1
"""Minimum share of the places that other rays look through, of those that any rays see: fewer are at the edges of walls
whose readings have constant ranges as well. Of those that the other rays see, they are the majority."""
MAX_SCANS = 200
"""Maximum number of scans whose readings are tested."""


def without_robot_parts(run: Run) -> tuple[Run, tuple[str, ...]]:
    """Return the run without the readings of the robot itself, which become nan, and a note if there are any.

    The poses of the test come from the other rays. Motions that these do not determine, as along a corridor, come from the
    odometry; without odometry, such scans test nothing.
    """
    usual = usual_ranges(run)
    if np.isnan(usual).all():
        return run, ()
    try:
        others, _ = with_checked_odometry(without_readings(run, usual))
    except SensorgraphError:  # the other rays are too few to compare them with the odometry
        return run, ()
    odometry = odometry_of(others)
    _, tracked = track_part(others, slice(None), odometry)
    if len(tracked.key_frames) == 0:
        return run, ()
    poses = np.column_stack([tracked.poses[:, :2], np.unwrap(tracked.poses[:, 2])])
    motion = odometry or motion_of_track(others, tracked)
    pieces = _pieces(tracked, has_odometry=odometry is not None)
    parts = parts_of_robot(replace(others, ranges=run.ranges), usual, poses, pieces, motion)
    if np.isnan(parts).all():
        return run, ()
    return without_readings(run, parts), (robot_parts_text(parts, run.sensor.bearings),)


def robot_parts_at_poses(run: Run, pairing: Pairing) -> Floats:
    """Return the range (n_rays,) [m] at which each ray ends at the robot itself; nan: nowhere.

    The poses of the test are those of the pairing.
    """
    usual, n = usual_ranges(run), pairing.paired.sum()
    if np.isnan(usual).all() or n < 2:
        return np.full(run.sensor.n_rays, np.nan)
    run = run.take_scans(pairing.paired)
    if run.pose_frame == "laser":
        run = replace(run, sensor=replace(run.sensor, mount=np.zeros(3)))
    return parts_of_robot(run, usual, pairing.poses[pairing.paired], np.zeros(n, dtype=np.intp))


def usual_ranges(run: Run) -> Floats:
    """Return the most frequent range (n_rays,) [m] of each ray, if the ray has it throughout the log; nan otherwise."""
    usual = np.full(run.sensor.n_rays, np.nan)
    if run.n_scans < INTERVALS or run.sensor.is_composite or run.sensor.cones.any():
        return usual
    ranges = run.ranges
    n_bins = int(REACH / MARGIN)
    near = (ranges > 0) & (ranges < REACH)
    ray = np.broadcast_to(np.arange(ranges.shape[1]), ranges.shape)[near]
    bins = np.minimum((ranges[near] / MARGIN).astype(np.intp), n_bins - 1)
    counts = np.bincount(ray * n_bins + bins, minlength=len(usual) * n_bins).reshape(-1, n_bins)
    first = (counts[:, :-1] + counts[:, 1:]).argmax(axis=1)
    within = near & (ranges >= MARGIN * first) & (ranges < MARGIN * (first + 2))
    some = within.mean(axis=0) >= MIN_SAME * MIN_INTERVALS
    usual[some] = np.nanmedian(np.where(within, ranges, np.nan)[:, some], axis=0)
    same = _same(ranges, usual)
    shares = np.array([part.mean(axis=0) for part in np.array_split(same, INTERVALS)])
    return np.where((shares >= MIN_SAME).mean(axis=0) >= MIN_INTERVALS, usual, np.nan)


def without_readings(run: Run, parts: Floats) -> Run:
    """Return the run in which the readings at the ranges of parts (n_rays,) [m] are nan."""
    return replace(run, ranges=np.where(_same(run.ranges, parts), np.nan, run.ranges))


def parts_of_robot(
    run: Run, usual: Floats, poses: Floats, pieces: Ints, motion: Motion | None = None
) -> Floats:
    """Return the usual ranges (n_rays,) [m] of the rays that end at the robot itself; nan for the others.

    Parameters
    ----------
    usual : (n_rays,) [m] as of `usual_ranges`.
    poses : (n_scans, 3) [m, m, rad] base_link in a map.
    pieces : (n_scans,) Number of the map of each pose; -1: the pose is unknown.
    motion : Motion that deskews the rays; None: no deskewing.
    """
    sensor, known = run.sensor, np.flatnonzero(pieces >= 0)
    some = known[evenly(len(known), MAX_SCANS)]
    elsewhere = {i: _elsewhere(i, poses, pieces) for i in some.tolist()}
    others = np.unique([j for scans in elsewhere.values() for j in scans]).astype(np.intp)
    views = run.take_scans(others)
    whole, rest = (
        scan_points(some_views, motion, has_normals=False)
        for some_views in (views, without_readings(views, usual))
    )
    sorted_views = cache(lambda view: (view_of(whole, whole.of(view)), view_of(rest, rest.of(view))))
    by_any, seen, through = np.zeros((3, sensor.n_rays))
    for i, scans in elsewhere.items():
        rays = np.flatnonzero(_same(run.ranges[i], usual))
        aims = laser_rays(sensor, run.stamps[i : i + 1], motion, sensor.ray_delays)[0, rays]
        away = np.column_stack([np.cos(aims[:, 2]), np.sin(aims[:, 2])])
        ends = aims[:, :2] + run.ranges[i, rays, None] * away
        for j, view in zip(scans, np.searchsorted(others, scans).tolist(), strict=True):
            points = moved_points(ends, compose(invert(poses[j]), poses[i]))
            of_whole, of_rest = sorted_views(view)
            by_any[rays] += crossed_by(of_whole, points, NOISE_MARGIN)[0]
            visible, free = crossed_by(of_rest, points, NOISE_MARGIN)
            seen[rays] += visible
            through[rays] += free
    parts = np.full(sensor.n_rays, np.nan)
    for group in _groups(usual):
        least = max(MAJORITY * seen[group].sum(), MIN_OF_ALL * by_any[group].sum(), MIN_VISIBLE)
        if through[group].sum() > least:
            parts[group] = usual[group]
    return parts


def robot_parts_text(parts: Floats, bearings: Floats) -> str:
    """Return the warning on the rays that end at parts of the robot, at ranges (n_rays,) [m] or nan."""
    index = np.flatnonzero(np.isfinite(parts))
    groups = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    spans = [np.degrees(bearings[group[[0, -1]]]) for group in groups]
    shown = ", ".join(f"{first:.0f}° to {last:.0f}°" for first, last in spans[:5])
    more = ", ..." if len(spans) > 5 else ""
    return (
        f"{len(index)} of {len(bearings)} rays see the robot itself, at bearings {shown}{more}: their range stays the same while "
        "the robot moves; these readings were left out"
    )


def _pieces(tracked: ScanTrack, *, has_odometry: bool) -> Ints:
    """Return the number (n_scans,) of the stretch of a track within which all motions are determined; -1: none."""
    sure = determines_all(settled(tracked.projections))[tracked.between_key_frames()[0]] | has_odometry
    sure &= tracked.matched
    return np.where(sure, np.cumsum(~tracked.is_continuous | ~sure), -1)


def _same(ranges: Floats, usual: Floats) -> Bools:
    """Tell which readings (n_scans, n_rays) have the usual range of their ray (n_rays,)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(ranges - usual) < MARGIN)


def _elsewhere(i: int, poses: Floats, pieces: Ints) -> list[int]:
    """Return the last scans before scan i and the first after it that are far enough from it, in the same piece."""
    moved = np.hypot(*(poses[:, :2] - poses[i, :2]).T)
    turned = np.abs(wrap(poses[:, 2] - poses[i, 2]))
    found = []
    for way, turn in ELSEWHERE:
        far = np.flatnonzero(((moved > way) | (turned > turn)) & (pieces == pieces[i]))
        after = int(np.searchsorted(far, i))
        found += far[max(after - 1, 0) : after + 1].tolist()
    return sorted(set(found))


def _groups(usual: Floats) -> list[Ints]:
    """Return the rays of each candidate part: neighbours whose usual ranges (n_rays,) are nearly equal."""
    rays = np.flatnonzero(np.isfinite(usual))
    apart = (np.diff(rays) > 1) | (np.abs(np.diff(usual[rays])) > 2 * MARGIN)
    return [group for group in np.split(rays, np.flatnonzero(apart) + 1) if len(group)]
