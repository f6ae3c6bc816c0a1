"""Sort the messages of a file into topics; MCAP files and ROS 1 bags are walked in the same way."""

from __future__ import annotations

import mmap
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from logs.mcap.records import Contents, Loss
from logs.mcap.walk import MessageSink
from logs.ros.cdr import Messages
from logs.ros.recording import ENCODINGS, KEPT_TYPES, Recording, Topic, full_type
from logs.types import Progress

MAPPED = 1 << 30
"""[bytes] larger files are memory-mapped."""


class Walk(Protocol):
    """One pass over the records of a file."""

    contents: Contents

    def steps(self) -> Iterator[int]:
        """Read to the end and yield the position after each step."""
        ...


WalkOf = Callable[[Any, MessageSink, Callable[[Loss], None]], Walk]
"""Start a walk: (bytes of the file, called with each message, called with each loss)."""


def open_bytes(path: Path) -> bytes | mmap.mmap:
    """Return the bytes of a file; a large file is memory-mapped and must not be truncated during reading."""
    with path.open("rb") as file:
        if path.stat().st_size < MAPPED:
            return file.read()
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def collect(
    data: bytes | mmap.mmap,
    walk_of: WalkOf,
    on_damage: Callable[[Loss], None],
    progress: Progress | None = None,
) -> tuple[Recording, Walk]:
    """Read a file and sort its messages by topic; only supported types are kept in memory."""
    recording = Recording(format="mcap")
    found: dict[int, tuple[Topic, bool]] = {}

    def take(channel: int, sequence: int, log_time: int, publish_time: int, payload: Any) -> None:
        if channel not in found:  # a channel may be described after its messages
            known = channel in contents.channels
            topic = topic_of(recording, contents, channel) if known else Topic("", "")
            found[channel] = topic, not known or is_kept(topic)
        topic, kept = found[channel]
        topic.add(log_time, payload if kept else None)

    walk = walk_of(data, take, on_damage)
    contents = (
        walk.contents
    )  # `take` must not refer to the walk: a reference cycle would keep the file in memory
    walked(walk, len(data), progress)
    unknown = sum(topic.n_messages for key, (topic, _) in found.items() if key not in contents.channels)
    if unknown:
        on_damage(Loss(len(data), len(data), f"{unknown} messages have an unknown channel"))
    ordered: dict[str, Topic] = {}
    for key in contents.channels:
        topic = topic_of(recording, contents, key)
        early = found.get(key, (topic, True))[0]
        if early is not topic:
            topic.take(early if is_kept(topic) else replace(early, payloads=Messages()))
        ordered |= {name: known for name, known in recording.topics.items() if known is topic}
    recording.topics = ordered
    describe(recording, contents)
    return recording, walk


def describe(recording: Recording, contents: Contents) -> None:
    """Take the metadata and the attachments of a file over."""
    for name, pairs in contents.metadata:
        recording.metadata.setdefault(name, {}).update(pairs)
    recording.attachments = {attachment.name: attachment.data for attachment in contents.attachments}


def walked(walk: Walk, size: int, progress: Progress | None) -> None:
    """Read a file of a size [bytes] to its end."""
    for done, pos in enumerate(walk.steps()):
        if progress is not None and done % 64 == 0:
            progress(pos, size)
    if progress is not None:
        progress(size, size)


def messages_of(path: Path, topic: str, *, walk_of: WalkOf) -> Iterator[tuple[int, bytes | memoryview]]:
    """Read a file again and yield log time [ns] and payload of each message of one topic."""
    queue: deque[tuple[int, bytes | memoryview]] = deque()

    def take(channel: int, sequence: int, log_time: int, publish_time: int, payload: Any) -> None:
        known = contents.channels.get(channel)
        if known is not None and known.topic == topic:
            queue.append((log_time, payload))

    walk = walk_of(open_bytes(path), take, lambda _: None)
    contents = walk.contents
    for _ in walk.steps():
        while queue:
            yield queue.popleft()


def topic_of(recording: Recording, contents: Contents, key: int) -> Topic:
    """Return the topic of a channel; channels of one name and of different types are different topics."""
    channel, kind = contents.channels[key], type_of(contents, key)
    topic = recording.topics.setdefault(channel.topic, Topic(channel.topic, kind, channel.message_encoding))
    if topic.type != kind or topic.encoding != channel.message_encoding:
        name = f"{channel.topic}#{key}"
        topic = recording.topics.setdefault(name, Topic(name, kind, channel.message_encoding))
    return topic


def type_of(contents: Contents, channel: int) -> str:
    """Return the full type name of a channel's messages."""
    schema = contents.schemas.get(contents.channels[channel].schema_id)
    return full_type(schema.name) if schema is not None else "without schema"


def is_kept(topic: Topic) -> bool:
    """Return whether the messages of a topic are kept in memory."""
    return topic.type in KEPT_TYPES and topic.encoding in ENCODINGS


def damage_text(path: Path, loss: Loss) -> str:
    """Describe the damage of a file and the command that recovers it."""
    return (
        f"{path} is damaged at byte {loss.start}: {loss.why}; "
        f"save the intact messages: sensorgraph recover {path} -o {recovered_name(path)}"
    )


def recovered_name(path: Path) -> str:
    """Suggest a name for the recovered file."""
    name = path.name
    for end in (".part", ".active", ".mcap", ".bag"):
        name = name.removesuffix(end)
    return str(path.with_name(f"{name}.recovered.mcap"))
