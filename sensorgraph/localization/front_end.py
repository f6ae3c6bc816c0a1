"""Laser odometry: track the scans of a run, one after the other, against a map of the last key frames.

The prior of each match is the odometry, corrected by the wheel parameters identified so far; without odometry
it is the last motion. If too few points fit, other starts are tried. If none fits for long, a new track
segment begins. The odometry of a robot that drives on carries its pose; otherwise loop closures determine it.

A direction that a scan does not determine, as along a corridor, keeps its prior. Without odometry its standard
deviation grows by `speed_sd` times the duration.
"""

from __future__ import annotations

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.matching import CORRELATION, START_OFFSET, Match, match
from sensorgraph.localization.scan_track import (
    ScanTrack,
    TrackerState,
    determines_all,
    information_at,
    is_covered,
    points_in,
    turn_matrices,
)
from sensorgraph.localization.scans import ScanPoints, contradicts, scan_points
from sensorgraph.localization.settings import EDGE_FLOOR, FRONT_END, MATCH, WHEELS
from sensorgraph.localization.wheels import WheelEstimate
from sensorgraph.types import Floats, Progress, ProgressBars, no_progress

WINDOW = 40
"""Number of recent key frames in the map to match against."""
STILL = (0.02, 0.01)
"""[m], [rad] Motion below which a scan is placed by the odometry instead of a match ..."""
STILL_TIME = 0.5
"""[s] ... up to this time after the last match."""
MIN_SHARE_ELSEWHERE, MIN_SHARE_AFTER_FAILURE = 0.85, 0.5
"""Minimum agreement, relative to the usual one, of a match from another start, as many poses fit a room partly, and of one near
the prediction after scans without a match."""
AGREEMENT_RATE = 0.05
"""Weight of a new match in the usual agreement."""
START_TURNS, START_OFFSETS = (0.0, -0.1, 0.1, -0.21, 0.21), (0.0, -START_OFFSET, START_OFFSET)
"""[rad], [m] Offsets of the other starts, in heading, and along or across."""
SHORT_DRIVE = 120
"""Number of scans of a part of a run that is tracked alone, as for `track_part`."""
PATIENCE_SCANS = 5
"""Minimum number of scans without a match before a new track segment begins."""


