"""Track a robot in a known place: a global search at the start and after each loss, scan matching otherwise.

The motion between scans comes from the laser odometry (`front_end`), since drifting wheels are a poor prior.
Scans before the first search result are tracked backwards from there.

With the fit f_k of scan k at its pose (`global_search.fit_of`), dt since the scan before and way driven, the averaged fit and the
usual one are

    fit += (f_k - fit) min(dt / FIT_MEMORY, 1),  usual += (f_k - usual) min(way / usual_distance, 1).

The robot is lost where fit < max(min_fit, loss_share usual), or without an accepted match for too long.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from logs.transforms import compose, distances_along, invert, wrap
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.global_search import MIN_POINTS, GlobalPlaces, find_places, fit_of, local_view
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.matching import match
from sensorgraph.localization.scan_track import ScanTrack, information_at
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import FRONT_END, GLOBAL_SEARCH, MAP_TRACKING
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats, Progress

BACKWARD_PATIENCE = 1.0
"""[s] Time without an accepted match after which tracking backwards, from where the robot was found, ends."""
UNRIVALLED_LEAD = 0.5
"""Lead over all other places at which a fit of `near_fit` is enough; between, the limit is interpolated. An opened door or
a moved cupboard lowers the fit of the true place, but a place that fits by chance has rivals with a similar fit: with
`near_fit` they lead by at most 0.21, at 160 places of three logs outside the map (`localize_in_map --swap`)."""
EXPECTED = (0.1, 0.05)
"""[m], [rad] Maximum distance and heading difference of a place that is at the odometry pose."""
FIT_MEMORY = 1.0
"""[s] Time constant of the averaged fit."""
SEARCH_DISTANCE, SEARCH_TURN = 0.3, 0.35
"""[m], [rad] Motion between searches while the robot is lost; it doubles after each failed search, up to eight times as much or
`SEARCH_GROWTH` times the distance driven while lost."""
SEARCH_GROWTH = 0.1
"""[m/m] Ratio of the distance between searches to the distance driven while lost, where a long drive fits nowhere."""
EVERY_NTH_EVERYWHERE = 3
"""Every n-th search covers the whole map, even if the odometry limits where the robot can be."""
VIEW_SCANS = 5
"""Maximum number of scans that are searched together."""
REMATCH_DEVIATIONS = (0.05, 0.05, 0.02)
"""[m, m, rad] Standard deviations of the smoothed track, as prior of the last matches."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapMatches:
    """Matches of scans to a known map."""

    poses: Floats
    """(n, 3) [m, m, rad] base_link in map."""
    information: Floats
    """(n, 3, 3) Information of x, y, phi in map from the scan alone; zeros where not matched."""
    noise: Floats
    """(n,) [m] Scatter of the returns around the walls; nan where not matched."""
    agreement: Floats
    """(n,) Share of the returns on walls; nan where not matched."""


@dataclass
class _State:
    """State of the tracker."""

    last_good: int = -1
    """Last scan that fits the map; -1: the robot is not found, or lost."""
    last_confirmed: int = -1
    """Last scan with a confirmed pose; -1: none since the motion is known."""
    found_at: int = -1
    """Scan of the last successful search."""
    confirmed_before: int = -1
    """`last_confirmed` at that time; -1: the motion since then is not known."""
    probation_fit: float = 0.0
    """Minimum averaged fit until the place is confirmed."""
    fit: float = 0.0
    """Fit, averaged over the last second."""
    usual_fit: float = 0.0
    """Fit, averaged over the last metres."""
    last_search: int = -1
    """Scan of the last search; -1: none since the loss."""
    n_searches: int = 0
    """Number of searches since the loss."""
    view: list[int] = field(default_factory=list)
    """Scans of the searches since the loss."""


