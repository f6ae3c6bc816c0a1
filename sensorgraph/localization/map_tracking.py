"""Follow a robot through a known place: searched without a guess at first and whenever it is lost, matched otherwise.

The way from scan to scan comes from the laser's own odometry (`front_end`); wheels alone are too poor a prior where
they drift. What lies before a place was found is followed backwards from there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.front_end import ScanTrack, information_at
from sensorgraph.localization.global_search import GlobalPlaces, find_places, fit_of, local_view
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_settings import MAP_TRACKING, MapTrackingSettings
from sensorgraph.localization.matching import match
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.types import Bools, Floats, Progress


@dataclass(frozen=True, kw_only=True, eq=False)
class MapTrack:
    """Where the scans are in a known place."""

    poses: Floats
    """(n_scans, 3) [m, m, rad] base_link in map; nan where it is not known."""
    information: Floats
    """(n_scans, 3, 3) of x, y, phi in map as the scan alone tells; zeros where it was not matched."""
    breaks: Bools
    """(n_scans,) the way from the scan before is not known."""
    rivals: dict[int, Floats]
    """Scan -> (n, 3) the places where it may have been, the best first, at searches that several places answered."""
    best_fit: float
    """Of all searches: share of the returns on walls of the map, less twice those through walls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapMatches:
    """Scans matched to a known place."""

    poses: Floats
    """(n, 3) [m, m, rad] base_link in map."""
    information: Floats
    """(n, 3, 3) of x, y, phi in map as the scan alone tells; zeros where it was not matched."""
    noise: Floats
    """(n,) [m] scatter of the returns around the walls; nan where it was not matched."""
    agreement: Floats
    """(n,) share of the returns that lie on walls; nan where it was not matched."""


@dataclass
class _State:
    """What is known while scan after scan is taken."""

    last_good: int = -1
    """The last scan that fits the map; -1: the robot is not found, or lost."""
    last_sure: int = -1
    """The last scan with a good averaged fit; -1: none since the way is known."""
    found_at: int = -1
    """Scan at which it was found last."""
    sure_before: int = -1
    """`last_sure` then; -1: the way from there is not known."""
    proof_fit: float = 0.0
    """Averaged fit that it must have until the place is proven."""
    fit: float = 0.0
    """Averaged over the last second."""
    usual_fit: float = 0.0
    """Averaged over the last metres."""
    last_search: int = -1
    """Scan; -1: none since it was lost."""
    n_searches: int = 0
    """Since it was lost."""
    view: list[int] = field(default_factory=list)
    """Scans of the searches since it was lost."""