class Tracker:
    """Tracks scans one after the other; one class, since each step reads and changes the same state."""

    def __init__(
        self, scans: ScanPoints, stamps: Floats, odometry: Floats | None, spacing: float = 1.0
    ) -> None:
        self.scans, self.stamps, self.odometry = scans, stamps, odometry
        self.apart = spacing * FRONT_END.key_frame_distance, spacing * FRONT_END.key_frame_turn
        self.matching = MATCH.for_spacing(scans.spacing)
        intervals = np.diff(stamps)
        ahead = intervals[intervals > 0]
        self.interval = float(np.median(ahead)) if len(ahead) else 0.0  # [s] repeated stamps give no speed
        self.poses = np.zeros((scans.n_scans, 3))
        self.matched = np.zeros(scans.n_scans, dtype=np.bool_)
        self.is_continuous = np.ones(scans.n_scans, dtype=np.bool_)
        self.noise = np.full(scans.n_scans, np.nan)
        self.state = TrackerState(wheels=None if odometry is None else WheelEstimate())

    def run(self, progress: Progress) -> ScanTrack:
        """Track all scans."""
        for k in range(self.scans.n_scans):
            self._place(k)
            if k % 50 == 0:
                progress(k, self.scans.n_scans)
        self._place_before_first()
        state = self.state
        return ScanTrack(
            poses=self.poses,
            matched=self.matched,
            is_continuous=self.is_continuous,
            key_frames=np.array(state.key_frames, dtype=np.intp),
            piece=np.array(state.piece, dtype=np.intp),
            edge_information=np.array(state.edges).reshape(-1, 3, 3),
            motion_deviations=np.array(state.motion_deviations).reshape(-1, 3),
            is_carried=np.array(state.is_carried, dtype=np.bool_),
            projections=np.array(state.projections).reshape(-1, 3, 3),
            jumps=tuple(state.jumps),
            noise=self.noise,
            wheels=state.wheels,
        )

    def _place(self, k: int) -> None:
        state = self.state
        if not state.key_frames:
            if not is_covered(self.scans, k):
                self._add_key_frame(k)
            self.matched[k] = bool(state.key_frames)
            state.last_matched = k
            return
        predicted, deviations = self._predict(k, state.last_matched)
        if deviations is None:
            state.jumps.append(k)
        if self._is_unknown(k) and not self._has_stayed(k, *self.apart):
            self.poses[k], self.matched[k], self.is_continuous[k] = predicted, True, False
            self._begin_piece(k)
            return
        moved = compose(invert(self.poses[state.last_matched]), predicted)
        since = self.stamps[k] - self.stamps[state.last_matched]
        is_still = np.hypot(moved[0], moved[1]) < STILL[0] and abs(moved[2]) < STILL[1]
        is_known = self.odometry is not None and since < STILL_TIME and deviations is not None
        if is_still and is_known and self._has_stayed(k, *STILL):
            self.poses[k], self.matched[k] = predicted, self.matched[k - 1]
            return
        found = self._match(k, predicted, deviations)
        self.matched[k] = found is not None
        if found is not None:
            state.agreement = found.agreement
            state.usual_agreement += AGREEMENT_RATE * (found.agreement - state.usual_agreement)
        self.poses[k] = predicted if found is None else found.pose
        if found is None:
            self._handle_failure(k)
            return
        self.noise[k] = found.noise
        if since > 0:
            state.velocity = compose(invert(self.poses[state.last_matched]), found.pose) / since
            state.learn_slip(compose(invert(predicted), found.pose), deviations, since)
        state.last_matched = k
        state.failures.clear()
        state.last_unmatched = None
        step = compose(invert(self.poses[state.key_frames[-1]]), found.pose)
        if np.hypot(step[0], step[1]) > self.apart[0] or abs(step[2]) > self.apart[1]:
            self._update_wheels(k, step, found)
            self._add_key_frame(k, found)

    def _place_before_first(self) -> None:
        """Place the scans before the first key frame, which have no returns, by the odometry back from it."""
        n = self.state.key_frames[0] if self.state.key_frames and self.odometry is not None else 0
        for k in range(n, 0, -1):
            step, deviations = self._predict(k, k - 1)  # from a pose that is still zero
            if deviations is None:
                self.state.jumps.append(k)
            self.poses[k - 1] = compose(self.poses[k], invert(step))

    def _predict(self, k: int, last: int) -> tuple[Floats, Floats | None]:
        """Return the predicted pose of scan k from the last one, and its standard deviations; None after a jump."""
        state = self.state
        dt = max(float(self.stamps[k] - self.stamps[last]), 0.0)
        if self.odometry is None or state.wheels is None:
            s = FRONT_END
            deviations = np.array([s.speed_sd, s.speed_sd, s.turn_rate_sd]) * dt + 0.01
            return compose(self.poses[last], state.velocity * dt), deviations
        step = compose(invert(self.odometry[last]), self.odometry[k])
        way = float(np.hypot(step[0], step[1]))
        took = max(dt, self.interval)
        if way > WHEELS.max_speed * took + 0.1 or abs(step[2]) > WHEELS.max_turn_rate * took + 0.2:
            return compose(self.poses[last], state.velocity * dt), None
        corrected = state.wheels.corrected(step)
        deviations = state.wheels.deviations(way, float(corrected[2]))
        return compose(self.poses[last], corrected), np.hypot(deviations, state.slip * dt)

    def _match(self, k: int, predicted: Floats, deviations: Floats | None) -> Match | None:
        """Return the best match, or None if none is good enough."""
        if is_covered(self.scans, k):
            return None
        first = self._match_from(k, predicted, deviations)
        is_other = first.agreement < FRONT_END.min_continuity * self.state.agreement or self._has_slipped(
            first, predicted, deviations
        )
        is_good = self._is_good(first, MIN_SHARE_AFTER_FAILURE if self.state.failures else 0.0)
        found: Match | None = first if is_good else None
        if is_other or not is_good:  # the robot may have been carried
            found = self._other_starts(k, predicted, first) or found
        if (
            found is not None
            and self._has_slipped(found, predicted, deviations)
            and not self._contradicts(k, predicted)
        ):
            found = None  # the laser looks at what it has not seen yet, and a few surfaces fit many places
        if is_other and (found is not None or self.state.last_unmatched is None):
            # no scan between the two was matched
            self.is_continuous[[self.state.last_matched + 1, k]] = False
        return found

    def _has_slipped(self, found: Match, predicted: Floats, deviations: Floats | None) -> bool:
        """Tell whether a match is farther from the prediction than slip explains."""
        if deviations is None:
            return False
        off = compose(invert(predicted), found.pose)
        return bool((np.abs(off) > FRONT_END.most_slip(deviations)).any())

    def _contradicts(self, k: int, predicted: Floats) -> bool:
        """Tell whether scan k at its predicted pose contradicts the recent key frames."""
        state = self.state
        assert state.surfaces is not None
        recent = self._recent_key_frames()
        return contradicts(self.scans, k, predicted, state.surfaces.points, recent, self.poses[recent])

    def _other_starts(self, k: int, predicted: Floats, first: Match) -> Match | None:
        """Return the best match from starts around the prediction and around the last pose."""
        best = first
        last = self.poses[self.state.last_matched]
        offsets = [(a, b) for a in START_OFFSETS for b in START_OFFSETS if a == 0 or b == 0]
        for base in (predicted, last):
            for turn in START_TURNS:
                for offset in offsets:
                    found = self._match_from(k, compose(base, np.array([*offset, turn])))
                    if found.agreement > best.agreement:
                        best = found
            if self._is_good(best, MIN_SHARE_ELSEWHERE):
                return best
        return best if self._is_good(best, MIN_SHARE_ELSEWHERE) else None

    def _is_good(self, found: Match, share: float) -> bool:
        """Tell whether enough points fit, in total and as a share of the usual agreement."""
        s = FRONT_END
        is_usual = found.agreement >= share * self.state.usual_agreement
        return found.inliers >= s.min_inliers and found.overlap >= s.min_overlap and is_usual

    def _edge(self, k: int, found: Match | None) -> tuple[Floats, Floats]:
        """Return the information (3, 3) of key frame k's pose in the frame of the last one, and the standard deviations
        (3,) of this motion without the scans."""
        key = self.state.key_frames[-1]
        deviations = self._predict(k, key)[1] if self._is_odometry_whole(key, k) else None
        if deviations is None:
            deviations = self._unknown_motion(key, k)
        information = information_at(self.poses[k], deviations)
        if found is not None:
            information = information + found.information / CORRELATION
        floor = np.diag(np.square(EDGE_FLOOR))
        turn = turn_matrices(-self.poses[key, 2])
        covariance = turn @ (np.linalg.inv(information) + floor) @ turn.T
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64), deviations

    def _unknown_motion(self, first: int, last: int) -> Floats:
        """Return the standard deviations (3,) of a motion between two scans without odometry.

        The speed is unknown and persists since `determined_at`: the deviation from there is proportional to time.
        """
        s, start = FRONT_END, self.state.determined_at
        since, before = self.stamps[last] - start, self.stamps[first] - start
        dt = float(np.sqrt(max(since**2 - before**2, 0.0)))
        return dt * np.array([s.speed_sd, s.speed_sd, s.turn_rate_sd]) + 0.01

    def _is_odometry_whole(self, first: int, last: int) -> bool:
        """Tell whether the odometry connects two scans without a jump."""
        return self.odometry is not None and not any(first < jump <= last for jump in self.state.jumps)

    def _update_wheels(self, k: int, step: Floats, found: Match) -> None:
        """Learn the wheels from a step that the scans determine."""
        state, last = self.state, self.state.key_frames[-1]
        if self.odometry is None or state.wheels is None or not self._is_odometry_whole(last, k):
            return
        if determines_all(found.projection) and determines_all(state.projections[-1]):
            state.wheels.learn(compose(invert(self.odometry[last]), self.odometry[k]), step)

    def _add_key_frame(self, k: int, found: Match | None = None) -> None:
        """Add scan k, with its match to the map, as key frame; without a match, a new track segment begins."""
        state, s = self.state, FRONT_END
        is_new = bool(state.key_frames) and (found is None or self._is_apart(k, found))
        if state.key_frames:
            edge, deviations = self._edge(k, None if is_new else found)
            is_carried = is_new and self._is_carried(k, deviations)
            if is_new and not is_carried:
                edge = np.diag(np.array(s.unknown_motion) ** -2.0)
            state.edges.append(edge)
            state.motion_deviations.append(deviations)
            state.is_carried.append(is_carried)
        state.key_frames.append(k)
        state.piece.append(state.piece[-1] + int(is_new) if state.piece else 0)
        recent = self._recent_key_frames()
        state.surfaces = line_map(
            *thinned(*points_in(self.scans, recent, self.poses[recent])), side=self.matching.first_radius
        )
        if found is None:  # the scan determines what a match to its own surfaces determines
            found = self._match_from(k, self.poses[k])
        turn = turn_matrices(self.poses[k, 2])
        state.projections.append(turn.T @ found.projection @ turn)
        if determines_all(found.projection) or len(recent) == 1:
            state.determined_at = float(self.stamps[k])

    def _recent_key_frames(self) -> list[int]:
        """Return the last key frames of the present track segment, at most `WINDOW`."""
        piece = self.state.piece
        return self.state.key_frames[-sum(p == piece[-1] for p in piece[-WINDOW:]) :]

    def _is_apart(self, k: int, found: Match) -> bool:
        """Tell whether scan k ends a stretch whose length is not known, as after a corridor without odometry."""
        key = self.state.key_frames[-1]
        if determines_all(self.state.projections[-1]) or not determines_all(found.projection):
            return False
        unknown = FRONT_END.speed_sd * (self.stamps[k] - self.state.determined_at)
        return not self._is_odometry_whole(key, k) and bool(unknown > FRONT_END.unknown_motion[0])

    def _is_carried(self, k: int, deviations: Floats) -> bool:
        """Tell whether the odometry carries the pose to scan k: it is accurate enough, and the robot drove.

        If the view changes while the wheels stand, somebody may have carried the robot.
        """
        s, key, last = FRONT_END, self.state.key_frames[-1], self.state.last_matched
        if self.odometry is None or not self._is_odometry_whole(key, k):
            return False
        changes = [one for one in self.state.failures if not self.is_continuous[one]]
        then = changes[-1] if changes else k
        moved = compose(invert(self.odometry[last]), self.odometry[then])
        still = max(self.stamps[then] - self.stamps[last], self.interval) / STILL_TIME
        drove = np.hypot(*moved[:2]) > STILL[0] * still or abs(moved[2]) > STILL[1] * still
        return bool(drove and (deviations < s.unknown_motion).all())

    def _handle_failure(self, k: int) -> None:
        """Wait for a match, or begin a new track segment."""
        state, s = self.state, FRONT_END
        if not state.failures:  # later scans were placed by the wheels, assuming standstill
            self.matched[state.last_matched + 1 : k] = False
        if not is_covered(self.scans, k):
            self._match_unplaced(k)
        state.failures.append(k)
        first = state.failures[0]
        moved = self.poses[k, :2] - self.poses[first, :2]
        is_long = self.stamps[k] - self.stamps[first] > s.patience or np.hypot(*moved) > s.patience_distance
        if len(state.failures) >= PATIENCE_SCANS and is_long and not is_covered(self.scans, k):
            self._begin_piece(k)

    def _is_unknown(self, k: int) -> bool:
        """Tell whether scan k follows a pause without returns or scans, during which nothing measured the motion."""
        s, last = FRONT_END, self.state.last_matched
        pause = self.stamps[k] - self.stamps[last]
        is_long = pause > max(s.patience, PATIENCE_SCANS * self.interval)
        return bool(is_long and not self._is_odometry_whole(last, k) and not is_covered(self.scans, k))

    def _has_stayed(self, k: int, distance: float, turn: float) -> bool:
        """Tell whether scan k shows the view of the last matched scan, from within a distance [m] and a turn [rad]."""
        last = self.poses[self.state.last_matched]
        found = self._match_from(k, last)
        moved = compose(invert(last), found.pose)
        is_near = np.hypot(moved[0], moved[1]) < distance and abs(moved[2]) < turn
        return bool(is_near and found.agreement >= FRONT_END.min_continuity * self.state.agreement)

    def _match_from(
        self, k: int, start: Floats, deviations: Floats | None = None, surfaces: LineMap | None = None
    ) -> Match:
        """Match scan k from a start pose (3,), which is a prior with `deviations` (3,), to the key frames or other surfaces."""
        own, surfaces = self.scans.of(k), surfaces or self.state.surfaces
        assert surfaces is not None
        prior = None if deviations is None else information_at(start, deviations)
        return match(
            self.scans.points[own],
            self.scans.normals[own],
            surfaces,
            start,
            prior_information=prior,
            settings=self.matching,
        )

    def _begin_piece(self, k: int) -> None:
        """Begin a new track segment with scan k."""
        state = self.state
        self._add_key_frame(k)
        state.last_matched, state.agreement = k, 0.0
        state.failures.clear()
        state.last_unmatched = None
        state.velocity = np.zeros(3)

    def _match_unplaced(self, k: int) -> None:
        """Place an unmatched scan k by a match with the previous unmatched scan."""
        state = self.state
        if state.last_unmatched is not None:
            last, surfaces = state.last_unmatched
            found = self._match_from(k, *self._predict(k, last), surfaces)
            self.is_continuous[k] = self._is_good(found, FRONT_END.min_continuity)
            if self.is_continuous[k]:
                self.poses[k] = found.pose
        seen = points_in(self.scans, [k], self.poses[[k]])
        state.last_unmatched = k, line_map(*thinned(*seen), side=self.matching.first_radius)


def track(
    scans: ScanPoints, stamps: Floats, odometry: Floats | None, progress: ProgressBars, spacing: float = 1.0
) -> ScanTrack:
    """Track all scans.

    Parameters
    ----------
    stamps : (n_scans,) [s]
    odometry : (n_scans, 3) [m, m, rad] Odometry at the scans; None: the scans alone.
    spacing : Distance and turn between key frames, relative to those of `FRONT_END`.
    """
    with progress("tracking", "scans") as tick:
        return Tracker(scans, stamps, odometry, spacing).run(tick)


def track_part(run: Run, part: slice, motion: Motion | None = None) -> tuple[ScanPoints, ScanTrack]:
    """Track some scans of a run with its odometry, or alone; return their points and their track."""
    some = run.take_scans(part)
    scans = scan_points(some, motion)
    odometry = None if motion is None else motion.at(some.stamps)
    return scans, track(scans, some.stamps, odometry, no_progress)
