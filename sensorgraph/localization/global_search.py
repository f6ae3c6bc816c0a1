"""Find a robot in a known place without a guess: branch and bound, fine matches, and the beam model to judge them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_settings import GLOBAL_SEARCH, GlobalSearchSettings
from sensorgraph.localization.matching import match
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalView:
    """Returns of one scan or several, seen from one of them."""

    points: Floats
    """(n, 2) [m] in base_link of that scan."""
    normals: Floats
    """(n, 2) unit normals, or 0, 0."""
    starts: Floats
    """(n, 2) [m] where the rays begin."""
    last: LocalView | None = None
    """The last scan alone, with more of its points; None: there is no other."""

    @property
    def last_scan(self) -> LocalView:
        """The view of the last scan alone: what all see together reaches farther into what a map lacks."""
        return self if self.last is None else self.last


@dataclass(frozen=True, kw_only=True, eq=False)
class GlobalPlaces:
    """Where a view may have been taken, the most probable place first."""

    poses: Floats
    """(n, 3) [m, m, rad] base_link in map."""
    probabilities: Floats
    """(n,) that sum to 1."""
    agreements: Floats
    """(n,) share of the points that lie on surfaces of the map."""
    hidden: Floats
    """(n,) share of the points that walls of the map should have hidden."""
    unseen: Floats
    """(n,) share of the points of which the map says nothing."""
    least_seen: float = GLOBAL_SEARCH.least_seen
    """Of `fits`."""
    last_fit: float = 0.0
    """The best `fit_of` the last scan alone at the first place and its rivals; 0: it does not fit, or was not asked."""

    @property
    def fits(self) -> Floats:
        """(n,) `fit_of` each place."""
        return _fits(self.agreements, self.hidden, self.unseen, self.least_seen)

    @property
    def fit(self) -> float:
        """The best of `fits` and `last_fit`; 0 without any place."""
        return max(float(self.fits.max()), self.last_fit) if len(self.poses) else 0.0

    @property
    def lead(self) -> float:
        """By how much the first place fits better than any other; infinite without another."""
        fits = self.fits
        return float(fits[0] - fits[1:].max()) if len(fits) > 1 else np.inf

    @property
    def rivals(self) -> Floats:
        """(n, 3) other places that cannot be ruled out; none if the first is the place.

        A place that fits as well as the first is a rival though its rays are less likely: rays that all go through one
        opened door, or beyond the map, are one surprise, not many.
        """
        fits = self.fits
        can_be = (self.probabilities > GLOBAL_SEARCH.rival_probability) | (
            fits >= fits[:1] - GLOBAL_SEARCH.rival_margin
        )
        return self.poses[1:][can_be[1:]]


def fit_of(
    agreement: float, hidden: float, unseen: float, least_seen: float = GLOBAL_SEARCH.least_seen
) -> float:
    """Return the share of the returns on surfaces, less `hidden_weight` times those through walls.

    Shares are of the returns of which the map says something; of `least_seen` of all where those are fewer.
    """
    on_surfaces = agreement - GLOBAL_SEARCH.hidden_weight * hidden
    return float(on_surfaces / max(1.0 - float(unseen), least_seen))


def _fits(agreements: Floats, hidden: Floats, unseen: Floats, least_seen: float) -> Floats:
    shares = zip(agreements, hidden, unseen, strict=True)
    return np.array([fit_of(*of_place, least_seen) for of_place in shares])


def local_view(
    scans: ScanPoints, chosen: Ints, poses: Floats, settings: GlobalSearchSettings = GLOBAL_SEARCH
) -> LocalView:
    """Join scans into a view from the last one, and thin it.

    Parameters
    ----------
    chosen : (n,) scans
    poses : (n, 3) of these in one frame, right from one to the next
    """
    last = None if len(chosen) == 1 else local_view(scans, chosen[-1:], poses[-1:], settings)
    most = max(settings.points // len(chosen), settings.least_points)
    parts: tuple[list[Floats], list[Floats], list[Floats]] = ([], [], [])
    for scan, (x, y, phi) in zip(chosen, compose(invert(poses[-1]), poses), strict=True):
        own = np.arange(scans.first[scan], scans.first[scan + 1])
        own = own[_evenly(len(own), most)]
        turn = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        parts[0].append(scans.points[own] @ turn + (x, y))
        parts[1].append(scans.normals[own] @ turn)
        parts[2].append(scans.starts[own] @ turn + (x, y))
    points, normals, starts = (np.concatenate(part) for part in parts)
    return LocalView(points=points, normals=normals, starts=starts, last=last)


def _evenly(n: int, most: int) -> Ints:
    """Return at most `most` of the numbers 0 to n - 1, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(np.intp))


