"""The statements as ROS messages: a DiagnosticArray for /diagnostics, markers with the outlines, and the tracked pose."""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType

import numpy as np

from logs.formats.mcap_file import RosFile
from logs.ros.diagnostics import (
    DIAGNOSTICS_TYPE,
    ERROR,
    MARKERS_TYPE,
    OK,
    WARN,
    DiagnosticStatement,
    OutlineMarker,
    diagnostic_message,
    marker_message,
)
from logs.ros.messages import pose_messages
from logs.ros.recording import POSE_TYPE
from sensorgraph.watching.policy import WatchPolicy
from sensorgraph.watching.status import WatchStatus

DIAGNOSTICS_TOPIC, MARKERS_TOPIC, POSE_TOPIC = "/diagnostics", "/watch/changes", "/watch/pose"
logger = logging.getLogger(__name__)
COLOURS = {"new": (0.82, 0.2, 0.36), "gone": (0.16, 0.36, 0.82), "moved": (0.55, 0.28, 0.6)}
LEVEL_OF_POSE = {"ok": OK, "ambiguous": WARN, "off": ERROR, "lost": ERROR}


def statements_of(status: WatchStatus, policy: WatchPolicy) -> list[DiagnosticStatement]:
    """Return the three statements, each with its level and numbers."""
    texts = [text.partition(" ")[2] for text in status.sentences()]
    pose, share = status.pose, status.share_predicted
    worst = {"ok": OK, "warning": WARN, "error": ERROR}[policy.level(status)[0]]
    few = share is not None and share < policy.share_predicted["warning"]
    place = WARN if few or status.n_changes > policy.n_changes else OK
    values = (
        {
            "status": pose.status, "p": f"{pose.p:.4f}", "p_wrong": f"{pose.p_wrong:.4f}", "since": f"{pose.since:.1f}",
            "offset_m": f"{pose.offset[0]:.3f}", "offset_rad": f"{pose.offset[1]:.4f}", "known_place": str(pose.is_known_place).lower(),
        },
        {
            "share_predicted": "" if share is None else f"{share:.4f}",
            "new": str(sum(change.kind == "new" for change in status.changes)),
            "gone": str(sum(change.kind == "gone" for change in status.changes)),
            "moved": str(len(status.moved)),
        },
        {doubt.name: f"{doubt.p:.4f}" for doubt in status.doubts},
    )  # fmt: skip
    levels = LEVEL_OF_POSE[pose.status], place, min(worst, ERROR) if status.faults else OK
    names = ("sensorgraph: pose", "sensorgraph: place", "sensorgraph: robot")
    return [
        DiagnosticStatement(level=level, name=name, message=text, hardware_id="sensorgraph", values=pairs)
        for level, name, text, pairs in zip(levels, names, texts, values, strict=True)
    ]


def outlines_of(status: WatchStatus) -> list[OutlineMarker]:
    """Return the outlines of all changes, and a line from where each thing that moved was to where it is."""
    ways = [
        OutlineMarker(
            namespace="moved", points=np.array([thing.gone.centre, thing.new.centre]), colour=COLOURS["moved"]
        )
        for thing in status.moved
    ]
    return ways + [
        OutlineMarker(namespace=change.kind, points=line, colour=COLOURS[change.kind])
        for change in status.changes
        for line in change.outlines
    ]


class WatchFile:
    """Write statements to an MCAP file during the run; after an exception, the file is `NAME.interrupted.mcap`.

    The file is opened with the first statement.
    """

    def __init__(self, path: Path, epoch_ns: int) -> None:
        self.path, self.epoch_ns = path, epoch_ns
        self._file: RosFile | None = None
        self._n_outlines = -1

    def add(self, status: WatchStatus, policy: WatchPolicy) -> None:
        """Write one status."""
        ns = max(self.epoch_ns + round(status.t * 1e9), 0)
        self._put(
            DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, ns, diagnostic_message(ns, statements_of(status, policy))
        )
        outlines = outlines_of(status)
        if outlines or self._n_outlines:
            self._put(MARKERS_TOPIC, MARKERS_TYPE, ns, marker_message(ns, outlines))
        self._n_outlines = len(outlines)
        if status.pose.pose is not None:
            message = pose_messages(np.array([ns], dtype=np.int64), status.pose.pose[None])
            self._put(POSE_TOPIC, POSE_TYPE, ns, message.tobytes())

    def __enter__(self) -> WatchFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            kept = self._file.finish(interrupted=exc is not None)
            if exc is not None:
                logger.warning("watching was interrupted; the statements so far are in %s", kept)

    def _put(self, topic: str, msgtype: str, ns: int, message: bytes) -> None:
        if self._file is None:
            self._file = RosFile(self.path)
        self._file.put(self._file.channel(topic, msgtype), ns, message)