class MapTracker:
    """Place one scan after the other in a known map."""

    def __init__(
        self,
        scans: ScanPoints,
        stamps: Floats,
        track: ScanTrack,
        place: KnownMap,
        settings: MapTrackingSettings = MAP_TRACKING,
    ) -> None:
        n = scans.n_scans
        self.scans, self.stamps, self.track, self.place, self.settings = scans, stamps, track, place, settings
        self.breaks = ~track.goes_on
        self.is_new_piece = np.zeros(n, dtype=np.bool_)
        self.is_new_piece[track.key_frames[1:][np.diff(track.piece) != 0]] = True
        self.poses = np.full((n, 3), np.nan)
        self.information = np.zeros((n, 3, 3))
        self.rivals: dict[int, Floats] = {}
        self.best_fit = 0.0
        self.driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track.poses[:, :2], axis=0).T))])
        self.state = _State()

    def run(self, progress: Progress) -> MapTrack:
        """Place all scans, forwards and then backwards."""
        n = self.scans.n_scans
        for k in range(n):
            if self.state.last_good < 0:  # nothing is believed that one scan could make doubtful
                self.breaks[k] = self.is_new_piece[k]
            if self.breaks[k]:
                self.state = _State()
            if self.state.last_good >= 0:
                self._go_on(k)
            if self.state.last_good < 0:
                self._search(k)
            if k % 50 == 0:
                progress(k, n)
        self._follow_back()
        progress(n, n)
        return MapTrack(
            poses=self.poses,
            information=self.information,
            breaks=self.breaks,
            rivals=self.rivals,
            best_fit=self.best_fit,
        )

    def _follow_back(self) -> None:
        """Follow the robot backwards from where it was found, over single scans that do not fit."""
        s, last_good = self.settings, len(self.poses) - 1
        for k in range(len(self.poses) - 2, -1, -1):
            if not np.isnan(self.poses[k, 0]) or np.isnan(self.poses[k + 1, 0]) or self.breaks[k + 1]:
                self.poses[k + 1 : last_good] = np.nan  # the scans at the end of the way back that do not fit
                last_good = k
                continue
            fit = self._follow(k, k + 1)
            if fit is not None and fit >= s.sure_fit:
                last_good = k
                continue
            self.information[k] = 0.0
            if self.stamps[last_good] - self.stamps[k] > s.back_patience:
                self.poses[k:last_good] = np.nan

    def _go_on(self, k: int) -> None:
        """Follow the robot to scan k, or lose it."""
        s, state = self.settings, self.state
        fit = self._follow(k, k - 1)
        if fit is not None:
            state.last_good = k
            state.fit += (fit - state.fit) * min(
                float(self.stamps[k] - self.stamps[k - 1]) / s.fit_memory, 1.0
            )
            step = self.driven[k] - self.driven[k - 1]
            state.usual_fit += (fit - state.usual_fit) * min(float(step) / s.usual_way, 1.0)
            if fit >= max(s.sure_fit, s.sure_share * state.usual_fit):
                state.last_sure = k
        is_proven = self.driven[k] - self.driven[state.found_at] > s.proof_way
        least = max(s.least_fit if is_proven else state.proof_fit, s.sudden_share * state.usual_fit)
        if state.fit >= least and not self._is_blind(k):
            return
        last = state.last_sure if is_proven else state.found_at - 1
        self.poses[last + 1 : k + 1], self.information[last + 1 : k + 1] = np.nan, 0.0
        self.state = _State(last_sure=last if is_proven else state.sure_before)

    def _follow(self, k: int, beside: int) -> float | None:
        """Place scan k by the one beside it and a match; return its fit, None where it is not matched."""
        s = self.settings
        step = compose(invert(self.track.poses[beside]), self.track.poses[k])
        predicted = compose(self.poses[beside], step)
        self.poses[k] = predicted
        own = self.scans.of(k)
        if own.stop - own.start < s.least_points:
            return None
        way = float(np.hypot(step[0], step[1]))
        deviations = np.asarray(s.prior_floor) + s.prior_per_metre * way + s.prior_per_turn * abs(step[2])
        found = match(
            self.scans.points[own], self.scans.normals[own], self.place.surfaces, predicted,
            prior_information=information_at(predicted, deviations),
        )  # fmt: skip
        off = found.pose - predicted
        is_near = np.hypot(off[0], off[1]) < s.most_off and abs(wrap(off[2])) < s.most_turned
        if not (is_near and found.inliers >= s.inliers and found.agreement >= s.agreement):
            return None
        self.poses[k], self.information[k] = found.pose, found.information
        judged = self.place.judge(found.pose[None], self.scans.points[own], self.scans.starts[own])
        return fit_of(found.agreement, judged.hidden[0], judged.unseen[0])

    def _is_blind(self, k: int) -> bool:
        """Tell whether the last scan that fits is too long ago."""
        last = self.state.last_good
        waited = self.stamps[k] - self.stamps[last] > self.settings.patience
        return bool(waited or self.driven[k] - self.driven[last] > self.settings.patience_way)

    def _search(self, k: int) -> None:
        """Look for the robot where it can be, and from time to time everywhere; not where it has not moved."""
        s, state = self.settings, self.state
        if self.scans.first[k + 1] - self.scans.first[k] < s.least_points or not self._is_due(k):
            return
        chosen = np.array([*state.view[-(s.view_scans - 1) :], k], dtype=np.intp)
        view = local_view(self.scans, chosen, self.track.poses[chosen])
        state.last_search = k
        state.view.append(k)
        state.n_searches += 1
        window = self._window(k)
        if window is None:
            found = find_places(view, self.place)
            if self._take(k, found, least_fit_of(found, s)) and found.fit < s.found_fit:
                state.proof_fit = s.least_fit
            return
        found = find_places(view, self.place, window=window)
        if self._take(k, found, s.near_fit):
            return
        is_expected = found.fit >= s.expected_fit and _is_beside(found.poses[0], window, s)
        if not is_expected and state.n_searches % s.every_nth_everywhere != 0:
            return
        anywhere = find_places(view, self.place)
        if is_expected and anywhere.fit <= found.fit:
            if self._take(k, found, s.expected_fit):
                state.proof_fit = s.least_fit
            return
        last = state.last_sure
        if self._take(k, anywhere, s.far_fit) and not _is_within(self.poses[k], window):
            self.breaks[last + 1] = True  # it was carried there
            state.last_sure = state.sure_before = -1

    def _is_due(self, k: int) -> bool:
        s, state = self.settings, self.state
        if state.last_search < 0:
            return True
        share = min(2.0 ** (state.n_searches - 1), s.most_search_way / s.search_way)
        turn = abs(wrap(self.track.poses[k, 2] - self.track.poses[state.last_search, 2]))
        way = self.driven[k] - self.driven[state.last_search]
        return bool(way > share * s.search_way or turn > min(share * s.search_turn, np.pi / 2))

    def _window(self, k: int) -> SearchWindow | None:
        """Return where the robot can be by its odometry since it was lost; None: nobody knows."""
        s, last = self.settings, self.state.last_sure
        if last < 0:
            return None
        way = self.driven[k] - self.driven[last]
        pose = compose(self.poses[last], compose(invert(self.track.poses[last]), self.track.poses[k]))
        return SearchWindow.around(
            pose,
            half_xy=s.drift_floor + s.drift_per_metre * way,
            half_phi=s.turn_drift_floor + s.turn_drift_per_metre * way,
        )

    def _take(self, k: int, found: GlobalPlaces, least_fit: float) -> bool:
        """Go on from the place that was found, if it is good enough and the only one."""
        self.best_fit = max(self.best_fit, found.fit)
        if found.fit < least_fit:
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
        state.sure_before, state.proof_fit = state.last_sure, self.settings.near_fit
        state.fit = state.usual_fit = float(found.fits[0])
        return True


