"""Scans of a running robot in the order of arrival, without writing a file."""

from __future__ import annotations

import time
from collections.abc import Mapping

from logs.errors import LogError
from logs.live.keys import PublishedTopic
from logs.live.network import LiveMessage, RosNetwork
from logs.live.recording import PATIENCE, TopicRate
from logs.live.window import MessageWindow
from logs.ros.recording import KEPT_TYPES, RANGE_TYPE, SCAN_TYPE, check_roles
from logs.run import Run

WINDOW = 2.0
"""[s] of messages that are interpreted together: the motion around a scan."""


class LiveScans:
    """The latest seconds of a running robot.

    Parameters
    ----------
    topics : Role -> topic, for non-standard topic names.
    """

    def __init__(self, network: RosNetwork, *, topics: Mapping[str, str] | None = None) -> None:
        check_roles(topics)
        self.network, self.roles = network, dict(topics or {})
        self.rates: dict[str, TopicRate] = {}
        """Topic -> statistics of its messages."""
        self._window = MessageWindow(WINDOW)

    @property
    def n_scans(self) -> int:
        """Number of messages with readings so far."""
        return sum(rate.n_messages for rate in self.rates.values() if rate.type in (SCAN_TYPE, RANGE_TYPE))

    def wait(self, patience: float | None = None) -> Run:
        """Return the first seconds that contain a scan.

        Raises
        ------
        LogError
            If no scan arrives in time [s]; None: as in a recording.
        """
        until = time.monotonic() + (PATIENCE if patience is None else patience)
        while time.monotonic() < until:
            self.pump(0.5)
            if self.n_scans > 2 and (run := self.recent()) is not None:
                return run
        names = ", ".join(sorted(self.network.topics)) or "no topic"
        raise LogError(
            f"no scan arrives in domain {self.network.domain} at {self.network.router}; found: {names}; start the driver, "
            "select the topic (`topics` scan=/front/scan), or set `domain`"
        )

    def pump(self, duration: float) -> None:
        """Take the messages that arrive within `duration` [s], and those that wait, for as long again."""
        until = time.monotonic() + duration
        while time.monotonic() < until + duration:
            item = self.network.next(until)
            if item is None and time.monotonic() >= until:
                return
            if isinstance(item, PublishedTopic):
                if self._is_wanted(item):
                    self.rates.setdefault(item.name, TopicRate(item.type))
                    self.network.listen(item)
            elif isinstance(item, LiveMessage):
                self.rates[item.topic.name].add(item)
                self._window.add(item)

    def recent(self) -> Run | None:
        """Return the latest seconds as a run; None if they contain no scan."""
        return self._window.run("live", self.roles)

    def _is_wanted(self, topic: PublishedTopic) -> bool:
        if topic.type in (SCAN_TYPE, RANGE_TYPE) and "scan" in self.roles:
            return topic.name in {"/" + name.strip().lstrip("/") for name in self.roles["scan"].split(",")}
        return topic.type in KEPT_TYPES
