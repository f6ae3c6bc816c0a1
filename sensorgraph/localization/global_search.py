"""Global search for a robot in a known place: branch and bound, fine matches, and evaluation by the beam model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.matching import START_OFFSET, match
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import GLOBAL_SEARCH
from sensorgraph.types import Bools, Floats, Ints

POINTS = 160
"""Maximum number of points of a view; a quick search finds places with half of them, and evaluates these with all."""
MIN_POINTS = 25
"""Minimum number of points of a view or of a scan to be matched, and lower limit of the number taken from each scan of a view."""
HEADING_STEP = 0.0175
"""[rad] Step between headings."""
MIN_SCORE = 0.25
"""Minimum mean of the field at the points."""
MIN_JOINT_FIT = 0.25
"""Minimum fit of all scans at a place that the last scan alone fits: the map may lack what the other scans observed, but they
must not contradict the place."""
APART = (0.5, 0.26)
"""[m], [rad] Distance and heading difference below which two places are the same."""
CORRELATION = 4.0
"""Factor by which the log likelihood of a view is divided, since its rays meet the same surfaces."""
RIVAL_MARGIN = 0.05
"""Standard error of a fit: for a share of 0.85 of `POINTS` / `CORRELATION` points."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How many places a search evaluates."""

    rival_ratio: float
    """Share of the best field score down to which places are evaluated with the beam model."""
    modes: int
    """Maximum number of places that are evaluated."""
    matches: int
    """Number of the best places that are matched and evaluated again."""
    restarts: int
    """Number of the best matches around which matches start again."""


FULL = Effort(rival_ratio=0.6, modes=120, matches=40, restarts=5)
QUICK = Effort(rival_ratio=0.85, modes=12, matches=12, restarts=2)


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalView:
    """Returns of one or several scans, in the frame of one of them."""

    points: Floats
    """(n, 2) [m] Returns in base_link of that scan."""
    normals: Floats
    """(n, 2) Unit normals, or 0, 0."""
    starts: Floats
    """(n, 2) [m] Origins of the rays."""
    last: LocalView | None = None
    """View of the last scan alone, with more of its points; None for a single scan."""

    @property
    def last_scan(self) -> LocalView:
        """View of the last scan alone. Several scans together extend farther beyond an incomplete map."""
        return self if self.last is None else self.last


@dataclass(frozen=True, kw_only=True, eq=False)
class GlobalPlaces:
    """Possible places of a view, the most probable first."""

    poses: Floats
    """(n, 3) [m, m, rad] base_link in map."""
    probabilities: Floats
    """(n,) Probabilities; the sum is 1."""
    agreements: Floats
    """(n,) Share of the points on surfaces of the map."""
    hidden: Floats
    """(n,) Share of the points that walls of the map should have hidden."""
    unseen: Floats
    """(n,) Share of the points in unobserved space."""
    min_seen: float = GLOBAL_SEARCH.min_seen
    """Parameter of `fits`."""
    margin: float = RIVAL_MARGIN
    """Standard error of `fits`."""
    last_fit: float = 0.0
    """Best `fit_of` the last scan alone at the first place and its rivals; 0 if it does not fit or was not
    evaluated."""

    @property
    def fits(self) -> Floats:
        """(n,) `fit_of` each place."""
        return _fits(self.agreements, self.hidden, self.unseen, self.min_seen)

    @property
    def fit(self) -> float:
        """Best of `fits` and `last_fit`; 0 without any place."""
        return max(float(self.fits.max()), self.last_fit) if len(self.poses) else 0.0

    @property
    def lead(self) -> float:
        """Difference between the fit of the first place and that of the next best; infinite for a single place."""
        fits = self.fits
        return float(fits[0] - fits[1:].max()) if len(fits) > 1 else np.inf

    @property
    def is_rival(self) -> Bools:
        """(n - 1,) Which of the places after the first cannot be ruled out.

        A place that fits as well as the first is a rival even if its rays are less likely. Rays that all pass
        one opened door, or leave the map, are one deviation, not many.
        """
        fits = self.fits
        can_be = (self.probabilities > GLOBAL_SEARCH.rival_probability) | (fits >= fits[:1] - self.margin)
        return can_be[1:]

    @property
    def rivals(self) -> Floats:
        """(n, 3) Other places that cannot be ruled out; empty if the first place is unique."""
        return self.poses[1:][self.is_rival]


