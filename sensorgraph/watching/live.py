"""Watch a running robot: scans as they arrive, and the statements published on /diagnostics."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from logs.live.keys import PublishedTopic
from logs.live.network import RosNetwork
from logs.live.recording import LiveScans
from logs.ros.diagnostics import DIAGNOSTICS_TYPE, MARKERS_TYPE, diagnostic_message, marker_message
from sensorgraph.graph import Sensorgraph
from sensorgraph.watching.messages import DIAGNOSTICS_TOPIC, MARKERS_TOPIC, outlines_of, statements_of
from sensorgraph.watching.observation import Observation, observations
from sensorgraph.watching.policy import WatchPolicy
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.watcher import Watcher

LOOK_EVERY = 0.05
"""[s] Interval at which new messages are interpreted: the delay of a statement."""
RESET = 5.0
"""[s] A clock that goes back by more has started again."""


LOOKS = 6
"""Number of synthetic scans from each of two poses."""


def warm_up(graph: Sensorgraph) -> None:
    """Watch a robot that must be searched for and is then carried away, so that all kernels are compiled before scans arrive.

    The scans are those that the graph predicts at poses in the space that it has seen.

    Raises
    ------
    SensorgraphError : The graph has another model than faces or cells.
    """
    watcher = Watcher(graph)
    poses = np.repeat(watcher.readings.seen.draw(2, np.random.default_rng(0)), LOOKS, axis=0)
    ranges = graph.predict(watcher.readings.graph_poses(poses)).ranges
    for k, scan in enumerate(ranges):
        believed = poses[0] if k >= LOOKS // 2 else None
        watcher.add(Observation(stamp=float(k), ranges=scan, odometry=np.zeros(3), believed=believed))


class LiveWatch:
    """Statements about a running robot."""

    def __init__(
        self, graph: Sensorgraph, scans: LiveScans, policy: WatchPolicy, *, wait: float | None = None
    ) -> None:
        run = scans.wait(wait)
        self.scans, self.policy = scans, policy
        self.watcher = Watcher(graph, run.sensor, baseline=policy.baseline, waits=False)
        self.epoch_ns = run.epoch_ns
        """[ns] Absolute time of stamp 0."""
        self.n_used, self.n_dropped = 0, 0

    def statuses(self, duration: float | None) -> Iterator[WatchStatus]:
        """Yield a status once a second for a duration [s]; None: without end."""
        began, last = time.monotonic(), -math.inf
        arrived = self.scans.n_scans
        while duration is None or time.monotonic() - began < duration:
            self.scans.pump(LOOK_EVERY)
            run = self.scans.recent()
            if run is None or run.n_scans == 0:
                continue
            later = (run.epoch_ns - self.epoch_ns) * 1e-9
            if float(run.stamps[-1]) + later < last - RESET:
                last = -math.inf
            used = 0
            for one in observations(run, after=last - later):
                last, used = one.stamp + later, used + 1
                status = self.watcher.add(replace(one, stamp=last))
                if status is not None:
                    yield status
            lost = self.scans.n_scans - arrived - used
            arrived = self.scans.n_scans
            self.n_used += used
            if lost > 1 and self.n_used > used:
                self.n_dropped += lost
                self.watcher.note(f"{lost} scans are left out: they arrive faster than they are watched")

    def publish(self, network: RosNetwork, status: WatchStatus) -> None:
        """Publish one status, and the outlines of the changes."""
        ns = max(self.epoch_ns + round(status.t * 1e9), 0)
        network.publish(
            PublishedTopic(name=DIAGNOSTICS_TOPIC, type=DIAGNOSTICS_TYPE),
            diagnostic_message(ns, statements_of(status, self.policy)),
        )
        network.publish(
            PublishedTopic(name=MARKERS_TOPIC, type=MARKERS_TYPE), marker_message(ns, outlines_of(status))
        )
