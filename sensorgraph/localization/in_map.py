"""Locate a run in a known place: laser odometry, tracking in the map, and smoothing of all poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from logs.run import Run
from logs.transforms import compose, distances_along, invert
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.contrast import contrast_notes
from sensorgraph.localization.displaced_walls import StraightWalls, displacement_errors
from sensorgraph.localization.global_search import evenly, fit_at, local_view
from sensorgraph.localization.known_map import KnownMap, known_map
from sensorgraph.localization.map_check import DRIVE_SCANS, best_fit, looks, mirrored
from sensorgraph.localization.map_tracking import REMATCH_DEVIATIONS, MapMatches, MapTracker, rematch
from sensorgraph.localization.matching import CORRELATION
from sensorgraph.localization.moving_returns import with_motion_of_scans
from sensorgraph.localization.result import Localization, Status, interval_notes
from sensorgraph.localization.rival_places import rivals_of_drives
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import FRONT_END, GLOBAL_SEARCH, MAP_TRACKING
from sensorgraph.localization.smoothing import smooth, steps_of
from sensorgraph.localization.tracked_run import track_run
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.models.seen_space import SeenSpace
from sensorgraph.types import Bools, Floats, ProgressBars, no_progress

MIRROR_LOOKS = 2
"""Number of short drives that are searched as seen in a mirror."""
MIRROR_LEAD = 0.2
"""Minimum lead of a mirrored fit."""
OFFSET_SCANS = 100
"""Number of scans that show how much of an offset of the ranges the map has, too."""


def locate_in_map(
    run: Run,
    walls: Floats,
    *,
    seen: SeenSpace | None = None,
    normals: Floats | None = None,
    straight: StraightWalls | None = None,
    name: str = "the map",
    progress: ProgressBars = no_progress,
) -> Localization:
    """Estimate all poses of a run in a known place, without an initial pose.

    Parameters
    ----------
    walls, seen, normals, straight : As in `MapWalls`.
    name : Name of the map in messages.

    Raises
    ------
    SensorgraphError : The scans fit nowhere in the map, or the map has no wall.
    """
    if run.n_scans == 0:
        raise SensorgraphError("the run has no scan; expected messages on /scan")
    place = known_map(walls, seen, normals, straight)
    with progress("looking for the scans in the map", "drives"):
        fit = best_fit(looks(run), place)
        if fit < MAP_TRACKING.near_fit:
            raise SensorgraphError(_no_fit(run, place, fit, name))
    followed = with_motion_of_scans(track_run(run, progress), progress)
    odometry, scans, steps, offset = followed.odometry, followed.scans, followed.track, followed.offset
    with progress(f"locating in {name}", "scans") as tick:
        found = MapTracker(scans, run.stamps, steps, place).run(tick)
    if np.isnan(found.poses[:, 0]).all():
        fit = _rivals_fit(scans, steps, place, found.rivals)
        if fit < GLOBAL_SEARCH.accept_fit:
            raise SensorgraphError(_no_fit(run, place, max(fit, found.best_fit), name))
    with progress("comparing with other places", "scans") as tick:
        is_rivalled, others = rivals_of_drives(found, tick)
    poses, corrected = _filled(found, steps), _seen_against(place, scans, found.poses, offset.value)
    scans = scans.lengthened(offset.value - corrected)
    with progress("smoothing", "scans") as tick:
        start = _smoothed(poses, steps, found.breaks, found.poses, found.information)[0]
        start[np.isnan(found.poses[:, 0])] = np.nan
        matches = rematch(scans, start, place, tick)
    poses, covariances = _smoothed(poses, steps, found.breaks, matches.poses, matches.information)
    covariances = covariances + _map_error(matches, steps.noise, *_displacements(scans, matches, straight))
    matched = np.asarray(matches.information.any(axis=(1, 2)))
    poses, covariances = followed.between_middles(poses, covariances, matched, ~found.breaks)
    status = _status(run.stamps, matches.information, found, is_rivalled)
    notes = () if odometry is not None else ("no usable odometry: located by scan matching alone",)
    if 2 * sum(word == "ok" for word in status) < run.n_scans:
        text = f"most scans are not located: at best, a short drive fits {name} to {100 * fit:.0f} %, as parts of another building may"
        notes = (*notes, text)
    wheels = WheelSteps.of(odometry, steps, run.stamps).parameters(poses[steps.key_frames])
    contrast = contrast_notes(run, poses, odometry, status, wheels)
    return Localization(
        t=run.stamps,
        poses=poses,
        covariances=covariances,
        status=status,
        wheels=wheels,
        rivals=found.rivals | others,
        notes=(
            *notes,
            *contrast,
            *followed.notes,
            *offset.notes(name, corrected),
            *interval_notes(run.stamps, status, "lost", "ambiguous"),
        ),
        sensor=followed.run.sensor,
        range_offset=offset.value,
    )


def _seen_against(place: KnownMap, scans: ScanPoints, poses: Floats, offset: float) -> float:
    """Return the part of an offset of the ranges [m] that the map does not have: none of it if the same laser drew the map.

    The squared scatter of the returns about the walls is a parabola in the correction, and least at the right one.

    Parameters
    ----------
    scans : Corrected by all of the offset.
    poses : (n_scans, 3) [m, m, rad] nan: not located.
    """
    if not offset:
        return 0.0
    located = np.flatnonzero(np.isfinite(poses[:, 0]))
    some = np.full_like(poses, np.nan)
    chosen = located[evenly(len(located), OFFSET_SCANS)]
    some[chosen] = poses[chosen]
    squares = np.stack([
        rematch(scans.lengthened(share * offset), some, place, lambda done, total: None).noise ** 2
        for share in (1.0, 0.5, 0.0)  # corrected by none, half and all
    ])  # fmt: skip
    none, half, every = squares[:, np.isfinite(squares).all(axis=0)].sum(axis=1)
    curvature = none - 2 * half + every
    if curvature <= 0:
        return offset if every < none else 0.0
    return offset * float(np.clip(0.5 + 0.25 * (none - every) / curvature, 0.0, 1.0))


def _smoothed(
    poses: Floats, steps: ScanTrack, breaks: Bools, places: Floats, information: Floats
) -> tuple[Floats, Floats]:
    """Return poses and covariances of the whole run."""
    relative, step_information = steps_of(steps, breaks)
    values, vectors = np.linalg.eigh(
        information
    )  # along a wall the information can have a negative eigenvalue
    weighted = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1) / CORRELATION
    result = smooth(poses, relative, step_information, np.where(np.isfinite(places), places, 0.0), weighted)
    return result.poses, result.covariances


def _displacements(
    scans: ScanPoints, matches: MapMatches, straight: StraightWalls | None
) -> tuple[Floats, Floats]:
    """Return the covariances (n, 3, 3) and the scatter (n,) [m²] from walls displaced within their cells; otherwise 0."""
    if straight is None:
        return np.zeros((len(matches.poses), 3, 3)), np.zeros(len(matches.poses))
    return displacement_errors(scans, matches.poses, matches.noise, straight, np.asarray(REMATCH_DEVIATIONS))


def _map_error(matches: MapMatches, own_noise: Floats, displaced: Floats, scatter: Floats) -> Floats:
    """Return the covariances (n, 3, 3) added by errors of the map.

    Displaced walls scatter the returns. The position deviation `off` follows from

        off² = (map_share² · excess + (map_share_of_noise · own)²) / agreement²,
        excess = max(max(noise, usual)² - own² - scatter, 0).

    The scatter of a scan's returns around the map is `noise`, and its median is `usual`. The share of returns
    on walls is `agreement`. `own` is the median of `own_noise` (n,) [m], the scatter around the surfaces of
    the preceding scans, but at most `usual`. Walls displaced within the cells of a map cause the covariances `displaced`
    (n, 3, 3), which are added, and part of the scatter, `scatter` (n,) [m²].

    Smoothing does not reduce the map's errors, since neighbouring scans meet the same walls. Where a scan
    scatters more than usual, the map is worse there. Walls displaced as a whole cause no scatter; the term
    with `own` accounts for them. The fewer returns lie on walls, the less the others correct, hence the
    division by `agreement`. An unmatched scan takes interpolated values of its neighbours.
    """
    s, noise, known = MAP_TRACKING, matches.noise, np.isfinite(matches.noise)
    usual = float(np.median(noise[known])) if known.any() else 0.0
    own = min(float(np.nanmedian(own_noise)), usual) if np.isfinite(own_noise).any() else usual
    excess = np.maximum(np.fmax(noise, usual) ** 2 - own**2 - scatter, 0.0)
    off = np.sqrt(s.map_share**2 * excess + (s.map_share_of_noise * own) ** 2)
    if known.any():
        at = np.arange(len(noise))
        off = off / np.interp(at, at[known], matches.agreement[known])
    variances = np.asarray(s.place_floor) ** 2 + (off[:, None] * [1.0, 1.0, s.map_turn]) ** 2
    return np.asarray(displaced + variances[:, None, :] * np.eye(3))


def _filled(found: MapTracker, steps: ScanTrack) -> Floats:
    """Return poses (n, 3) for all scans; unknown ones follow by laser odometry from the nearest known one."""
    poses = found.poses.copy()
    if np.isnan(poses[:, 0]).all():
        first = min(found.rivals)
        poses[first] = found.rivals[first][0]
    known, every = np.flatnonzero(np.isfinite(poses[:, 0])), np.arange(len(poses))
    nearest = known[
        np.clip(np.searchsorted(known, every, side="right") - 1, 0, None)
    ]  # the last one, or the first
    lost = np.isnan(poses[:, 0])
    way = compose(invert(steps.poses[nearest[lost]]), steps.poses[lost])
    poses[lost] = compose(poses[nearest[lost]], way)
    return poses


def _status(stamps: Floats, information: Floats, found: MapTracker, is_rivalled: Bools) -> tuple[Status, ...]:
    """Return the status of each scan: ok if it fits the map, or is close in time to one that does, on a drive without rivals."""
    good = np.flatnonzero(information.any(axis=(1, 2)))
    is_ok = np.zeros(len(stamps), dtype=np.bool_)
    if len(good):
        after = good[np.clip(np.searchsorted(good, np.arange(len(stamps))), 0, len(good) - 1)]
        before = good[np.clip(np.searchsorted(good, np.arange(len(stamps)), side="right") - 1, 0, None)]
        near = np.minimum(np.abs(stamps[after] - stamps), np.abs(stamps - stamps[before]))
        is_ok = (near <= FRONT_END.patience) & np.isfinite(found.poses[:, 0])
    is_ambiguous = _ambiguous(is_ok, found) | is_rivalled
    is_ok &= ~is_rivalled
    words: dict[bool, Status] = {True: "ambiguous", False: "lost"}
    return tuple("ok" if ok else words[bool(a)] for ok, a in zip(is_ok, is_ambiguous, strict=True))


def _ambiguous(is_ok: Bools, found: MapTracker) -> Bools:
    """Tell which scans are in an interval without a pose in which a search had several answers."""
    starts = np.flatnonzero(np.diff(np.concatenate([[True], is_ok])) & ~is_ok)
    out = np.zeros(len(is_ok), dtype=np.bool_)
    for start in starts:
        stop = start + int(np.argmax(np.append(is_ok[start:], True)))
        out[start:stop] = any(start <= k < stop for k in found.rivals)
    return out


def _rivals_fit(scans: ScanPoints, steps: ScanTrack, place: KnownMap, rivals: Mapping[int, Floats]) -> float:
    """Return the best fit of the drive around a search at the places that the search found.

    A single scan fits many places of a wrong map; scans along several metres do not.
    """
    fits = [0.0]
    driven = distances_along(steps.poses)
    piece = np.cumsum(~steps.is_continuous)
    for k, poses in rivals.items():
        near = np.flatnonzero(
            (piece == piece[k]) & (np.abs(driven - driven[k]) <= MAP_TRACKING.usual_distance)
        )
        some = near[evenly(len(near), DRIVE_SCANS)]
        chosen = np.append(some[some != k], k)
        view = local_view(scans, chosen, steps.poses[chosen])
        for pose in poses:
            fits.append(fit_at(view, place, pose))
    return max(fits)


def _no_fit(run: Run, place: KnownMap, fit: float, name: str) -> str:
    """Return the message that the scans fit nowhere, or only when mirrored."""
    least = max(fit + MIRROR_LEAD, GLOBAL_SEARCH.accept_fit)
    if best_fit((mirrored(look) for look in looks(run, MIRROR_LOOKS)), place, least) >= least:
        return (
            f"the scans fit {name} only as seen in a mirror: the laser counts its rays clockwise; state this in "
            "robot.yaml or in the transform"
        )
    if fit >= GLOBAL_SEARCH.accept_fit:
        return (
            f"the scans fit nowhere in {name} along a drive: a single view fits by {100 * fit:.0f} %, but the next ones do not "
            "continue there. The map is of another place, or of another scale; give the map of the recorded place in metres, "
            "or no map"
        )
    return (
        f"the scans fit nowhere in {name}: the best fit (share of returns on walls, minus twice the share through walls) is "
        f"{100 * max(fit, 0):.0f} %, expected {100 * GLOBAL_SEARCH.accept_fit:.0f} %. The map is of another place, or of another scale; give the "
        "map of the recorded place in metres, or no map"
    )