def least_fit_of(found: GlobalPlaces, settings: MapTrackingSettings = MAP_TRACKING) -> float:
    """Return the fit that a place found without a guess must have to be believed: the less, the more it leads."""
    s = settings
    share = np.clip(found.lead / s.alone_lead, 0.0, 1.0) if len(found.poses) else 0.0
    return float(s.found_fit + share * (s.alone_fit - s.found_fit))


def _is_beside(pose: Floats, window: SearchWindow, settings: MapTrackingSettings) -> bool:
    """Tell whether a pose is where the odometry has it, the middle of the window, and not just somewhere within."""
    turn = abs(wrap(pose[2] - window.phi))
    way = np.hypot(pose[0] - window.x, pose[1] - window.y)
    return bool(way < settings.expected_way and turn < settings.expected_turn)


def _is_within(pose: Floats, window: SearchWindow) -> bool:
    turn = abs(wrap(pose[2] - window.phi))
    is_near = abs(pose[0] - window.x) <= window.half_x and abs(pose[1] - window.y) <= window.half_y
    return bool(is_near and turn <= window.half_phi)


def rematch(
    scans: ScanPoints,
    poses: Floats,
    place: KnownMap,
    progress: Progress,
    settings: MapTrackingSettings = MAP_TRACKING,
) -> MapMatches:
    """Match scans once more; with the usual radii for a laser of few rays, too, as the walls of a map are dense.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] to start from; nan: not matched
    """
    places, information = poses.copy(), np.zeros((len(poses), 3, 3))
    noise, agreement = np.full((2, len(poses)), np.nan)
    for k in np.flatnonzero(np.isfinite(poses).all(axis=1)):
        own = scans.of(int(k))
        if own.stop - own.start < settings.least_points:
            continue
        prior = information_at(poses[k], np.asarray(settings.rematch_deviations))
        found = match(
            scans.points[own], scans.normals[own], place.surfaces, poses[k], prior_information=prior
        )
        if found.inliers >= settings.inliers and found.agreement >= settings.agreement:
            places[k], information[k] = found.pose, found.information
            noise[k], agreement[k] = found.noise, found.agreement
        if k % 50 == 0:
            progress(int(k), len(poses))
    return MapMatches(poses=places, information=information, noise=noise, agreement=agreement)
