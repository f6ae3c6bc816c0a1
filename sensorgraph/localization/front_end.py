"""Laser odometry: track the scans of a run, one after the other, against a map of the last key frames.

The prior of each match is the odometry, corrected by the wheel parameters identified so far; without odometry
it is the last motion. If too few points fit, other starts are tried. If none fits for long, a new track
segment begins; a loose edge ties it to the last one, and loop closures determine its pose.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.matching import Match, match
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import FRONT_END, MATCH, FrontEndSettings
from sensorgraph.localization.wheels import WheelEstimate
from sensorgraph.types import Bools, Floats, Ints, Progress


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanTrack:
    """Tracked scans: accurate from one scan to the next, with drift over long distances."""

    poses: Floats
    """(n_scans, 3) [m, m, rad] base_link in the frame of the first scan."""
    matched: Bools
    """(n_scans,) The scan fits the preceding key frames, or has hardly moved from the last that does."""
    is_continuous: Bools
    """(n_scans,) The scan continues the view of the previous one. Otherwise the motion between them is not
    known, or only seems to be: a similar place fits too."""
    key_frames: Ints
    """(n_key,) Scans of the map."""
    piece: Ints
    """(n_key,) Number of the track segment; the motion between two segments is not known."""
    edge_information: Floats
    """(n_key - 1, 3, 3) Information of each key frame's pose in the frame of the previous one."""
    jumps: tuple[int, ...]
    """Scans before which the odometry jumped."""
    noise: Floats
    """(n_scans,) [m] Scatter of a scan's returns around the surfaces of the preceding key frames; nan: not
    matched."""
    wheels: WheelEstimate | None


@dataclass
class _State:
    """State of the tracker."""

    pose: Floats
    wheels: WheelEstimate | None
    key_frames: list[int] = field(default_factory=list)
    piece: list[int] = field(default_factory=list)
    edges: list[Floats] = field(default_factory=list)
    jumps: list[int] = field(default_factory=list)
    surfaces: LineMap | None = None
    last_matched: int = 0
    """Last matched scan."""
    agreement: float = 0.0
    """Share of its points that fit the key frames."""
    usual_agreement: float = 0.5
    """Moving average of this share."""
    failures: list[int] = field(default_factory=list)
    """Scans without a match since then."""
    last_unmatched: tuple[int, LineMap] | None = None
    """The last of these, and the surfaces that it observed."""
    velocity: Floats = field(default_factory=lambda: np.zeros(3))
    """[m/s, m/s, rad/s] Velocity in base_link from the last two matches."""


def points_in(scans: ScanPoints, chosen: list[int] | Ints, poses: Floats) -> tuple[Floats, Floats]:
    """Return points and normals (n, 2) of some scans, transformed by their poses (n_chosen, 3)."""
    points, normals = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for scan, (x, y, phi) in zip(chosen, poses, strict=True):
        turn = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        points.append(scans.points[scans.of(scan)] @ turn + (x, y))
        normals.append(scans.normals[scans.of(scan)] @ turn)
    return np.concatenate(points), np.concatenate(normals)


def information_at(pose: Floats, deviations: Floats) -> Floats:
    """Return the information (3, 3) of x, y, phi in map, given standard deviations (3,) ahead, left and in heading."""
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]]
    return (turn * deviations**-2.0) @ turn.T