class MapTracker:
    """Tracks scans one after the other in a known map.

    Attributes
    ----------
    poses : (n_scans, 3) [m, m, rad] base_link in map; nan where unknown.
    information : (n_scans, 3, 3) Information of x, y, phi in map from the scan alone; zeros where not matched.
    breaks : (n_scans,) The motion from the previous scan is not known.
    rivals : Scan -> (n, 3) possible places, the best first, of searches with several answers.
    best_fit : Best `GlobalPlaces.fit` of all searches.
    """

    def __init__(self, scans: ScanPoints, stamps: Floats, track: ScanTrack, place: KnownMap) -> None:
        n = scans.n_scans
        self.scans, self.stamps, self.track, self.place = scans, stamps, track, place
        self.breaks = ~track.is_continuous
        self.is_new_piece = np.zeros(n, dtype=np.bool_)
        self.is_new_piece[track.key_frames[1:][np.diff(track.piece) != 0]] = True
        self.poses = np.full((n, 3), np.nan)
        self.information = np.zeros((n, 3, 3))
        self.rivals: dict[int, Floats] = {}
        self.best_fit = 0.0
        self.driven = distances_along(track.poses)
        self.state = _State()

    def run(self, progress: Progress) -> MapTracker:
        """Track all scans, forwards and then backwards; return the tracker."""
        n = self.scans.n_scans
        for k in range(n):
            if self.state.last_good < 0:  # the robot is lost: a discontinuity invalidates nothing
                self.breaks[k] = self.is_new_piece[k]
            if self.breaks[k]:
                self.state = _State()
            if self.state.last_good >= 0:
                self._track_next(k)
            if self.state.last_good < 0:
                self._search(k)
            if k % 50 == 0:
                progress(k, n)
        self._track_backwards()
        progress(n, n)
        return self

    def _track_backwards(self) -> None:
        """Track backwards from where the robot was found, across single scans that do not fit."""
        s, last_good = MAP_TRACKING, len(self.poses) - 1
        for k in range(len(self.poses) - 2, -1, -1):
            if not np.isnan(self.poses[k, 0]) or np.isnan(self.poses[k + 1, 0]) or self.breaks[k + 1]:
                self.poses[k + 1 : last_good] = np.nan  # unmatched scans at the end of backward tracking
                last_good = k
                continue
            fit = self._track_from(k, k + 1)
            if fit is not None and fit >= s.near_fit:
                last_good = k
                continue
            self.information[k] = 0.0
            if self.stamps[last_good] - self.stamps[k] > BACKWARD_PATIENCE:
                self.poses[k:last_good] = np.nan

    def _track_next(self, k: int) -> None:
        """Track scan k; update the averaged fit, or declare the robot lost."""
        s, state = MAP_TRACKING, self.state
        fit = self._track_from(k, k - 1)
        if fit is not None:
            state.last_good = k
            state.fit += (fit - state.fit) * min(float(self.stamps[k] - self.stamps[k - 1]) / FIT_MEMORY, 1.0)
            step = self.driven[k] - self.driven[k - 1]
            state.usual_fit += (fit - state.usual_fit) * min(float(step) / s.usual_distance, 1.0)
            if fit >= max(s.near_fit, s.confirmed_share * state.usual_fit):
                state.last_confirmed = k
        is_proven = self.driven[k] - self.driven[state.found_at] > s.usual_distance
        least = max(s.min_fit if is_proven else state.probation_fit, s.loss_share * state.usual_fit)
        if state.fit >= least and not self._is_overdue(k):
            return
        last = state.last_confirmed if is_proven else state.found_at - 1
        self.poses[last + 1 : k + 1], self.information[last + 1 : k + 1] = np.nan, 0.0
        self.state = _State(last_confirmed=last if is_proven else state.confirmed_before)

    def _track_from(self, k: int, neighbour: int) -> float | None:
        """Place scan k by a neighbouring scan and a match; return its fit, or None without an accepted match."""
        s = MAP_TRACKING
        step = compose(invert(self.track.poses[neighbour]), self.track.poses[k])
        predicted = compose(self.poses[neighbour], step)
        self.poses[k] = predicted
        own = self.scans.of(k)
        if own.stop - own.start < MIN_POINTS:
            return None
        way = float(np.hypot(step[0], step[1]))
        deviations = np.asarray(s.prior_floor) + s.prior_per_motion * (way + abs(step[2]))
        found = match(
            self.scans.points[own], self.scans.normals[own], self.place.surfaces, predicted,
            prior_information=information_at(predicted, deviations),
        )  # fmt: skip
        off = found.pose - predicted
        is_near = np.hypot(off[0], off[1]) < s.max_offset and abs(wrap(off[2])) < s.max_turn_offset
        if not (is_near and found.inliers >= MAJORITY and found.agreement >= s.agreement):
            return None
        self.poses[k], self.information[k] = found.pose, found.information
        judged = self.place.judge(found.pose[None], self.scans.points[own], self.scans.starts[own])
        return fit_of(found.agreement, judged.hidden[0], judged.unseen[0])

    def _is_overdue(self, k: int) -> bool:
        """Tell whether the last scan that fits is too far back in time or distance."""
        last = self.state.last_good
        waited = self.stamps[k] - self.stamps[last] > FRONT_END.patience
        return bool(waited or self.driven[k] - self.driven[last] > MAP_TRACKING.patience_distance)

    def _search(self, k: int) -> None:
        """Search where the odometry allows, and periodically the whole map; skip if the robot has not moved."""
        s, state = MAP_TRACKING, self.state
        if self.scans.first[k + 1] - self.scans.first[k] < MIN_POINTS or not self._is_due(k):
            return
        chosen = np.array([*state.view[-(VIEW_SCANS - 1) :], k], dtype=np.intp)
        view = local_view(self.scans, chosen, self.track.poses[chosen])
        state.last_search = k
        state.view.append(k)
        state.n_searches += 1
        window = self._window(k)
        if window is None:
            found = find_places(view, self.place)
            if self._accept(k, found, min_fit_of(found)) and found.fit < GLOBAL_SEARCH.accept_fit:
                state.probation_fit = s.min_fit
            return
        found = find_places(view, self.place, window=window)
        if self._accept(k, found, s.near_fit):
            return
        is_expected = found.fit >= s.expected_fit and _is_expected(found.poses[0], window)
        if not is_expected and state.n_searches % EVERY_NTH_EVERYWHERE != 0:
            return
        anywhere = find_places(view, self.place)
        if is_expected and anywhere.fit <= found.fit:
            if self._accept(k, found, s.expected_fit):
                state.probation_fit = s.min_fit
            return
        last = state.last_confirmed
        if self._accept(k, anywhere, s.far_fit) and not _is_within(self.poses[k], window):
            self.breaks[last + 1] = True  # the robot was carried there
            state.last_confirmed = state.confirmed_before = -1

    def _is_due(self, k: int) -> bool:
        state = self.state
        if state.last_search < 0:
            return True
        lost = self.driven[k] - self.driven[state.view[0]]
        usual = 8 * SEARCH_DISTANCE
        most = max(usual, SEARCH_GROWTH * lost)
        share = min(2.0 ** (state.n_searches - 1), most / SEARCH_DISTANCE)
        turn = abs(wrap(self.track.poses[k, 2] - self.track.poses[state.last_search, 2]))
        turn_limit = min(share * SEARCH_TURN, np.pi / 2 * most / usual)
        way = self.driven[k] - self.driven[state.last_search]
        return bool(way > share * SEARCH_DISTANCE or turn > turn_limit)

    def _window(self, k: int) -> SearchWindow | None:
        """Return the window that the odometry allows since the loss; None without a last confirmed pose."""
        s, last = MAP_TRACKING, self.state.last_confirmed
        if last < 0:
            return None
        way = self.driven[k] - self.driven[last]
        pose = compose(self.poses[last], compose(invert(self.track.poses[last]), self.track.poses[k]))
        return SearchWindow.around(
            pose,
            half_xy=s.drift_floor + s.drift_per_metre * way,
            half_phi=s.turn_drift_floor + s.turn_drift_per_metre * way,
        )

    def _accept(self, k: int, found: GlobalPlaces, min_fit: float) -> bool:
        """Accept a place if its fit suffices and it has no rivals; record rivals."""
        self.best_fit = max(self.best_fit, found.fit)
        if found.fit < min_fit:
            return False
        if len(found.rivals):
            self.rivals[k] = np.vstack([found.poses[:1], found.rivals])
            return False
        self.poses[k] = found.poses[0]
        own, state = self.scans.of(k), self.state
        self.information[k] = match(
            self.scans.points[own], self.scans.normals[own], self.place.surfaces, self.poses[k]
        ).information
        state.last_good = state.found_at = k
        state.confirmed_before, state.probation_fit = state.last_confirmed, MAP_TRACKING.near_fit
        state.fit = state.usual_fit = float(found.fits[0])
        return True


