"""Watch scans one after the other, and state once a second what they say about pose, place and robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from logs.run import RangeSensor, Run
from sensorgraph.errors import refuse_wrong_types
from sensorgraph.graph import Sensorgraph
from sensorgraph.types import Floats
from sensorgraph.watching.evidence import Baseline
from sensorgraph.watching.observation import Observation, observations
from sensorgraph.watching.place import Place
from sensorgraph.watching.pose import PoseJudge, PoseStatement
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.robot import SURE, RobotHealth
from sensorgraph.watching.scan_input import ScanInput
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.tracker import PoseTracker

PERIOD = 1.0
"""[s] between two statements."""
LONGEST_GAP = 5.0
"""[s] without scans after which this is noted."""
CLOCK_JUMP = 86_400.0
"""[s] A longer time without scans is a jump of the clock."""
MARGIN = 2.0
"""[m] around the surfaces of the graph in which changes are collected."""
PRECISE = 0.1
"""[m] Standard deviation of a pose above which its scan says nothing about place and robot."""


class Watcher:
    """Watches one robot in the place of a graph. Memory is constant; `add` takes one scan after the other.

    Parameters
    ----------
    sensor : Laser of the scans, with its mount. None: as in the graph.
    baseline : Fault -> size of a healthy robot, from good runs (`policy`).
    waits : Whether scans wait for a search for the robot that takes longer than stated, so that a log has the same result on
        each machine.

    Raises
    ------
    SensorgraphError : The graph has another model than faces or cells, or the laser has other rays.
    """

    def __init__(
        self,
        graph: Sensorgraph,
        sensor: RangeSensor | None = None,
        *,
        baseline: Mapping[str, Baseline] | None = None,
        waits: bool = True,
    ) -> None:
        self.graph = graph
        self.readings = GraphReadings(graph, graph.sensor if sensor is None else sensor)
        self.tracker = PoseTracker(graph, self.readings, waits=waits)
        self.judge = PoseJudge(self.tracker)
        window = self.tracker.place.window
        half = np.array([window.half_x, window.half_y]) + MARGIN
        middle = np.array([window.x, window.y])
        self.place = Place(self.readings, middle - half, middle + half)
        self.robot = RobotHealth(self.readings, baseline)
        self._last_scan, self._last_said = -math.inf, -math.inf
        self._before: PoseStatement | None = None
        self._notes: list[str] = []
        self._repeated: dict[str, tuple[str, int]] = {}
        """Fault of the input -> first note, and how often it came since the last status."""
        self._has_belief = self._has_odometry = False

    def note(self, line: str) -> None:
        """Add a fault of the input to the next status."""
        self._notes.append(line)

    def add(self, observation: Observation) -> WatchStatus | None:
        """Take one scan; return a status if one is due, else None."""
        observation = self._finite(observation)
        stamp = observation.stamp
        if not self._check(observation):
            return None
        is_said = stamp - self._last_said >= PERIOD
        # without odometry, nothing tells how far the robot is from its last tracked pose
        if self.tracker.is_due(observation) or (is_said and observation.odometry is None):
            now = self.tracker.update(observation)
            self._learn(now)
        self._last_scan = stamp
        if not is_said:
            return None
        self._last_said = stamp
        return self._status(observation)

    def _finite(self, observation: Observation) -> Observation:
        """Return a scan whose odometry and believed pose are unknown, with a note, if they are not finite."""
        values = observation
        for name, words in (("odometry", "odometry"), ("believed", "believed pose")):
            value = getattr(values, name)
            if value is not None and not np.isfinite(value).all():
                self._repeat(f"the {words} is not finite", f" at {observation.stamp:.1f} s")
                unknown: dict[str, Any] = {name: None}
                values = replace(values, **unknown)
        return values

    def _repeat(self, what: str, first: str) -> None:
        """Note a fault that may repeat at every scan: the first time, and how often it came until the next status."""
        text, n = self._repeated.get(what, (f"{what}{first}", 0))
        self._repeated[what] = text, n + 1

    def _check(self, observation: Observation) -> bool:
        """Note a scan that cannot be used, a gap, or a pose that stopped; tell whether the scan is used."""
        stamp, last = observation.stamp, self._last_scan
        if len(observation.ranges) != self.readings.sensor.n_rays:
            n, expected = len(observation.ranges), self.readings.sensor.n_rays
            self._repeat(f"a scan has {n} rays, expected {expected}", f", at {stamp:.1f} s")
            return False
        if not math.isfinite(stamp):
            self._repeat("a scan has a stamp that is not finite", "")
            return False
        if stamp < last:
            if last - stamp < LONGEST_GAP:
                back = f" by {last - stamp:.2f} s at {last:.1f} s; the scan is left out"
                self._repeat("the clock of the scans went back", back)
                return False
            self._restart(last, stamp)
        elif math.isfinite(last) and stamp - last > CLOCK_JUMP:
            self._restart(last, stamp)
        elif stamp - last > LONGEST_GAP and math.isfinite(last):
            self.note(f"no scan for {stamp - last:.1f} s up to {stamp:.1f} s")
            self.robot.lose()
        if self._has_belief and observation.believed is None:
            self.note(f"the robot states no pose since {stamp:.1f} s")
        if self._has_odometry and observation.odometry is None:
            self.note(f"no odometry since {stamp:.1f} s")
        self._has_belief = observation.believed is not None
        self._has_odometry = observation.odometry is not None
        return True

    def _restart(self, last: float, stamp: float) -> None:
        """Go on after a jump of the clock from one stamp [s] to another."""
        self.note(f"the clock of the scans jumped from {last:.1f} to {stamp:.1f} s")
        self._last_said = -math.inf
        self.tracker.restart_clock()
        self.robot.lose()

    def _learn(self, now: ScanInput) -> None:
        """Learn about place and robot from a scan whose pose is sure."""
        main = self.tracker.main
        is_sure = main is not None and main.is_matched and -math.expm1(main.score) < SURE
        if main is None or not is_sure or np.sqrt(main.covariance[:2, :2].trace()) > PRECISE:
            self.robot.lose()
            return
        expected = self.readings.predict(main.pose)
        # an error of the laser is none of the place
        ranges = now.observation.ranges - self.tracker.offset.value
        seen = replace(now, observation=replace(now.observation, ranges=ranges))
        found = self.readings.evidence(ranges, main.pose[None], expected=expected)
        self.place.update(seen, main, expected, found, self.tracker.usable)
        stands = self.place.stands(now.observation.stamp, main.pose, expected)
        self.robot.update(now, main.pose, expected, stands)
        self.tracker.usable = self.robot.usable

    def _status(self, observation: Observation) -> WatchStatus:
        stamp, before = observation.stamp, self._before
        pose = self.judge.state(observation, self.robot.belief_age)
        is_same = before is not None and before.status == pose.status
        pose = replace(pose, since=before.since if before is not None and is_same else stamp)
        self._before = pose
        repeated = [text if n == 1 else f"{text}; {n} times" for text, n in self._repeated.values()]
        notes = (*self._notes, *repeated)
        self._notes, self._repeated = [], {}
        changes = self.place.changes()
        return WatchStatus(
            t=stamp, pose=pose, changes=changes, moved=self.place.moved(changes), share_predicted=self.place.share_predicted,
            doubts=self.robot.doubts(stamp), notes=notes,
        )  # fmt: skip


def watch_scans(
    graph: Sensorgraph,
    scans: Iterable[Observation],
    sensor: RangeSensor | None = None,
    *,
    baseline: Mapping[str, Baseline] | None = None,
) -> Iterator[WatchStatus]:
    """Yield a status once a second of the scans' clock."""
    watcher = Watcher(graph, sensor, baseline=baseline)
    for observation in scans:
        refuse_wrong_types({"scans": observation}, {"scans": Observation})
        status = watcher.add(observation)
        if status is not None:
            yield status


def watch_run(
    graph: Sensorgraph, run: Run, *, baseline: Mapping[str, Baseline] | None = None
) -> Iterator[WatchStatus]:
    """Yield a status once a second of a run; the last one notes scans that stop before the run ends."""
    ends = [part[-1] for part in (run.odom_stamps, run.pose_stamps, run.cmd_stamps) if len(part)]
    silent = max(ends, default=-math.inf) - float(run.stamps[-1]) if run.n_scans else 0.0
    last: WatchStatus | None = None
    for status in watch_scans(graph, observations(run), run.sensor, baseline=baseline):
        if last is not None:
            yield last
        last = status
    if last is not None:
        text = f"no scan in the last {silent:.1f} s of the run"
        yield replace(last, notes=(*last.notes, text)) if silent > LONGEST_GAP else last


def path_of(statuses: Iterable[WatchStatus]) -> Floats:
    """Return the tracked poses (n, 3); nan where no pose is known."""
    unknown = np.full(3, np.nan)
    return np.array([unknown if one.pose.pose is None else one.pose.pose for one in statuses]).reshape(-1, 3)
