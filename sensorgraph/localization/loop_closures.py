"""Loop closures: find revisited places by branch and bound, validate them, and add them to the pose graph.

Where the odometry carries the pose over a break of the track, other places are searched only if the submap contradicts the
older ones near it. Else it may show what the robot has not seen yet, and similar places would take it away.

A closure is kept only if it passes all tests. No other place fits equally well. Enough points lie on the
older surfaces. No ray of either visit crosses a surface of the other. The closure agrees with the other
closures.

In a corridor the direction along it is unconstrained, and the closure carries no information about it (Olson
2009; Hess et al. 2016).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from logs.transforms import compose, difference, distances_along, invert, wrap
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.matching import Match, match
from sensorgraph.localization.pose_graph import PoseEdges, PoseGraph
from sensorgraph.localization.result import Closure
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import CLOSURES, EDGE_FLOOR, FRONT_END
from sensorgraph.localization.submaps import (
    RIVAL_APART,
    SUBMAP,
    ClosureCandidate,
    RivalPlaces,
    Submap,
    cut_submaps,
    rival_places,
)
from sensorgraph.types import Bools, Floats, Progress

WINDOW = 0.4
"""[m] Minimum half width of the search, and that of the second pass, after the first has closed the loops."""
TURN_WINDOW = 0.05
"""[rad] Minimum half width of the heading search. A closure is rejected if the standard deviation of its heading is larger,
because it would constrain nothing."""
TURN_WINDOW_PER_METRE = 0.003
"""[rad/m] Growth of the heading half width per distance driven since the last closure ..."""
MAX_TURN_WINDOW = 0.8
"""[rad] ... up to this one."""
SECOND_TURN = 0.035
"""[rad] Heading half width of the second pass."""
BROKEN_WINDOW = 6.0
"""[m] Half width of the search around each older submap after a break of the track, until the next closure."""
BROKEN_CANDIDATES = 40
"""Approximate number of older submaps that are searched after a break."""
BROKEN_SCORE = 0.75
"""Minimum likelihood-field score after a break; it is higher because no prior pose supports the match."""
CANDIDATES = 3
"""Number of older visits that are searched for each submap."""
CORRELATION = 20.0
"""Factor by which the information of a submap match is reduced, since its residuals are correlated."""
NO_INFORMATION = 10.0
"""[m] Standard deviation assigned to an unconstrained direction."""
SOLVE_EVERY = 4
"""Number of submaps between optimizations of the pose graph during the search."""
KEPT_FIELDS = 128
"""Number of recently used submaps whose likelihood fields are kept; each takes 2 to 5 MB, and a day of driving has thousands."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedTrack:
    """Key frames after loop closing."""

    poses: Floats
    """(n_key, 3) [m, m, rad]"""
    kept: tuple[Closure, ...]
    refused: tuple[Closure, ...]
    steps: PoseEdges
    """Edges between neighbours of the track."""
    closures: PoseEdges
    """Edges of the kept closures."""
    is_carried: Bools
    """(n_key - 1,) `ScanTrack.is_carried`, without steps that closures contradict."""
    rivals: tuple[RivalPlaces, ...] = ()
    """Places that no closure distinguishes from similar ones."""


def steps_of(track: ScanTrack) -> PoseEdges:
    """Return the edges between neighbouring key frames."""
    poses = track.poses[track.key_frames]
    n = len(poses)
    return PoseEdges(
        first=np.arange(n - 1),
        second=np.arange(1, n),
        relative=compose(invert(poses[:-1]), poses[1:]),
        information=track.edge_information,
    )


