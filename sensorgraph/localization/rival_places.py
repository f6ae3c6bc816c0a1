"""Places that explain a located drive as well as the one at which it was tracked.

Tracking begins at a place that one search found without a rival. This search sees a few metres and evaluates a limited number
of places; on a floor of many rooms with one shape, it can miss the true one. So a whole drive is a hypothesis, and so is the same
drive elsewhere: with x_k the tracked pose of scan k, and p a place that a search finds for the scans around k,

    rival poses = H ∘ x,  H = p ∘ inv(x_k).

All hypotheses are evaluated by the same scans along the drive, by the criterion of `GlobalPlaces.rivals`. Each scan counts as
much as in a search by it alone; so the standard error of a fit decreases with the number of points n of all scans:

    margin(n) = RIVAL_MARGIN √(POINTS / n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.global_search import (
    APART,
    CORRELATION,
    POINTS,
    RIVAL_MARGIN,
    GlobalPlaces,
    LocalView,
    evenly,
    local_view,
    quick_places,
)
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_check import DRIVE_SCANS, LOOKS
from sensorgraph.localization.map_tracking import MapTracker
from sensorgraph.localization.matching import match
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import GLOBAL_SEARCH, MAP_TRACKING
from sensorgraph.types import Bools, Floats, Ints, Progress


def rivals_of_drives(found: MapTracker, progress: Progress) -> tuple[Bools, dict[int, Floats]]:
    """Find the drives that another place explains as well.

    A drive is a stretch of tracked scans without a break: odometry connects its scans even where the robot was lost.

    Returns
    -------
    Whether each scan (n_scans,) is tracked on a drive with rivals; and the last scan of each such drive -> its possible places
    (n, 3), the tracked one first.
    """
    is_rivalled = np.zeros(len(found.poses), dtype=np.bool_)
    places: dict[int, Floats] = {}
    is_tracked = np.isfinite(found.poses[:, 0])
    drives = np.cumsum(found.breaks)
    for number in np.unique(drives[is_tracked]):
        scans = np.flatnonzero(is_tracked & (drives == number))
        motions = _motions_to_rivals(found, scans)
        last = int(scans[-1])
        progress(last, len(found.poses))
        if len(motions):
            is_rivalled[scans] = True
            places[last] = np.vstack([found.poses[last], _moved(motions, found.poses[last])])
    return is_rivalled, places


def drive_view(scans: ScanPoints, chosen: Ints, poses: Floats) -> LocalView:
    """Return the view of at most `DRIVE_SCANS` of some scans, with poses (n_scans, 3) of all scans in one frame."""
    some = chosen[evenly(len(chosen), DRIVE_SCANS)]
    return local_view(scans, some, poses[some], points_per_scan=POINTS)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Look:
    """The scans of one part of a drive."""

    view: LocalView
    pose: Floats
    """(3,) Tracked pose of the view in map."""

    def motions_elsewhere(self, place: KnownMap) -> Floats:
        """Return the motions H (n, 3) of the drive to other places that fit this part."""
        poses = quick_places(self.view, place).poses
        off = poses - self.pose
        is_far = (np.hypot(off[:, 0], off[:, 1]) >= APART[0]) | (np.abs(wrap(off[:, 2])) >= APART[1])
        back = invert(self.pose)
        return compose(poses, np.broadcast_to(back, poses.shape))[is_far]

    def evaluate(self, motions: Floats, place: KnownMap) -> Floats:
        """Return log likelihood and numbers of returns on surfaces, hidden, and unseen (n, 4) after motions (n, 3)."""
        points, normals = self.view.points, self.view.normals
        found = [match(points, normals, place.surfaces, start) for start in _moved(motions, self.pose)]
        judged = place.judge(np.array([one.pose for one in found]), points, self.view.starts)
        shares = np.column_stack([[one.agreement for one in found], judged.hidden, judged.unseen])
        return np.column_stack([judged.likelihoods, len(points) * shares])


def _motions_to_rivals(found: MapTracker, scans: Ints) -> Floats:
    """Return the motions H (n, 3) of a drive, given by its scans (n_scans,), to places that cannot be ruled out."""
    driven = found.driven[scans] - found.driven[scans[0]]
    part = (driven / (2 * MAP_TRACKING.usual_distance)).astype(np.intp)
    looks = []
    for number in np.unique(part):
        view = drive_view(found.scans, scans[part == number], found.poses)
        last = scans[part == number][-1]
        if len(view.points):
            looks.append(_Look(view=view, pose=found.poses[last]))
    searched = evenly(len(looks), LOOKS).tolist()
    motions = np.vstack([np.zeros((1, 3)), *(looks[k].motions_elsewhere(found.place) for k in searched)])
    total, n_points = np.zeros((len(motions), 4)), 0
    for k in [*searched, *np.setdiff1d(np.arange(len(looks)), searched)]:
        if len(motions) == 1:
            break
        total += looks[k].evaluate(motions, found.place)
        n_points += len(looks[k].view.points)
        if k not in searched[:-1]:
            kept = _possible(motions, total, n_points)
            motions, total = motions[kept], total[kept]
    return motions[1:]


def _possible(motions: Floats, total: Floats, n_points: int) -> Bools:
    """Return which motions (n, 3), the first of which is none, cannot be ruled out by their evaluations (n, 4)."""
    scores = (total[:, 0] - total[:, 0].max()) / CORRELATION
    weights = np.exp(scores)
    agreements, hidden, unseen = total[:, 1:].T / n_points
    places = GlobalPlaces(
        poses=motions,
        probabilities=weights / weights.sum(),
        agreements=agreements,
        hidden=hidden,
        unseen=unseen,
        min_seen=GLOBAL_SEARCH.min_seen_anywhere,
        margin=RIVAL_MARGIN * float(np.sqrt(POINTS / n_points)),
    )
    return np.concatenate([[True], places.is_rival])


def _moved(motions: Floats, pose: Floats) -> Floats:
    """Return a pose (3,) after each of motions (n, 3)."""
    return compose(motions, np.broadcast_to(pose, motions.shape))
