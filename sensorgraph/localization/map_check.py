"""A first look at a map: do short drives along the run fit it anywhere, before all scans are tracked?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from logs.run import Run
from sensorgraph.localization.front_end import track
from sensorgraph.localization.global_search import LocalView, joint_fit, local_view
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_settings import MAP_TRACKING, MapTrackingSettings
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.scans import scan_points


def looks(run: Run, settings: MapTrackingSettings = MAP_TRACKING) -> Iterator[LocalView]:
    """Yield views of short drives, evenly spaced along a run."""
    s, motion = settings, odometry_of(run)
    last = max(run.n_scans - s.look_scans, 0)
    for first in np.unique(np.linspace(0, last, s.looks).astype(np.intp)):
        part = run.take_scans(slice(int(first), int(first) + s.look_scans))
        scans = scan_points(part, motion)
        odometry = None if motion is None else motion.at(part.stamps)
        found = track(scans, part.stamps, odometry, lambda done, total: None)
        if len(found.key_frames):
            chosen = found.key_frames[found.piece == np.bincount(found.piece).argmax()]
            some = np.unique(np.linspace(0, len(chosen) - 1, min(s.rival_scans, len(chosen))).astype(np.intp))
            yield local_view(scans, chosen[some], found.poses[chosen[some]])


def best_fit(views: Iterable[LocalView], place: KnownMap, enough: float) -> float:
    """Return the best fit of the views at any place of the map, or the first that is enough; 0 without a view."""
    best = 0.0
    for view in views:
        best = max(best, joint_fit(view, place))
        if best >= enough:
            break
    return best


def mirrored(view: LocalView) -> LocalView:
    """Return a view as seen in a mirror."""
    flip = np.array([1.0, -1.0])
    return LocalView(points=view.points * flip, normals=view.normals * flip, starts=view.starts * flip)
