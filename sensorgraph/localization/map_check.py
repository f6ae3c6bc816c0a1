"""A first look at a map: do short drives along the run fit it anywhere, before all scans are tracked?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.front_end import track_part
from sensorgraph.localization.global_search import LocalView, evenly, fit_at, joint_fit, local_view
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_settings import MAP_TRACKING, MapTrackingSettings
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.types import Bools, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """A short drive, and the run that contains it."""

    run: Run
    motion: Motion | None
    """The odometry of the run."""
    first: int
    """First scan of the drive."""
    view: LocalView
    last: int
    """Scan in whose frame the view is."""


def looks(run: Run, settings: MapTrackingSettings = MAP_TRACKING) -> Iterator[Look]:
    """Yield short drives, evenly spaced along a run."""
    n, motion = settings.look_scans, odometry_of(run)
    for first in evenly(max(run.n_scans - n, 0) + 1, settings.looks).tolist():
        scans, found = track_part(run, slice(first, first + n), motion)
        if len(found.key_frames):
            view, last_scan = _view(scans, found, found.piece == np.bincount(found.piece).argmax(), settings)
            yield Look(run=run, motion=motion, first=first, view=view, last=first + last_scan)


def best_fit(looks: Iterable[Look], place: KnownMap, settings: MapTrackingSettings = MAP_TRACKING) -> float:
    """Return the best fit of the drives at any place of the map, or the first that is enough; 0 without a drive.

    A fit of `near_fit` is enough. One between `near_fit` and `found_fit` counts at most as much as the better fit of
    the scans before and after the drive, if there are any.
    """
    best, s = 0.0, settings
    for look in looks:
        fit, pose = joint_fit(look.view, place)
        if s.near_fit <= fit < s.found_fit:
            fit = min(fit, max(_fits_beside(look, place, pose, s), default=fit))
        best = max(best, fit)
        if best >= s.near_fit:
            break
    return best


def mirrored(look: Look) -> Look:
    """Return a drive as seen in a mirror."""
    flip, view = np.array([1.0, -1.0]), look.view
    return replace(
        look,
        view=LocalView(points=view.points * flip, normals=view.normals * flip, starts=view.starts * flip),
    )


def _fits_beside(look: Look, place: KnownMap, pose: Floats, settings: MapTrackingSettings) -> list[float]:
    """Return the fits of the scans before and after a drive, if its view is at a pose (3,) of the map."""
    n = settings.look_scans
    start = max(look.first - n, 0)
    scans, found = track_part(look.run, slice(start, look.first + 2 * n), look.motion)
    at = found.key_frames + start
    piece = found.piece[max(int(np.searchsorted(at, look.last, side="right")) - 1, 0)]
    fits = []
    for beside in (at < look.first, at >= look.first + n):
        chosen = beside & (found.piece == piece)
        if chosen.any():
            view, last = _view(scans, found, chosen, settings)
            step = compose(invert(found.poses[look.last - start]), found.poses[last])
            fits.append(fit_at(view, place, compose(pose, step)))
    return fits


def _view(
    scans: ScanPoints, found: ScanTrack, chosen: Bools, settings: MapTrackingSettings
) -> tuple[LocalView, int]:
    """Return the view of some key frames, chosen by a mask (n_key,), and the scan in whose frame it is."""
    frames = found.key_frames[chosen]
    frames = frames[evenly(len(frames), settings.rival_scans)]
    return local_view(scans, frames, found.poses[frames]), int(frames[-1])