class Tracker:
    """Tracks scans one after the other."""

    def __init__(
        self,
        scans: ScanPoints,
        stamps: Floats,
        odometry: Floats | None,
        settings: FrontEndSettings = FRONT_END,
    ) -> None:
        self.scans, self.stamps, self.odometry, self.settings = scans, stamps, odometry, settings
        self.matching = MATCH.for_spacing(scans.spacing)
        intervals = np.diff(stamps)
        ahead = intervals[intervals > 0]
        self.interval = float(np.median(ahead)) if len(ahead) else 0.0  # [s] repeated stamps give no speed
        self.poses = np.zeros((scans.n_scans, 3))
        self.matched = np.zeros(scans.n_scans, dtype=np.bool_)
        self.is_continuous = np.ones(scans.n_scans, dtype=np.bool_)
        self.noise = np.full(scans.n_scans, np.nan)
        self.state = _State(pose=np.zeros(3), wheels=None if odometry is None else WheelEstimate())

    def run(self, progress: Progress) -> ScanTrack:
        """Track all scans."""
        for k in range(self.scans.n_scans):
            self._place(k)
            if k % 50 == 0:
                progress(k, self.scans.n_scans)
        state = self.state
        return ScanTrack(
            poses=self.poses,
            matched=self.matched,
            is_continuous=self.is_continuous,
            key_frames=np.array(state.key_frames, dtype=np.intp),
            piece=np.array(state.piece, dtype=np.intp),
            edge_information=np.array(state.edges).reshape(-1, 3, 3),
            jumps=tuple(state.jumps),
            noise=self.noise,
            wheels=state.wheels,
        )

    def _place(self, k: int) -> None:
        state, s = self.state, self.settings
        if not state.key_frames:
            if not self._is_covered(k):
                self._add_key_frame(k, np.zeros((3, 3)))
            self.poses[k] = state.pose
            self.matched[k] = bool(state.key_frames)
            state.last_matched = k
            return
        predicted, deviations = self._predict(k, state.last_matched)
        if deviations is None:
            state.jumps.append(k)
        moved = compose(invert(self.poses[state.last_matched]), predicted)
        since = self.stamps[k] - self.stamps[state.last_matched]
        is_still = np.hypot(moved[0], moved[1]) < s.still_distance and abs(moved[2]) < s.still_turn
        if self.odometry is not None and is_still and since < s.still_time and deviations is not None:
            self.poses[k], self.matched[k] = predicted, self.matched[k - 1]
            return
        found = self._match(k, predicted, deviations)
        self.matched[k] = found is not None
        if found is not None:
            state.agreement = found.agreement
            state.usual_agreement += self.settings.agreement_rate * (found.agreement - state.usual_agreement)
        self.poses[k] = predicted if found is None else found.pose
        if found is None:
            self._handle_failure(k)
            return
        self.noise[k] = found.noise
        if since > 0:
            state.velocity = compose(invert(self.poses[state.last_matched]), found.pose) / since
        state.last_matched = k
        state.failures.clear()
        state.last_unmatched = None
        step = compose(invert(self.poses[state.key_frames[-1]]), found.pose)
        if np.hypot(step[0], step[1]) > s.key_frame_distance or abs(step[2]) > s.key_frame_turn:
            self._update_wheels(k, step)
            odometry = None if deviations is None else deviations
            self._add_key_frame(k, self._edge(found, predicted, odometry))

    def _predict(self, k: int, last: int) -> tuple[Floats, Floats | None]:
        """Return the predicted pose of scan k from the last one, and its standard deviations; None after a jump."""
        state = self.state
        dt = max(float(self.stamps[k] - self.stamps[last]), 0.0)
        if self.odometry is None or state.wheels is None:
            deviations = np.array(
                [self.settings.speed_sd, self.settings.speed_sd, self.settings.turn_rate_sd]
            )
            return compose(self.poses[last], state.velocity * dt), deviations * dt + 0.01
        step = compose(invert(self.odometry[last]), self.odometry[k])
        way, limits = float(np.hypot(step[0], step[1])), state.wheels.settings
        took = max(dt, self.interval)
        if way > limits.max_speed * took + 0.1 or abs(step[2]) > limits.max_turn_rate * took + 0.2:
            return compose(self.poses[last], state.velocity * dt), None
        corrected = state.wheels.corrected(step)
        return compose(self.poses[last], corrected), state.wheels.deviations(way, float(corrected[2]))

    def _match(self, k: int, predicted: Floats, deviations: Floats | None) -> Match | None:
        """Return the best match, or None if none is good enough."""
        s = self.settings
        assert self.state.surfaces is not None
        if self._is_covered(k):
            return None
        points, normals = self.scans.points[self.scans.of(k)], self.scans.normals[self.scans.of(k)]
        if deviations is None:
            first = match(points, normals, self.state.surfaces, predicted, settings=self.matching)
        else:
            first = match(
                points,
                normals,
                self.state.surfaces,
                predicted,
                prior_information=information_at(predicted, deviations),
                settings=self.matching,
            )
        off = np.zeros(3) if deviations is None else compose(invert(predicted), first.pose) / deviations
        is_other = first.agreement < s.min_continuity * self.state.agreement or bool(
            (np.abs(off) > s.max_slip).any()
        )
        is_good = self._is_good(first, s.min_share_after_failure if self.state.failures else 0.0)
        found: Match | None = first if is_good else None
        if is_other or not is_good:  # the robot may have been carried
            found = self._other_starts(points, normals, predicted, first) or found
        if is_other and (found is not None or self.state.last_unmatched is None):
            self.is_continuous[[self.state.last_matched + 1, k]] = (
                False  # no scan between the two was matched
            )
        return found

    def _is_covered(self, k: int) -> bool:
        """Tell whether all returns of a scan are within the match radius, as with a covered laser."""
        ranges = self.scans.ranges[self.scans.of(k)]
        return bool((ranges < MATCH.first_radius).all())

    def _other_starts(self, points: Floats, normals: Floats, predicted: Floats, first: Match) -> Match | None:
        """Return the best match from starts around the prediction and around the last pose."""
        s, best = self.settings, first
        assert self.state.surfaces is not None
        last = self.poses[self.state.last_matched]
        offsets = [(a, b) for a in s.start_offsets for b in s.start_offsets if a == 0 or b == 0]
        for base in (predicted, last):
            for turn in s.start_turns:
                for offset in offsets:
                    start = compose(base, np.array([*offset, turn]))
                    found = match(points, normals, self.state.surfaces, start, settings=self.matching)
                    if found.agreement > best.agreement:
                        best = found
            if self._is_good(best, s.min_share_elsewhere):
                return best
        return best if self._is_good(best, s.min_share_elsewhere) else None

    def _is_good(self, found: Match, share: float) -> bool:
        """Tell whether enough points fit, in total and as a share of the usual agreement."""
        s = self.settings
        is_usual = found.agreement >= share * self.state.usual_agreement
        return found.inliers >= s.min_inliers and found.overlap >= s.min_overlap and is_usual

    def _edge(self, found: Match, predicted: Floats, deviations: Floats | None) -> Floats:
        """Return the information (3, 3) of the new key frame's pose in the frame of the last one."""
        s = self.settings
        information = found.information / s.correlation + 1e-3 * np.eye(3)
        if deviations is not None:
            information = information + information_at(predicted, deviations)
        floor = np.diag([s.floor_place**2, s.floor_place**2, s.floor_turn**2])
        covariance = np.linalg.inv(information) + floor
        phi = self.poses[self.state.key_frames[-1]][2]
        turn = np.eye(3)
        turn[:2, :2] = [[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]]
        return np.asarray(np.linalg.inv(turn @ covariance @ turn.T), dtype=np.float64)

    def _update_wheels(self, k: int, step: Floats) -> None:
        state = self.state
        if self.odometry is not None and state.wheels is not None:
            last = state.key_frames[-1]
            if not any(last < jump <= k for jump in state.jumps):
                state.wheels.learn(compose(invert(self.odometry[last]), self.odometry[k]), step)

    def _add_key_frame(self, k: int, information: Floats, *, is_new_piece: bool = False) -> None:
        state = self.state
        if state.key_frames:
            state.edges.append(information)
        piece = state.piece[-1] + int(is_new_piece) if state.piece else 0
        state.key_frames.append(k)
        state.piece.append(piece)
        length = sum(p == piece for p in state.piece[-self.settings.window :])
        recent = state.key_frames[-length:]
        state.surfaces = line_map(
            *thinned(*points_in(self.scans, recent, self.poses[recent])), side=self.matching.first_radius
        )

    def _handle_failure(self, k: int) -> None:
        """Wait for a match, or begin a new track segment."""
        state, s = self.state, self.settings
        if not state.failures:  # later scans were placed by the wheels, assuming standstill
            self.matched[state.last_matched + 1 : k] = False
        if not self._is_covered(k):
            self._match_unplaced(k)
        state.failures.append(k)
        first = state.failures[0]
        moved = self.poses[k, :2] - self.poses[first, :2]
        is_long = self.stamps[k] - self.stamps[first] > s.patience or np.hypot(*moved) > s.patience_distance
        if len(state.failures) < s.patience_scans or not is_long or self._is_covered(k):
            return
        loose = np.array([s.broken_place, s.broken_place, s.broken_turn]) ** -2.0
        state.last_matched, state.agreement = k, 0.0
        state.failures.clear()
        state.last_unmatched = None
        state.velocity = np.zeros(3)
        self._add_key_frame(k, np.diag(loose), is_new_piece=True)

    def _match_unplaced(self, k: int) -> None:
        """Place an unmatched scan k by a match with the previous unmatched scan."""
        state, own = self.state, self.scans.of(k)
        points, normals = self.scans.points[own], self.scans.normals[own]
        if state.last_unmatched is not None:
            last, surfaces = state.last_unmatched
            predicted, deviations = self._predict(k, last)
            prior = None if deviations is None else information_at(predicted, deviations)
            found = match(
                points, normals, surfaces, predicted, prior_information=prior, settings=self.matching
            )
            self.is_continuous[k] = self._is_good(found, self.settings.min_continuity)
            if self.is_continuous[k]:
                self.poses[k] = found.pose
        seen = points_in(self.scans, [k], self.poses[[k]])
        state.last_unmatched = k, line_map(*thinned(*seen), side=self.matching.first_radius)


def track(
    scans: ScanPoints,
    stamps: Floats,
    odometry: Floats | None,
    progress: Progress,
    settings: FrontEndSettings = FRONT_END,
) -> ScanTrack:
    """Track all scans.

    Parameters
    ----------
    stamps : (n_scans,) [s]
    odometry : (n_scans, 3) [m, m, rad] Odometry at the scans; None: the scans alone.
    """
    return Tracker(scans, stamps, odometry, settings).run(progress)