class LoopCloser:
    """Search for the loop closures of a track."""

    def __init__(
        self, scans: ScanPoints, track: ScanTrack, *, size: int = SUBMAP, kept_fields: int = KEPT_FIELDS
    ) -> None:
        """Take a track.

        Parameters
        ----------
        size : Number of key frames of a submap.
        kept_fields : Number of likelihood fields in memory.
        """
        self.track, self.kept_fields = track, kept_fields
        self.submaps = cut_submaps(scans, track, size)
        self.apart = (
            size + size // 2
        )  # key frames between two submaps; closer ones are neighbours along the track
        self.steps = steps_of(track)
        start = track.poses[track.key_frames]
        self.graph = PoseGraph(start, self.steps, is_doubtful=track.is_carried)
        self.way = distances_along(start)
        variances = np.linalg.inv(track.edge_information)[:, [0, 1], [0, 1]].max(axis=1)
        self.variance = np.concatenate([[0.0], np.cumsum(variances)])  # [m²] of the position along the track
        self.found: list[tuple[int, int, Floats, Floats]] = []
        self.kept: list[Closure] = []
        self.refused: list[Closure] = []
        self.rivals: list[RivalPlaces] = []
        self._tried: set[tuple[int, int]] = set()
        self._searched: dict[int, None] = {}  # submaps with a likelihood field, by last use

    def run(self, progress: Progress) -> ClosedTrack:
        """Search along the track with growing windows, then again with small windows around the closed track."""
        n = len(self.submaps)
        self._first_pass(progress)
        if self.found:
            self.graph.solve(PoseEdges.of(self.found))
            for b in range(n):
                for a in self._candidates(b, CLOSURES.reach):
                    if (a, b) not in self._tried:
                        self._keep(b, self._search_pair(a, b, WINDOW, SECOND_TURN), 0.0)
                progress(n + b, 2 * n)
        closures = PoseEdges.of(self.found)
        if self.found:
            self.graph.solve(closures)
        poses, is_true = self.graph.solve_robustly(closures)
        for closure, good in zip(self.kept, is_true, strict=True):
            if not good:
                self._refuse(closure, "disagrees with the other closures")
        kept = tuple(closure for closure, good in zip(self.kept, is_true, strict=True) if good)
        is_carried = self.track.is_carried.copy()
        is_carried[is_carried] = self.graph.is_kept
        rows = [row for row, good in zip(self.found, is_true, strict=True) if good]
        return ClosedTrack(
            poses=poses,
            kept=kept,
            refused=tuple(self.refused),
            steps=self.steps,
            closures=PoseEdges.of(rows),
            is_carried=is_carried,
            rivals=self._unresolved_rivals(rows),
        )

    def _first_pass(self, progress: Progress) -> None:
        s, n = CLOSURES, len(self.submaps)
        last, new = 0, 0  # key frame of the last closure, number of closures since the last solution
        for b, submap in enumerate(self.submaps):
            way = float(self.way[submap.middle] - self.way[last])
            drift = 2.0 * float(np.sqrt(self.variance[submap.middle] - self.variance[last]))
            window = WINDOW + 2.0 * s.drift_per_metre * way
            turn = TURN_WINDOW + TURN_WINDOW_PER_METRE * way
            breaks = np.diff(self.track.piece[last : submap.middle + 1]) > 0
            if breaks.any():  # the wheels alone measured the motion
                window = max(window, drift)
            hits, is_lost = 0, bool((breaks & ~self.track.is_carried[last : submap.middle]).any())
            if not is_lost:
                window, turn = min(window, s.max_window), min(turn, MAX_TURN_WINDOW)
                near = list(self._candidates(b, s.reach + window))
                found = [one for a in near for one in self._search_pair(a, b, window, turn)]
                hits = self._keep(b, found, drift if breaks.any() else s.drift_per_metre * way)
                is_lost = bool(breaks.any()) and not hits and any(self._contradicts(a, b) for a in near)
            if is_lost:
                hits = self._search_everywhere(b)
            if hits:
                last, new = submap.middle, new + hits
            if new and (b % SOLVE_EVERY == 0 or b == n - 1):
                self.graph.solve(PoseEdges.of(self.found))
                new = 0
            progress(b, 2 * n)

    def _search_everywhere(self, b: int) -> int:
        """Search all older track segments for a submap after a break; return the number of closures that were kept."""
        piece = self.track.piece
        older = [a for a in range(b) if piece[self.submaps[a].middle] != piece[self.submaps[b].middle]]
        step = max(len(older) // BROKEN_CANDIDATES, 1)
        found = [
            one
            for a in older[::step]
            for one in self._search_pair(a, b, BROKEN_WINDOW, np.pi, guess=np.zeros(3), score=BROKEN_SCORE)
        ]
        return self._keep(b, found, np.inf, is_anywhere=True)

    def _candidates(self, b: int, reach: float) -> Iterator[int]:
        """Yield the nearest older submap of each visit near a submap, in order of distance."""
        middles = np.array([submap.middle for submap in self.submaps[:b]], dtype=np.intp)
        newer = self.submaps[b]
        apart = newer.key_frames[0] - np.array([submap.key_frames[-1] for submap in self.submaps[:b]])
        is_other = self.track.piece[middles] != self.track.piece[newer.middle]
        poses = self.graph.poses
        away = np.hypot(*(poses[middles, :2] - poses[newer.middle, :2]).T) if b else np.zeros(0)
        order = [
            int(a) for a in np.argsort(away) if away[a] < reach and (apart[a] >= self.apart or is_other[a])
        ]
        taken: list[int] = []
        for a in order:
            if all(abs(a - other) > 3 for other in taken):
                taken.append(a)
                yield a
            if len(taken) == CANDIDATES:
                return

    def _search_pair(
        self,
        a: int,
        b: int,
        window: float,
        turn: float,
        *,
        guess: Floats | None = None,
        score: float = CLOSURES.score,
    ) -> list[ClosureCandidate]:
        """Search submap a for submap b around a guess; return at most one candidate.

        Parameters
        ----------
        guess : (3,) [m, m, rad] Pose of b in a; None: the pose in the graph.
        score : Minimum likelihood-field score.
        """
        older, newer = self.submaps[a], self.submaps[b]
        self._tried.add((a, b))
        poses = self.graph.poses
        if guess is None:
            guess = compose(invert(poses[older.middle]), poses[newer.middle])
        if len(newer.search_points) < 10 or len(older.points[0]) < 10:
            return []
        box = SearchWindow.around(guess, half_xy=window, half_phi=turn)
        modes = older.pyramid.search(
            newer.search_points,
            box,
            min_score=score,
            max_modes=2,
            rival_ratio=CLOSURES.rivalry,
            apart=RIVAL_APART,
        )
        self._free_old_pyramids(a, b)
        if not len(modes.scores):
            return []
        found = match(*newer.core_points, older.surfaces, modes.poses[0], settings=older.matching)
        candidate = ClosureCandidate(
            older=older.middle,
            closure=Closure(
                first=int(self.track.key_frames[older.middle]),
                second=int(self.track.key_frames[newer.middle]),
                relative=found.pose,
                inliers=found.inliers,
                reason=self.objection(older, newer, found, guess, window, modes.rivalry),
            ),
            information=information_of(found),
            agreement=found.agreement,
            guess=guess,
            places=np.vstack([found.pose, modes.poses[1:]]),
        )
        return [candidate]

    def _free_old_pyramids(self, *used: int) -> None:
        """Free the least recently used likelihood fields."""
        for k in used:
            self._searched.pop(k, None)
            self._searched[k] = None
        while len(self._searched) > max(self.kept_fields, len(used)):
            oldest = next(iter(self._searched))
            del self._searched[oldest]
            self.submaps[oldest].forget_pyramid()

    def _keep(self, b: int, found: list[ClosureCandidate], drift: float, *, is_anywhere: bool = False) -> int:
        """Keep the valid closures of submap b; return their number.

        Parameters
        ----------
        drift : [m] Expected drift of the track; places farther from the tracked pose are no rivals.
        is_anywhere : The pose of the submap is unknown, so that a valid candidate does not exclude the places
            of another.
        """
        newer = self.submaps[b].middle
        good = [one for one in found if not one.closure.reason]
        considered = found if is_anywhere or not good else good
        rivals = rival_places(newer, considered, self.graph.poses, drift)
        if rivals is not None:
            self.rivals.append(rivals)
        for one in found:
            if one.closure.reason:
                self.refused.append(one.closure)
            elif rivals is not None:
                self._refuse(one.closure, "another place fits equally well")
            else:
                self.kept.append(one.closure)
                self.found.append((one.older, newer, one.closure.relative, one.information))
        return 0 if rivals is not None else len(good)

    def _unresolved_rivals(self, kept: list[tuple[int, int, Floats, Floats]]) -> tuple[RivalPlaces, ...]:
        """Return the rivals of submaps without a closure."""
        held = {key for row in kept for key in row[:2]}
        return tuple(one for one in self.rivals if one.newer not in held)

    def objection(
        self, older: Submap, newer: Submap, found: Match, guess: Floats, window: float, rivalry: float
    ) -> str:
        """Return the reason to reject a match, or an empty string."""
        s = CLOSURES
        if rivalry > 0:
            return f"another place has {100 * rivalry:.0f} % of its score"
        if found.overlap < s.overlap:
            return f"only {100 * found.overlap:.0f} % of the points have a surface near them"
        if found.inliers < FRONT_END.min_inliers:
            return f"only {100 * found.inliers:.0f} % of the points lie on surfaces"
        if np.abs(found.pose[:2] - guess[:2]).max() > window + WINDOW:
            return "the match left the search window"
        if float(np.linalg.inv(information_of(found))[2, 2]) > TURN_WINDOW**2:
            return "the visible surfaces do not determine the heading"
        through = seen_through(older, newer, found.pose, s.margin)
        if through > s.see_through:
            return f"rays would cross {100 * through:.0f} % of the visible surfaces"
        return ""

    def _contradicts(self, a: int, b: int) -> bool:
        """Tell whether submaps contradict each other where the odometry has them; then the robot may have been carried."""
        older, newer, poses = self.submaps[a], self.submaps[b], self.graph.poses
        relative = compose(invert(poses[older.middle]), poses[newer.middle])
        return seen_through(older, newer, relative, CLOSURES.margin) > CLOSURES.see_through

    def _refuse(self, closure: Closure, reason: str) -> None:
        self.refused.append(replace(closure, reason=reason))


def seen_through(older: Submap, newer: Submap, relative: Floats, margin: float) -> float:
    """Return the share of the visible surfaces of one submap that rays of the other cross; `relative` is newer in older."""
    return max(
        newer.sees_through(older, invert(relative), margin), older.sees_through(newer, relative, margin)
    )


def information_of(found: Match) -> Floats:
    """Return the information (3, 3) in the older submap's frame; none along a corridor."""
    information = found.information / CORRELATION
    lowest = float(np.linalg.eigvalsh(information)[0])
    direction, sd = found.weak_direction
    covariance: Floats = np.asarray(
        np.linalg.inv(information + (1e-6 + max(-lowest, 0.0)) * np.eye(3)), dtype=np.float64
    )
    covariance = covariance + np.diag(np.square(EDGE_FLOOR))
    if sd * np.sqrt(CORRELATION) > CLOSURES.weak:
        along = np.append(direction, 0.0)
        covariance = covariance + NO_INFORMATION**2 * np.outer(along, along)
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def close_loops(scans: ScanPoints, track: ScanTrack, progress: Progress) -> ClosedTrack:
    """Find the loop closures of a track; return the poses of its key frames with them."""
    return LoopCloser(scans, track).run(progress)


def spread(track: ScanTrack, poses: Floats) -> Floats:
    """Return the poses (n_scans, 3) of all scans, given those of the key frames (n_key, 3).

    Between two key frames the motion of the track applies; its error at the second is distributed evenly over
    the scans.
    """
    left, right, share = track.between_key_frames()
    keys = track.key_frames
    moved = compose(poses[left], compose(invert(track.poses[keys[left]]), track.poses))
    there = compose(poses[left], compose(invert(track.poses[keys[left]]), track.poses[keys[right]]))
    out: Floats = moved + share[:, None] * difference(poses[right], there)
    out[:, 2] = wrap(out[:, 2])
    return out