def min_fit_of(found: GlobalPlaces) -> float:
    """Return the minimum fit of a globally found place; it decreases with the place's lead."""
    s = MAP_TRACKING
    share = np.clip(found.lead / UNRIVALLED_LEAD, 0.0, 1.0) if len(found.poses) else 0.0
    return float(GLOBAL_SEARCH.accept_fit + share * (s.near_fit - GLOBAL_SEARCH.accept_fit))


def _is_expected(pose: Floats, window: SearchWindow) -> bool:
    """Tell whether a pose is at the odometry pose, the centre of the window."""
    turn = abs(wrap(pose[2] - window.phi))
    way = np.hypot(pose[0] - window.x, pose[1] - window.y)
    return bool(way < EXPECTED[0] and turn < EXPECTED[1])


def _is_within(pose: Floats, window: SearchWindow) -> bool:
    turn = abs(wrap(pose[2] - window.phi))
    is_near = abs(pose[0] - window.x) <= window.half_x and abs(pose[1] - window.y) <= window.half_y
    return bool(is_near and turn <= window.half_phi)


def rematch(scans: ScanPoints, poses: Floats, place: KnownMap, progress: Progress) -> MapMatches:
    """Match scans again, starting from known poses.

    The radii are the default ones for any laser, since the walls of a map are dense.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] Initial poses; nan: not matched.
    """
    places, information = poses.copy(), np.zeros((len(poses), 3, 3))
    noise, agreement = np.full((2, len(poses)), np.nan)
    for k in np.flatnonzero(np.isfinite(poses).all(axis=1)):
        own = scans.of(int(k))
        if own.stop - own.start < MIN_POINTS:
            continue
        prior = information_at(poses[k], np.asarray(REMATCH_DEVIATIONS))
        found = match(
            scans.points[own], scans.normals[own], place.straight, poses[k], prior_information=prior
        )
        if found.inliers >= MAJORITY and found.agreement >= MAP_TRACKING.agreement:
            places[k], information[k] = found.pose, found.information
            noise[k], agreement[k] = found.noise, found.agreement
        if k % 50 == 0:
            progress(int(k), len(poses))
    return MapMatches(poses=places, information=information, noise=noise, agreement=agreement)
