"""Record or watch a running robot: write messages as received, detect gaps, and give the latest seconds as a run."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from statistics import median
from types import TracebackType

import numpy as np

from logs.errors import LogError
from logs.formats.mcap_file import RosFile
from logs.live.keys import PublishedTopic
from logs.live.network import LiveMessage, RosNetwork
from logs.ros.interpret import to_run
from logs.ros.recording import KEPT_TYPES, RANGE_TYPE, SCAN_TYPE, TF_TYPE, Recording, Topic, check_roles
from logs.run import Run
from logs.types import ReadOptions

PATIENCE = 10.0
"""[s] default time in which a topic with readings and all selected topics must be announced."""
GAP_PERIODS = 3.0
"""Minimum duration of a gap, in periods of the topic."""
LEAST_GAP = 0.25
"""[s] minimum duration of a gap."""
GAP_STEPS = 20
"""Number of steps whose median is the period, so that one gap does not hide the next."""
RATE_SPAN = 5.0
"""[s] interval over which the displayed rate is counted."""
POSE_WINDOW, SCAN_WINDOW = 6.0, 2.0
"""[s] of messages kept to estimate the current pose of the robot, and the motion around a scan."""
LOOK_EVERY = 0.1
"""[s] interval between checks of the router."""


class MessageWindow:
    """Messages of the latest `duration` [s], and all static transforms."""

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self._recent: deque[LiveMessage] = deque()
        self._fixed: dict[str, list[LiveMessage]] = {}

    def add(self, message: LiveMessage) -> None:
        """Add a message, and forget those that are too old."""
        name = message.topic.name
        if message.topic.type == TF_TYPE and name.rstrip("/").endswith("tf_static"):
            self._fixed.setdefault(name, []).append(message)
            return
        self._recent.append(message)
        while self._recent[0].received_ns < message.received_ns - self.duration * 1e9:
            self._recent.popleft()

    def run(self, source: str, roles: Mapping[str, str]) -> Run | None:
        """Return the messages as a run of a source; None if they contain no scan."""
        recording = Recording(format="mcap")
        for message in (*(m for kept in self._fixed.values() for m in kept), *self._recent):
            name, kind = message.topic.name, message.topic.type
            recording.topics.setdefault(name, Topic(name, kind)).add(message.received_ns, message.payload)
        try:
            with np.errstate(all="ignore"):
                return to_run(recording, source, ReadOptions(topics=roles))
        except LogError:
            return None


@dataclass
class TopicRate:
    """Statistics of the received messages of a topic; all times are in seconds since the epoch."""

    type: str
    n_messages: int = 0
    n_lost: int = 0
    """Number of messages that were sent, according to the sequence numbers, but not received."""
    n_gaps: int = 0
    longest_gap: float = 0.0
    """[s] longest time between two messages."""
    longest_gap_began: float = 0.0
    """[s] time of the message before the longest gap."""
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=1000))
    """[s] times of the latest messages."""
    _sequences: dict[bytes, int] = field(default_factory=dict)

    def hz(self, now: float) -> float:
        """Return the message rate [Hz] up to now [s]; 0 for a silent topic."""
        begin = max(now - RATE_SPAN, self.recent[0]) if self.recent else now
        count = sum(at > begin for at in self.recent)
        return count / (now - begin) if now > begin else 0.0

    def silence(self, now: float) -> float:
        """Return the time [s] since the last message."""
        return now - self.recent[-1] if self.recent else 0.0

    def is_gap(self, silence: float) -> bool:
        """Return whether a silence [s] is too long for the rate of the topic."""
        n = min(len(self.recent), GAP_STEPS + 1)
        if n <= 3 or silence <= LEAST_GAP:
            return False
        latest = [self.recent[-k] for k in range(n, 0, -1)]
        return silence > GAP_PERIODS * median(b - a for a, b in pairwise(latest))

    def add(self, message: LiveMessage) -> None:
        """Count a message."""
        at = message.received_ns / 1e9
        if self.recent:
            silence = at - self.recent[-1]
            if silence > self.longest_gap:
                self.longest_gap, self.longest_gap_began = silence, self.recent[-1]
            self.n_gaps += self.is_gap(silence)
        self.recent.append(at)
        self.n_messages += 1
        if message.sequence is not None:
            last = self._sequences.get(message.publisher)
            if last is not None and message.sequence > last + 1:
                self.n_lost += message.sequence - last - 1
            self._sequences[message.publisher] = message.sequence


@dataclass(kw_only=True)
class Outage:
    """A period without connection to the router."""

    began: float
    """[s] since the epoch."""
    ended: float | None = None
    """[s] since the epoch; None: still disconnected."""


class LiveScans:
    """The latest seconds of a running robot, without writing a file.

    Parameters
    ----------
    topics : Role -> topic, for non-standard topic names.
    """

    def __init__(
        self, network: RosNetwork, *, topics: Mapping[str, str] | None = None, window: float = SCAN_WINDOW
    ) -> None:
        check_roles(topics)
        self.network, self.roles, self.source = network, dict(topics or {}), "live"
        self.rates: dict[str, TopicRate] = {}
        """Topic -> statistics of its messages."""
        self._window = MessageWindow(window)

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
            self._take(item)

    def recent(self) -> Run | None:
        """Return the latest seconds as a run; None if they contain no scan."""
        return self._window.run(self.source, self.roles)

    def _take(self, item: LiveMessage | PublishedTopic | None) -> None:
        """Subscribe to an announced topic, or count and keep a received message."""
        if isinstance(item, PublishedTopic) and self._is_wanted(item):
            self.rates.setdefault(item.name, TopicRate(item.type))
            self.network.listen(item)
        elif isinstance(item, LiveMessage):
            self.rates[item.topic.name].add(item)
            self._window.add(item)

    def _is_wanted(self, topic: PublishedTopic) -> bool:
        if topic.type in (SCAN_TYPE, RANGE_TYPE) and "scan" in self.roles:
            return any(_fits(topic.name, name) for name in self.roles["scan"].split(","))
        return topic.type in KEPT_TYPES


class LiveRecording(LiveScans):
    """Write all topics of a robot that a run needs to `NAME.mcap`, message by message.

    If the robot or the router disconnects, the recording waits and continues in the same file.

    While open, the file is `NAME.mcap.part`. A crash loses at most the open chunk (64 KiB), and `sensorgraph recover`
    saves the rest. After an exception, the data written so far are kept as `NAME.interrupted.mcap`.

    Parameters
    ----------
    topics : Role -> topic, for non-standard topic names. If scan topics are given, only those lasers are written.
    attachments : Name -> content of files to attach.
    """

    def __init__(
        self,
        path: Path,
        network: RosNetwork,
        *,
        topics: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        super().__init__(network, topics=topics, window=POSE_WINDOW)
        self.path, self.source = path, path.name
        self.notes: list[str] = []
        """Notes on omitted data, one line each."""
        self.outages: list[Outage] = []
        self.began: float | None = None
        """[s] time of the first message since the epoch."""
        self._looked = 0.0
        self._file = RosFile(path)
        try:
            for name, data in (attachments or {}).items():
                self._file.attach(name, data, time.time_ns())
        except BaseException:
            self._file.abandon()
            raise

    def wait_for_topics(self, patience: float | None = None) -> None:
        """Wait until a topic with readings and all selected topics are announced.

        Parameters
        ----------
        patience : [s] maximum time; None: from the settings

        Raises
        ------
        LogError
            If a topic is not announced in time; the message lists the announced topics.
        """
        until = time.monotonic() + (PATIENCE if patience is None else patience)
        while (missing := self._missing()) and time.monotonic() < until:
            self._take(self.network.next(until))
        if missing:
            known = sorted(self.network.topics.values(), key=lambda topic: topic.name)
            seen = ", ".join(f"{topic.name} ({topic.type})" for topic in known) or "no topic"
            raise LogError(
                f"{' and '.join(missing)} not published in domain {self.network.domain} at {self.network.router}; found: "
                f"{seen}; start the driver, select the topic (`topics` scan=/front/scan), or set `domain`"
            )

    def pump(self, duration: float) -> None:
        """Write the messages received within `duration` [s]."""
        until = time.monotonic() + duration
        while (now := time.monotonic()) < until:
            if now - self._looked > LOOK_EVERY:
                self._looked = now
                self._look_for_router()
            self._take(self.network.next(min(until, now + LOOK_EVERY)))

    def close(self) -> Path:
        """Write the queued messages, and give the file its final name.

        Raises
        ------
        LogError
            If no scan was received; the file is then removed.
        """
        self.network.close()
        while (item := self.network.next(0.0)) is not None:
            self._take(item)
        if self.n_scans == 0:
            self._file.abandon()
            names = ", ".join(name for name, rate in self.rates.items() if rate.n_messages) or "no topic"
            raise LogError(f"no scan was received, only messages of {names}; check that the laser is running")
        return self._file.finish()

    def __enter__(self) -> LiveRecording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if exc is None:
            self.close()
        elif self.n_scans == 0:
            self._file.abandon()
        else:
            self._file.finish(interrupted=True)

    def _look_for_router(self) -> None:
        """Record when the connection to the router is lost and restored."""
        is_away = bool(self.outages) and self.outages[-1].ended is None
        if self.network.is_connected:
            if is_away:
                self.outages[-1].ended = time.time()
        elif not is_away:
            self.outages.append(Outage(began=time.time()))

    def _missing(self) -> list[str]:
        topics = self.network.topics
        missing = [
            name
            for named in self.roles.values()
            for name in named.split(",")
            if not any(_fits(topic, name) for topic in topics)
        ]
        if not any(topic.type in (SCAN_TYPE, RANGE_TYPE) for topic in topics.values()):
            missing.append("a LaserScan or Range is")
        elif missing:
            missing[-1] += " is"
        return missing

    def _take(self, item: LiveMessage | PublishedTopic | None) -> None:
        """Subscribe to an announced topic, or write a received message."""
        if isinstance(item, PublishedTopic) and self._is_wanted(item):
            first = self.rates.setdefault(item.name, TopicRate(item.type)).type
            note = f"{item.name} is published as {first} and as {item.type}; only the first type is written"
            if first != item.type and note not in self.notes:
                self.notes.append(note)
        elif isinstance(item, LiveMessage):
            if self.began is None:
                self.began = item.received_ns / 1e9
            channel = self._file.channel(item.topic.name, item.topic.type)
            self._file.put(channel, item.received_ns, item.payload)
        super()._take(item)


def _fits(topic: str, pattern: str) -> bool:
    return fnmatchcase(topic, "/" + pattern.strip().lstrip("/"))
