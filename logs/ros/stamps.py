"""Bring the stamps of a recording to one clock, and drop messages that the file holds twice."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np

from logs.clocks import settle
from logs.ros import cdr
from logs.ros.poses import FIXED_FRAMES, MAP_FRAMES, base_of
from logs.ros.recording import SCAN_TYPE, TF_TYPE, Recording, Topic, logged_times
from logs.ros.transform_tree import Edge, TransformTree
from logs.sensor import median_step
from logs.signals import Signal
from logs.sweep import LIMITS
from logs.transforms import Stamps
from logs.types import Bools, Floats, Ints

_HEADER = struct.Struct("<iII")
HEADER = slice(4, 12)
"""Bytes of the first stamp of a message, after the encapsulation of ROS 2 or the number of the header of ROS 1."""


def without_repeats(recording: Recording, names: Iterable[str]) -> tuple[Recording, list[str]]:
    """Return the recording without messages of some topics that repeat an earlier one, stamp and content."""
    topics, notes = dict(recording.topics), []
    for name in dict.fromkeys(names):
        topic = topics[name]
        kept = _first_copies(topic)
        if kept.all():
            continue
        topics[name] = replace(
            topic,
            log_times=list(compress(topic.log_times, kept.tolist())),
            payloads=cdr.Messages(compress(topic.payloads, kept.tolist())),
        )
        n = int((~kept).sum())
        notes.append(f"{name}: {n} of {len(kept)} messages are there twice, the copies were dropped")
    return replace(recording, topics=topics), notes


def _first_copies(topic: Topic) -> Bools:
    """Return whether each message (n,) differs from all earlier ones with the same stamp."""
    kept = np.ones(len(topic.payloads), dtype=np.bool_)
    if not has_header(topic):
        return kept
    for index, rows in topic.payloads.by_size():
        if rows.shape[1] < HEADER.stop:
            continue
        _, which, counts = np.unique(
            np.ascontiguousarray(rows[:, HEADER]).view(np.uint64)[:, 0],
            return_inverse=True,
            return_counts=True,
        )
        seen = set[bytes]()
        for i in np.flatnonzero(counts[which] > 1).tolist():
            content = rows[i, HEADER.start :].tobytes()
            kept[index[i]] = content not in seen
            seen.add(content)
    return kept


def has_header(topic: Topic) -> bool:
    """Return whether the messages of a topic start with a stamp."""
    return starts_with_header(topic.type)


def starts_with_header(kind: str) -> bool:
    """Return whether messages of a type start with a stamp."""
    return cdr.fields_of(kind)[0][0] == "sec"


def settle_clocks(
    recording: Recording, names: Sequence[str], tree: TransformTree, near: str
) -> tuple[Recording, TransformTree, list[str]]:
    """Return the recording and the transforms with stamps of one clock, and notes on the differences of clocks.

    Parameters
    ----------
    names : topics that are used, the most important first
    near : topic of the sensor
    """
    signals: list[Signal] = []
    places: list[tuple[str, Ints]] = []
    sensor = ""
    for name in dict.fromkeys(names):
        for frame, signal, index in _signals(recording.topics[name]):
            signals.append(signal)
            places.append((name, index))
            sensor = frame if name == near else sensor
    edges = _moving_edges(tree, sensor)
    signals += [
        Signal(
            name=f"/tf {edge.parent} -> {edge.child}",
            stamps=edge.stamps,
            logged=edge.logged,
            is_correction=any(word in name for name in (edge.parent, edge.child) for word in MAP_FRAMES),
        )
        for edge in edges
    ]
    found = settle(signals)
    if not found.is_changed:
        return recording, tree, found.notes
    topics = dict(recording.topics)
    for (name, index), stamps in zip(places, found.stamps, strict=False):
        topic = topics[name]
        all_stamps = logged_times(topic) if topic.stamps is None else topic.stamps.copy()
        all_stamps[index] = stamps
        topics[name] = replace(topic, stamps=all_stamps)
    moved = {
        (edge.parent, edge.child): replace(edge, stamps=stamps)
        for edge, stamps in zip(edges, found.stamps[len(places) :], strict=True)
    }
    return replace(recording, topics=topics), TransformTree({**tree.edges, **moved}, tree.notes), found.notes


def _signals(topic: Topic) -> list[tuple[str, Signal, Ints]]:
    """Return the frame and the times of each sensor of a topic, and the indices of its messages; a frame is a sensor.

    A scan is stamped at its first ray and logged after its last one, so its log time is that of its first ray here.
    """
    stamps = logged_times(topic)
    logged = stamps.copy()
    durations = np.zeros(len(stamps))
    frames: dict[str, list[Ints]] = {}
    for block in topic.blocks():
        if has_header(topic):
            stamps[block.index] = block.stamps_ns
        if topic.type == SCAN_TYPE:
            durations[block.index] = block["limits"][:, 3] * (block.places["ranges"].count - 1)
        frames.setdefault(block.strings.get("frame_id", "").strip("/"), []).append(block.index)
    out = []
    for frame, parts in frames.items():
        index = np.sort(np.concatenate(parts))
        name = f"{topic.name} in {frame}" if len(frames) > 1 else topic.name
        signal = Signal(
            name=name,
            stamps=stamps[index],
            logged=logged[index] - _duration(durations[index], logged[index]),
            has_header=has_header(topic),
        )
        out.append((frame, signal, index))
    return out


def _duration(stated: Floats, logged: Stamps) -> int:
    """Return the duration [ns] of the scans by their time increments [s]; 0 if the log times contradict it."""
    period = median_step(logged, 0.0) / 1e9
    duration = float(np.median(np.abs(stated))) if len(stated) else 0.0
    return round(1e9 * duration) if duration <= LIMITS.max_periods * period else 0


def _moving_edges(tree: TransformTree, sensor: str) -> list[Edge]:
    """Return the edges between the fixed frames and a sensor, or the base, that change over time."""
    fixed = (frame for frame in tree.frames if any(word in frame for word in FIXED_FRAMES))
    ends = (sensor, base_of(tree, sensor, ()) or sensor)
    chains = (tree.path(frame, end) or [] for frame in fixed for end in ends)
    edges = {(edge.parent, edge.child): edge for chain in chains for edge, _ in chain}
    return [edge for edge in edges.values() if not edge.is_constant]


@dataclass
class StampCensus:
    """The times and frames of the messages of one topic, collected without keeping the messages."""

    type: str
    stamps: array[int] = field(default_factory=lambda: array("q"))
    """[ns] header stamps"""
    logged: array[int] = field(default_factory=lambda: array("q"))
    """[ns] log times"""
    frames: set[bytes] = field(default_factory=set)

    def add(self, logged: int, payload: bytes) -> None:
        """Count a message; one that is too short for a header is ignored, as it is refused later."""
        head = HEADER.start + (4 if self.type == TF_TYPE else 0)  # a transform stands after their number
        try:
            sec, nanosec, length = _HEADER.unpack_from(payload, head)
        except struct.error:
            return
        self.stamps.append(sec * 1_000_000_000 + nanosec)
        self.logged.append(logged)
        if self.type == SCAN_TYPE:
            self.frames.add(bytes(payload[head + _HEADER.size : head + _HEADER.size + length]))


def can_be_read_in_pieces(census: Mapping[str, StampCensus]) -> bool:
    """Return whether a log needs no knowledge of the whole for the times of its messages.

    Its header stamps agree with each other and overlap, no scan is there twice, and each scan topic has one frame.

    Parameters
    ----------
    census : topic -> its times
    """
    arrays = {
        name: (np.array(each.stamps, dtype=np.int64), np.array(each.logged, dtype=np.int64))
        for name, each in census.items()
    }
    scans = [name for name, each in census.items() if each.type == SCAN_TYPE]
    if any(len(census[name].frames) > 1 for name in scans):
        return False
    if any(len(np.unique(arrays[name][0])) < len(arrays[name][0]) for name in scans):
        return False
    ends = [(stamps.min(), stamps.max()) for stamps, _ in arrays.values() if len(stamps)]
    if max((first for first, _ in ends), default=0) > min((last for _, last in ends), default=0):
        return False
    signals = [
        Signal(name=name, stamps=stamps, logged=logged, is_correction=census[name].type == TF_TYPE)
        for name, (stamps, logged) in arrays.items()
    ]
    return not settle(signals).is_changed