def fit_of(agreement: float, hidden: float, unseen: float, min_seen: float = GLOBAL_SEARCH.min_seen) -> float:
    """Return the fit of a view at a place: (agreement - hidden_weight · hidden) / max(1 - unseen, min_seen).

    Parameters
    ----------
    agreement : Share of the returns on surfaces.
    hidden : Share of the returns that walls should have hidden.
    unseen : Share of the returns in unobserved space.
    min_seen : Lower limit of the observed share.
    """
    on_surfaces = agreement - GLOBAL_SEARCH.hidden_weight * hidden
    return float(on_surfaces / max(1.0 - float(unseen), min_seen))


def _fits(agreements: Floats, hidden: Floats, unseen: Floats, min_seen: float) -> Floats:
    shares = zip(agreements, hidden, unseen, strict=True)
    return np.array([fit_of(*of_place, min_seen) for of_place in shares])


def local_view(
    scans: ScanPoints, chosen: Ints, poses: Floats, *, points_per_scan: int | None = None
) -> LocalView:
    """Join scans into a view in the frame of the last one, and thin it.

    Parameters
    ----------
    chosen : (n,) Scans.
    poses : (n, 3) Their poses in one frame, accurate relative to each other.
    points_per_scan : Maximum number of points of each scan. None: `POINTS` of the view, or `MIN_POINTS` of each scan.
    """
    last = None if len(chosen) == 1 else local_view(scans, chosen[-1:], poses[-1:])
    most = max(POINTS // len(chosen), MIN_POINTS) if points_per_scan is None else points_per_scan
    parts: tuple[list[Floats], list[Floats], list[Floats]] = ([], [], [])
    for scan, (x, y, phi) in zip(chosen, compose(invert(poses[-1]), poses), strict=True):
        own = np.arange(scans.first[scan], scans.first[scan + 1])
        own = own[evenly(len(own), most)]
        turn = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        parts[0].append(scans.points[own] @ turn + (x, y))
        parts[1].append(scans.normals[own] @ turn)
        parts[2].append(scans.starts[own] @ turn + (x, y))
    points, normals, starts = (np.concatenate(part) for part in parts)
    return LocalView(points=points, normals=normals, starts=starts, last=last)


def evenly(n: int, most: int) -> Ints:
    """Return at most `most` of the numbers 0 to n - 1, evenly spaced."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(np.intp))


def find_places(view: LocalView, place: KnownMap, *, window: SearchWindow | None = None) -> GlobalPlaces:
    """Return the possible places of a view in a window (None: the whole map); empty if it fits nowhere.

    The search uses the last scan first, and all scans together evaluate the places found. Since the map may
    lack what the other scans observed, it suffices that the last scan alone fits the most probable place. If
    neither fits, the search uses all scans together.
    """
    s, last = GLOBAL_SEARCH, view.last_scan
    seen = s.min_seen_anywhere if window is None else s.min_seen
    found = _judged(_modes(last.points, place, window), view, place, seen)
    if found.fit >= s.accept_fit or view.last is None:
        return found
    found = _with_last_fit(found, last, place)
    if found.fit >= s.accept_fit:
        return found
    other = _judged(_modes(view.points, place, window), view, place, seen)
    other = _with_last_fit(other, last, place)
    return other if other.fit > found.fit else found


def quick_places(view: LocalView, place: KnownMap) -> GlobalPlaces:
    """Return the possible places of all scans of a view together in the whole map, by a quick search of few places."""
    points = view.points[evenly(len(view.points), POINTS // 2)]
    modes = _modes(points, place, None, QUICK)
    return _judged(modes, view, place, GLOBAL_SEARCH.min_seen_anywhere, QUICK)


def joint_fit(view: LocalView, place: KnownMap) -> tuple[float, Floats]:
    """Return the best fit of all scans of a view together in the whole map, and its pose (3,).

    Without a place, the fit is 0 and the pose nan.
    """
    found = quick_places(view, place)
    return (found.fit, found.poses[found.fits.argmax()]) if len(found.poses) else (0.0, np.full(3, np.nan))


def fit_at(view: LocalView, place: KnownMap, pose: Floats) -> float:
    """Return the fit of all scans of a view together near a pose (3,)."""
    one = match(view.points, view.normals, place.surfaces, pose)
    judged = place.judge(one.pose[None], view.points, view.starts)
    return fit_of(one.agreement, judged.hidden[0], judged.unseen[0])


def _with_last_fit(found: GlobalPlaces, last: LocalView, place: KnownMap) -> GlobalPlaces:
    """Add the fit of the last scan alone, at places that all scans together neither rule out nor contradict."""
    possible = np.vstack([found.poses[:1], found.rivals])
    if len(possible) == 0 or found.fit < MIN_JOINT_FIT:
        return found
    own = [match(last.points, last.normals, place.surfaces, pose) for pose in possible]
    judged = place.judge(np.array([one.pose for one in own]), last.points, last.starts)
    agreements = np.array([one.agreement for one in own])
    fits = _fits(agreements, judged.hidden, judged.unseen, found.min_seen)
    best = float(fits.max())
    return found if best < GLOBAL_SEARCH.accept_fit else replace(found, last_fit=best)


def _modes(points: Floats, place: KnownMap, window: SearchWindow | None, effort: Effort = FULL) -> Floats:
    """Return poses (n, 3) from which points (m, 2) fit the field."""
    if len(points) < MIN_POINTS:
        return np.zeros((0, 3))
    return place.pyramid.search(
        points,
        place.window if window is None else window,
        heading_step=HEADING_STEP,
        min_score=MIN_SCORE,
        max_modes=effort.modes,
        rival_ratio=effort.rival_ratio,
        apart=APART,
    ).poses


def _judged(
    modes: Floats, view: LocalView, place: KnownMap, min_seen: float, effort: Effort = FULL
) -> GlobalPlaces:
    """Return places near modes (n, 3), evaluated with all rays of a view."""
    if len(modes) == 0:
        empty = np.zeros(0)
        return GlobalPlaces(poses=modes, probabilities=empty, agreements=empty, hidden=empty, unseen=empty)
    likely = place.judge(modes, view.points, view.starts).likelihoods
    starts = modes[np.argsort(-likely, kind="stable")[: effort.matches]]
    found = [match(view.points, view.normals, place.surfaces, pose) for pose in starts]
    poses = np.array([one.pose for one in found])
    judged = place.judge(poses, view.points, view.starts)
    first = poses[np.argsort(-judged.likelihoods, kind="stable")[: effort.restarts]]
    found += [match(view.points, view.normals, place.surfaces, pose) for pose in _neighbours(first)]
    poses = np.array([one.pose for one in found])
    judged = place.judge(poses, view.points, view.starts)
    scores = judged.likelihoods / CORRELATION
    order = _distinct(poses, scores)
    weights = np.exp(scores[order] - scores[order[0]])
    return GlobalPlaces(
        poses=poses[order],
        probabilities=weights / weights.sum(),
        agreements=np.array([found[k].agreement for k in order]),
        hidden=judged.hidden[order],
        unseen=judged.unseen[order],
        min_seen=min_seen,
    )


def _neighbours(poses: Floats) -> Floats:
    """Return the eight neighbours of each of poses (n, 3), by `START_OFFSET`: (8 n, 3).

    The field has one place within `APART`, but close walls can hold a match at several poses.
    """
    way = START_OFFSET
    steps = np.array([(x, y, 0.0) for x in (-way, 0.0, way) for y in (-way, 0.0, way) if x or y])
    around: Floats = (poses[:, None] + steps).reshape(-1, 3)
    return around


def _distinct(poses: Floats, scores: Floats) -> Ints:
    """Return the indices of distinct places, in order of decreasing score."""
    kept: list[int] = []
    for k in np.argsort(-scores, kind="stable"):
        way = poses[kept] - poses[k]
        is_near = (np.hypot(way[:, 0], way[:, 1]) < APART[0]) & (np.abs(wrap(way[:, 2])) < APART[1])
        if not is_near.any():
            kept.append(int(k))
    return np.array(kept, dtype=np.intp)