def find_places(
    view: LocalView,
    place: KnownMap,
    *,
    window: SearchWindow | None = None,
    settings: GlobalSearchSettings = GLOBAL_SEARCH,
) -> GlobalPlaces:
    """Return where in a window (None: all of the map) a view may have been taken; nothing where it fits nowhere.

    The last scan is sought first, and all scans together judge the places found. As the map may lack what the others saw,
    it is enough that the last scan alone fits the place that all together say is the most probable. Where neither fits,
    all are sought together.
    """
    s = settings
    last, seen = view.last_scan, s.least_seen_anywhere if window is None else s.least_seen
    found = _judged(_modes(last.points, place, window, s), view, place, seen, s)
    if found.fit >= s.enough_fit or view.last is None:
        return found
    found = _with_last_fit(found, last, place, s)
    if found.fit >= s.enough_fit:
        return found
    other = _judged(_modes(view.points, place, window, s), view, place, seen, s)
    other = _with_last_fit(other, last, place, s)
    return other if other.fit > found.fit else found


def _with_last_fit(
    found: GlobalPlaces, last: LocalView, place: KnownMap, settings: GlobalSearchSettings
) -> GlobalPlaces:
    """Ask the last scan alone whether it fits a place that all scans neither rule out nor speak against."""
    possible = np.vstack([found.poses[:1], found.rivals])
    if len(possible) == 0 or found.fit < settings.least_joint_fit:
        return found
    own = [match(last.points, last.normals, place.surfaces, pose) for pose in possible]
    judged = place.judge(np.array([one.pose for one in own]), last.points, last.starts)
    agreements = np.array([one.agreement for one in own])
    fits = _fits(agreements, judged.hidden, judged.unseen, found.least_seen)
    best = float(fits.max())
    return found if best < settings.enough_fit else replace(found, last_fit=best)


def _modes(
    points: Floats, place: KnownMap, window: SearchWindow | None, settings: GlobalSearchSettings
) -> Floats:
    """Return poses (n, 3) from which points (m, 2) fit the field."""
    s = settings
    if len(points) < s.least_points:
        return np.zeros((0, 3))
    return place.pyramid.search(
        points,
        place.window if window is None else window,
        heading_step=s.heading_step,
        min_score=s.min_score,
        max_modes=s.max_modes,
        rival_ratio=s.rival_ratio,
        apart=(s.apart, s.apart_turn),
    ).poses


def _judged(
    modes: Floats, view: LocalView, place: KnownMap, least_seen: float, settings: GlobalSearchSettings
) -> GlobalPlaces:
    """Return places near modes (n, 3), by all rays of a view."""
    s = settings
    if len(modes) == 0:
        empty = np.zeros(0)
        return GlobalPlaces(poses=modes, probabilities=empty, agreements=empty, hidden=empty, unseen=empty)
    likely = place.judge(modes, view.points, view.starts).likelihoods
    starts = modes[np.argsort(-likely, kind="stable")[: s.max_matches]]
    found = [match(view.points, view.normals, place.surfaces, pose) for pose in starts]
    poses = np.array([one.pose for one in found])
    judged = place.judge(poses, view.points, view.starts)
    first = poses[np.argsort(-judged.likelihoods, kind="stable")[: s.max_nudged]]
    found += [match(view.points, view.normals, place.surfaces, pose) for pose in _beside(first, s.nudge)]
    poses = np.array([one.pose for one in found])
    judged = place.judge(poses, view.points, view.starts)
    scores = judged.likelihoods / s.correlation
    order = _distinct(poses, scores, s)
    weights = np.exp(scores[order] - scores[order[0]])
    return GlobalPlaces(
        poses=poses[order],
        probabilities=weights / weights.sum(),
        agreements=np.array([found[k].agreement for k in order]),
        hidden=judged.hidden[order],
        unseen=judged.unseen[order],
        least_seen=least_seen,
    )


def _beside(poses: Floats, way: float) -> Floats:
    """Return the eight poses around each of poses (n, 3): (8 n, 3)."""
    steps = np.array([(x, y, 0.0) for x in (-way, 0.0, way) for y in (-way, 0.0, way) if x or y])
    around: Floats = (poses[:, None] + steps).reshape(-1, 3)
    return around


def _distinct(poses: Floats, scores: Floats, settings: GlobalSearchSettings) -> Ints:
    """Return the places, the best first, that are not beside a better one."""
    kept: list[int] = []
    for k in np.argsort(-scores, kind="stable"):
        way = poses[kept] - poses[k]
        is_beside = (np.hypot(way[:, 0], way[:, 1]) < settings.apart) & (
            np.abs(wrap(way[:, 2])) < settings.apart_turn
        )
        if not is_beside.any():
            kept.append(int(k))
    return np.array(kept, dtype=np.intp)
