"""Track a robot in the place of a graph as several possible poses, and "elsewhere", with probabilities.

Each possible pose (a mode) is a normal distribution, which the odometry moves and a match of the scan to the surfaces of
the graph corrects. Where the scan matches no surfaces, the evidence of the readings corrects it: the mode is a mixture of
seven parts, which the readings weigh. Their evidence also weighs the mode against another place that resembles it
(`resemblance`). An offset of all ranges is estimated with the pose. A robot is carried away, or back, at a known rate. This is a
hidden Markov model; its probabilities are the result.

Searches find other modes when the evidence stays below the usual one by as much as another place must gain. They are of the
surroundings of the most probable mode, and of the whole place. A new mode has half the prior of one among all places that can be
told apart: those in space that training rays crossed. The other half is that of a place outside the graph that resembles it. A
step that the odometry does not show, as of wheels that slip, leads to one more mode.

A ray says as much for or against a mode as space that training rays crossed lies on its way (`readings`). A robot that drives
outside what the graph knows goes on by odometry, with a growing covariance. Since its surroundings may look like those of
another mode, this is a hypothesis of its own, with a prior of one among all places.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.graph_walls import walls_of_graph
from sensorgraph.localization.known_map import known_map
from sensorgraph.types import Bools, Floats
from sensorgraph.watching.kept_scans import KeptScans
from sensorgraph.watching.laser_errors import RangeOffset
from sensorgraph.watching.missing import MissingEvidence
from sensorgraph.watching.modes import (
    Mode,
    corrected,
    error_of_step,
    exchanged,
    found_mode,
    joined,
    matched,
    moved_on,
    pruned,
    slipped,
    surroundings_of,
    velocity_of,
    weighed,
)
from sensorgraph.watching.observation import Observation
from sensorgraph.watching.readings import GraphReadings, ReadingEvidence
from sensorgraph.watching.resemblance import likelihoods_at, resemblance_of
from sensorgraph.watching.scan_input import (
    ScanInput,
    apart,
    at_stamp,
    changed_share,
    driven_on,
    new_share,
    odometry_step,
    points_of,
)
from sensorgraph.watching.search import PlaceSearch
from sensorgraph.watching.settings import PLACE, TRACKING, TrackingPriors


class PoseTracker:
    """Follows a robot; `update` takes one scan after the other.

    Parameters
    ----------
    waits : Whether scans wait for a search that takes longer than stated, as those of a log can. If not, its results are late.
    """

    def __init__(
        self,
        graph: Sensorgraph,
        readings: GraphReadings,
        priors: TrackingPriors = TRACKING,
        *,
        waits: bool = True,
    ) -> None:
        walls, normals = walls_of_graph(graph)
        self.place = known_map(walls, readings.seen, normals)
        self.readings, self.priors, self.waits = readings, priors, waits
        area, (side, turn) = readings.seen.area, priors.place_size
        self.log_places = math.log(max(area / side**2, 1.0) * 2 * math.pi / turn)
        """Logarithm of the number of places that can be told apart."""
        self.modes: list[Mode] = []
        self.elsewhere = 0.0
        """Logarithm of the probability of a place that resembles none of the modes."""
        self.usable: Bools = np.ones(len(readings.rays), dtype=np.bool_)
        """Rays whose readings count; those of a blocked sector do not."""
        self.offset = RangeOffset()
        self.missing = MissingEvidence(readings.expected, self.log_places, priors)
        self.kept, self.has_searched = KeptScans(priors), False
        self.search: PlaceSearch | None = None
        """The last search, which goes on in parallel."""
        self.drift, self.velocity = np.zeros(3), np.zeros(3)
        self.error, self.slip = np.zeros(3), np.zeros(3)
        """[m/s, m/s, rad/s] Error of the odometry's speed in the last step, and in both of the last two: slip lasts."""
        self.alone = 0.0
        """[m] Distance driven where the graph does not answer the rays or the scan does not match, less that where it does, at most
        twice the distance after which the believed pose is as probable as ours: after as much where it does, it is not."""
        self._last: Observation | None = None
        self._numbers = count(1)

    @property
    def main(self) -> Mode | None:
        """The most probable mode; None without any."""
        return max(self.modes, key=lambda mode: mode.score, default=None)

    @property
    def probabilities(self) -> Floats:
        """(n_modes,) Probability of each mode; the rest is elsewhere."""
        return np.asarray(np.exp(np.array([mode.score for mode in self.modes])))

    @property
    def p_elsewhere(self) -> float:
        """Probability that the robot is at none of the modes."""
        return math.exp(self.elsewhere) + sum(math.exp(mode.alike) for mode in self.modes)

    def is_due(self, observation: Observation) -> bool:
        """Tell whether a scan is far enough from the last one to be used, or must weigh a pose that was found."""
        last, s = self._last, self.priors
        if (
            last is None
            or (self.search is not None and self.search.ready)
            or observation.stamp - last.stamp >= s.update_period
        ):
            return True
        if last.odometry is None or observation.odometry is None:
            return observation.stamp - last.stamp >= 0.5 * s.update_period
        way, turn = apart(observation.odometry, last.odometry)
        slip = self.slip * (observation.stamp - last.stamp)
        return way + float(np.hypot(*slip[:2])) > s.update_distance or turn + slip[2] > s.update_turn

    def ahead(self, observation: Observation) -> Floats:
        """Return the motion (3,) since the last scan that was used: by the odometry, or at the last velocity."""
        last = self._last
        if last is None:
            return np.zeros(3)
        if last.odometry is None or observation.odometry is None:
            return driven_on(self.velocity, observation.stamp - last.stamp, self.priors)
        return np.asarray(compose(invert(last.odometry), observation.odometry))

    def restart_clock(self) -> None:
        """Forget the last scan: its stamp says nothing about the time since."""
        self._last = self.search = None

    def update(self, observation: Observation) -> ScanInput:
        """Take one scan; return it as it was used."""
        s = self.priors
        dt, step, deviations, is_jump = odometry_step(self._last, observation, self.velocity, s)
        if is_jump:
            self.missing.nats = math.inf
        velocity = step / dt if dt > 0 and not is_jump and step.any() else self.velocity
        ranges = observation.ranges - self.offset.value
        scan = points_of(self.readings.sensor, replace(observation, ranges=ranges), velocity)
        slip = self.slip * dt
        weight, changed = 1.0, 0.0
        if self._last is not None:  # a robot that stands and sees something else was carried
            changed = changed_share(self._last.ranges, observation.ranges, PLACE.least_difference)
            weight = max(new_share(step, slip, dt, s), changed)
        self._last, self.drift = observation, compose(self.drift, step)
        seen = at_stamp(self.readings.sensor, observation, velocity)
        now = ScanInput(observation=seen, scan=scan, drift=self.drift, weight=weight, changed=changed)
        before = self.main
        expected = np.hypot(deviations, slip)
        if self.search is not None:
            self.search.follow(step, expected, now)
        self.modes = [one for mode in self.modes for one in self._moved(mode, step, expected, dt, now)]
        self._add_belief(now)
        self._weigh(now, dt)
        main = self.main
        is_known = main is not None and main.is_matched and main.answered > s.answered
        moved = float(np.hypot(step[0], step[1])) * (-1.0 if is_known else 1.0)
        self.alone = min(max(self.alone + moved, 0.0), 2.0 * s.alone)
        self.kept.add(now, fits=self.missing.fits(main))
        if self.search is not None and self.search.ready:
            self._add_found(self.search.ready.pop())
        if self.search is not None and self.search.is_done:
            self.search = None
        if self.missing.is_enough and self.search is None:
            self._search(now)
        self.modes = pruned(self.modes, s)
        self._normalise()
        self.velocity = velocity_of(before, self.main, dt, s.max_speed, self.velocity)
        error = error_of_step(before, self.main, step, deviations, dt)
        self.slip, self.error = np.minimum(error, self.error), error
        return now

    def _moved(self, mode: Mode, step: Floats, deviations: Floats, dt: float, now: ScanInput) -> list[Mode]:
        """Move a mode by the odometry and match the scan there; without a match, the odometry may have failed as well."""
        moved = moved_on(mode, self.place, step, deviations, now)
        # where nothing is known, nothing shows slip
        if moved.is_matched or mode.answered <= self.priors.answered:
            return [moved]
        least = max(one.total for one in self.modes) - self.priors.dropped
        other = slipped(mode, self.place, now, self.velocity, dt, least, self.priors)
        if other is None:
            return [moved]
        new = next(self._numbers)  # the more probable one keeps the number
        return [replace(moved, number=new), other] if mode.slips else [moved, replace(other, number=new)]

    def _add_belief(self, now: ScanInput) -> None:
        """Add the pose that the robot believes, if no mode is there."""
        s, believed = self.priors, now.observation.believed
        if believed is None:
            return
        alike, handicap = math.log(max(self.p_elsewhere, 1e-300)), 0.0
        if not self.modes and not self.has_searched:
            score, alike = math.log(s.start), math.log(1.0 - s.start)
            self.elsewhere = -math.inf
        elif any(mode.is_at(believed, self.priors.tolerance) for mode in self.modes):
            return
        else:
            score = math.log(0.5 if self.alone > s.alone else s.belief)
            alike, handicap = alike + score, -score
        covariance = np.diag(np.asarray(s.start_deviations) ** 2)
        mode = Mode(
            pose=believed, covariance=covariance, score=score, alike=alike, number=next(self._numbers),
            handicap=handicap, resembles={} if self.main is None else self.main.resembles,
        )  # fmt: skip
        mode = corrected(mode, matched(self.place, believed, covariance, now))
        kept = [one for one in self.modes if not one.is_at(mode.pose, self.priors.tolerance)]
        if len(kept) == len(self.modes):  # its match is not one of the modes
            self.modes.append(mode)

    def _weigh(self, now: ScanInput, dt: float) -> None:
        """Weigh modes and elsewhere by the readings; the robot may have been carried away since the last scan."""
        s = self.priors
        n = self.readings.n_independent(now.observation.ranges)
        if not self.modes:
            self.missing.add(None, n, now.weight)
            return
        self._correct(now)
        found = self._evidence(now, np.array([mode.pose for mode in self.modes]))
        # a mode that was corrected has the mean likelihood of its parts, not that of its pose
        counted = now.weight * likelihoods_at(found, self._share(now))
        counted *= [not mode.is_matched for mode in self.modes]
        self.modes = [mode.plus(-float(one)) for mode, one in zip(self.modes, counted, strict=True)]
        first = int(np.argmax([mode.total for mode in self.modes]))
        if self.modes[first].is_matched:
            self.offset.add(found.residuals[first][found.known[first]], self._share(now), now.weight)
        carried = -0.5 * math.expm1(-2.0 * s.carried * dt)
        self.modes = [exchanged(mode, carried) for mode in self.modes]
        self.modes = weighed(self.modes, found, self._share(now), now.weight, self.log_places, s)
        self._normalise()
        self.missing.add(self.main, n, now.weight)

    def _correct(self, now: ScanInput) -> None:
        """Correct the modes by the evidence of the readings, where the scan matches no surfaces."""
        parts = [mode.parts() for mode in self.modes if not mode.is_matched]
        if not parts:
            return
        found = self._evidence(now, np.concatenate(parts))
        logs = iter((now.weight * likelihoods_at(found, self._share(now))).reshape(len(parts), -1))
        self.modes = [mode if mode.is_matched else mode.weighted(next(logs)) for mode in self.modes]

    def _evidence(self, now: ScanInput, poses: Floats) -> ReadingEvidence:
        """Return the evidence of the usable readings of a scan at poses (n, 3)."""
        all_rays, is_used = self.readings.of_pose, self.usable[self.readings.of_pose]
        of_pose = all_rays[is_used] if is_used.any() else all_rays  # covered rays tell no pose from another
        return self.readings.evidence(now.observation.ranges - self.offset.value, poses, of_pose)

    def _share(self, now: ScanInput) -> float:
        return self.readings.n_independent(now.observation.ranges) / max(len(self.readings.of_pose), 1)

    def _search(self, now: ScanInput) -> None:
        """Begin a search of the surroundings of the most probable mode, and of the whole place, for other modes.

        The tracking failed, or the robot was carried: the missing evidence does not distinguish these, and both have one rate.
        """
        self.missing.begin_search()
        self.has_searched, main = True, self.main
        if not self.kept:
            return
        step = compose(invert(self.kept.last_drift), self.drift)
        window = None if main is None else surroundings_of(main, invert(step))
        self.search = PlaceSearch(
            self.kept, window, self.place, self.readings.sees, self.priors, now, waits=self.waits
        )

    def _add_found(self, found: Mode) -> None:
        """Add a mode that a search found, if no other is there, weighed by the evidence of all scans that are kept."""
        if any(mode.is_matched and mode.is_at(found.pose, self.priors.tolerance) for mode in self.modes):
            return
        gains = []
        for one in self.kept:
            then = compose(invert(self.drift), one.drift)
            poses = np.array([compose(mode.pose, then) for mode in (found, *self.modes)])
            of_scan = resemblance_of(self._evidence(one, poses), self._share(one))
            gains.append(one.weight * np.vstack([of_scan.here, of_scan.elsewhere]))
        new, carried = replace(found, number=next(self._numbers)), self.kept.log_carried()
        mode, odds = found_mode(new, self.modes, self.elsewhere, np.array(gains), carried, self.log_places)
        self.modes = joined(self.modes, mode, odds)
        if self.main is mode:
            self.missing.nats = 0.0  # this was the evidence that the mode before lacked

    def _normalise(self) -> None:
        total = float(np.logaddexp.reduce([self.elsewhere, *(mode.total for mode in self.modes)]))
        self.elsewhere -= total
        self.modes = [mode.plus(-total) for mode in self.modes]
