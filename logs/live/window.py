"""The latest messages of a running robot, interpreted as a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from logs.errors import LogError
from logs.live.network import LiveMessage
from logs.ros.interpret import to_run
from logs.ros.recording import TF_TYPE, Recording, Topic
from logs.run import Run
from logs.types import ReadOptions


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
