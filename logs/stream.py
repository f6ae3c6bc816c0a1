"""Read logs larger than memory in pieces: runs of several thousand scans with the poses around them.

`open_log(path)` reads the file once to validate it and to find its topics, and keeps no messages. `pieces` then reads
it again. An MCAP file with one laser is streamed. Other formats, and several sensors as one, form a single piece.
"""

from __future__ import annotations

import mmap
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from logs.errors import LogError
from logs.formats import format_of, read
from logs.formats.collecting import damage_text, describe, is_kept, type_of, walked
from logs.formats.mcap_file import messages
from logs.mcap.records import Contents, Loss
from logs.mcap.walk import MessageSink, RecordWalk
from logs.no_return import check_no_return
from logs.notes import notes_of
from logs.ros import interpret, own_record
from logs.ros.laser_scan import ShapeCensus, count_shape
from logs.ros.ray_stream import begin_elsewhere
from logs.ros.recording import (
    ENCODINGS,
    KEPT_TYPES,
    RANGE_TYPE,
    SCAN_TYPE,
    TF_TYPE,
    Recording,
    Topic,
    check_roles,
    choose,
    choose_scans,
)
from logs.ros.stamps import StampCensus, can_be_read_in_pieces, starts_with_header
from logs.run import Run
from logs.types import SCANS_AT_A_TIME, Mounts, Progress, ReadOptions

# only memory and speed depend on these, not the data
PIECE = SCANS_AT_A_TIME
"""Number of scans in a piece."""
AHEAD = 64
"""Number of scans read beyond a piece, so that the poses after its last scan are available."""
MARGIN_NS = 5_000_000_000
"""[ns] of log time before a piece for which other messages are kept."""
FIRST_MESSAGES = 500
"""Number of messages per topic that the first pass keeps to assign roles to topics ..."""
SAMPLE_EVERY = 47
"""... and of /tf every n-th later one, which shows what moves; a prime, as transforms take turns."""


class LogStream(Protocol):
    """A recording that is read in pieces."""

    @property
    def head(self) -> Run:
        """A run with the sensor, the frame and the meta of the log; it may hold only some of the scans."""
        ...

    @property
    def n_scans(self) -> int:
        """Number of scans in the log."""
        ...

    def pieces(self) -> Iterator[Run]:
        """Yield runs of consecutive scans, each with the surrounding poses."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeRun:
    """A run in memory as a log with one piece."""

    head: Run

    @property
    def n_scans(self) -> int:
        return self.head.n_scans

    def pieces(self) -> Iterator[Run]:
        yield self.head


@np.errstate(all="ignore")
def open_log(
    path: Path | str,
    *,
    topics: Mapping[str, str] | None = None,
    no_return: str | None = None,
    mounts: Mounts | None = None,
    slice: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> McapStream | WholeRun:
    """Open a log and validate the whole file first, so that a damaged file is rejected at once.

    The options are those of `read`.

    Raises
    ------
    LogError
        If the format is unknown, the file is damaged, or it holds no scans.
    """
    path = Path(path)
    check_roles(topics)
    check_no_return(no_return)
    if slice is None and format_of(path) == "mcap" and path.stat().st_size > 0:
        stream = McapStream.open(path, ReadOptions(topics, progress, no_return, mounts))
        sensor = None if stream is None else stream.head.sensor
        if (
            stream is not None
            and stream.is_plain
            and sensor
            and not (sensor.is_composite or sensor.cones.any())
        ):
            return stream
    run = read(path, topics=topics, no_return=no_return, mounts=mounts, slice=slice, progress=progress)
    return WholeRun(head=run)


@dataclass(frozen=True, kw_only=True, eq=False)
class McapStream:
    """An MCAP file, mapped into memory; one piece at a time is decoded."""

    path: Path
    head: Run
    n_scans: int
    scan_topic: str
    how: ReadOptions
    """The options; `no_return` is that of the first messages if it is not selected, and None for our own file."""
    census: Mapping[str, ShapeCensus]
    """Topic -> number of scans of each shape."""
    is_plain: bool
    """Whether each piece can be interpreted without the others."""
    _contents: Contents = field(repr=False)

    @classmethod
    def open(cls, path: Path, how: ReadOptions) -> McapStream | None:
        """Validate every record, count the scans, and assign roles to topics from the first messages.

        None: the scans are not LaserScan messages of regular bearings, so that the log is read as a whole.
        """
        counts: dict[int, int] = {}
        look: dict[int, Topic] = {}
        shapes: dict[int, ShapeCensus] = {}
        times: dict[int, StampCensus] = {}
        unused: set[int] = set()

        def keep(
            contents: Contents, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes
        ) -> None:
            counts[channel] = counts.get(channel, 0) + 1
            is_new = counts[channel] == 1 and channel in contents.channels
            if is_new and type_of(contents, channel) not in KEPT_TYPES:
                unused.add(channel)
            if channel in unused:  # the first messages of a point cloud would fill the memory
                return
            if is_new and type_of(contents, channel) == SCAN_TYPE:
                shapes[channel] = ShapeCensus()
            if is_new and (census := _stamp_census(contents, channel)) is not None:
                times[channel] = census
            if channel in times:
                times[channel].add(log_time, payload)
            encoding = contents.channels[channel].message_encoding if channel in shapes else ""
            if channel in shapes:
                count_shape(shapes[channel], payload, encoding)
            is_sample = counts[channel] % SAMPLE_EVERY == 0 and _is_moving_transform(contents, channel)
            if counts[channel] <= FIRST_MESSAGES or is_sample:
                look.setdefault(channel, Topic("", "")).add(log_time, payload)

        def refuse(loss: Loss) -> None:
            raise LogError(damage_text(path, loss))

        topics = how.topics
        contents = _walk(path, keep, refuse, how.progress)
        recording = _skeleton(contents)
        for key, channel in contents.channels.items():
            topic = recording.topics[channel.topic]
            topic.n_messages += counts.get(key, 0)
            if key in look and is_kept(topic):
                topic.take(replace(look[key], n_messages=0))
        census = {contents.channels[key].topic: found for key, found in shapes.items()}
        is_own = own_record.is_own(recording, topics)
        is_plain = is_own or can_be_read_in_pieces({
            contents.channels[key].topic: found for key, found in times.items()
        })  # fmt: skip
        recording.again = partial(messages, path)
        names = [] if is_own else [each.topic for each in choose_scans(recording, path.name, topics)]
        if not all(_is_regular(recording.topics[name], census) for name in names):
            return None
        head = interpret.to_run(recording, path.name, how, census)
        if how.no_return is None and not is_own:
            how = how._replace(no_return=head.meta.get("no_return", "inf"))
        name = head.meta.get("scan_topic") or choose(recording, "scan", topics) or "/scan"
        name = name if name in recording.topics else "/scan"
        n_scans = recording.topics[name].n_messages if name in recording.topics else 0
        return cls(
            path=path,
            head=head,
            n_scans=n_scans,
            scan_topic=name,
            how=how._replace(progress=None),
            census=census,
            is_plain=is_plain,
            _contents=contents,
        )

    def pieces(self) -> Iterator[Run]:
        """Read the file again and yield runs of `PIECE` scans."""
        window = _Window(self._contents, self.scan_topic)
        for _ in _steps(self.path, window.keep):
            while window.n_scans >= PIECE + AHEAD:
                yield self._run(window.cut(PIECE))
        if window.n_scans:
            yield self._run(window.cut(window.n_scans))

    @np.errstate(all="ignore")
    def _run(self, recording: Recording) -> Run:
        """Interpret a piece; poses from another source than that of the log are dropped."""
        run = interpret.to_run(recording, self.path.name, self.how, self.census, self.head.meta)
        if run.meta.get("pose_source") != self.head.meta.get("pose_source"):
            run = replace(
                run,
                pose_stamps=np.zeros(0),
                poses=np.zeros((0, 3)),
                pose_covariances=np.zeros((0, 3, 3)),
                pose_frame=self.head.pose_frame,
            )
        notes = "; ".join(dict.fromkeys((*notes_of(self.head), *notes_of(run))))
        sensor = self.head.sensor  # its ray times may be those of a robot.yaml; then ray 0 has another time
        stamps = run.stamps + (sensor.ray_0_after_first - run.sensor.ray_0_after_first)
        meta = {**run.meta, **({"notes": notes} if notes else {})}
        return replace(run, sensor=sensor, stamps=stamps, meta=meta)


class _Window:
    """Messages of a section of the file: its scans, and the other messages from shortly before to shortly after."""

    def __init__(self, contents: Contents, scan_topic: str) -> None:
        self.contents = contents
        self.scans: deque[tuple[int, bytes]] = deque()
        self.others: deque[tuple[str, int, bytes]] = deque()
        self.fixed: list[tuple[str, int, bytes]] = []
        self.names: dict[int, str] = {}
        for key, channel in contents.channels.items():
            kind = type_of(contents, key)
            if (
                channel.message_encoding in ENCODINGS
                and kind in KEPT_TYPES
                and (kind not in (SCAN_TYPE, RANGE_TYPE) or channel.topic == scan_topic)
            ):
                self.names[key] = channel.topic
        self.scan_topic = scan_topic

    @property
    def n_scans(self) -> int:
        return len(self.scans)

    def keep(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: Any) -> None:
        """Keep a message if its topic is used."""
        name = self.names.get(channel)
        if name is None:
            return
        if name == self.scan_topic:
            self.scans.append((log_time, payload))
        elif name.rstrip("/").endswith("tf_static"):
            self.fixed.append((name, log_time, payload))
        else:
            self.others.append((name, log_time, payload))

    def cut(self, n: int) -> Recording:
        """Return the first n scans with all available messages, and drop those that no later scan needs."""
        recording = _skeleton(self.contents)
        taken = [self.scans.popleft() for _ in range(n)]
        while self.scans and self.scans[0][0] == taken[-1][0]:  # scans with one stamp are paired together
            taken.append(self.scans.popleft())
        scans = ((self.scan_topic, at, payload) for at, payload in taken)
        for name, at, payload in (*scans, *self.fixed, *self.others):
            recording.topics[name].add(at, payload)
        while self.others and self.others[0][1] < taken[-1][0] - MARGIN_NS:
            self.others.popleft()
        return recording


def _is_regular(topic: Topic, census: Mapping[str, ShapeCensus]) -> bool:
    """Return whether the scans of a topic are LaserScan messages that begin at one bearing and state sound angles."""
    if topic.type != SCAN_TYPE:
        return False
    return not (census[topic.name].is_doubtful or begin_elsewhere(census[topic.name]))


def _stamp_census(contents: Contents, channel: int) -> StampCensus | None:
    """Return an empty census for a channel whose messages have stamps that matter; None for another one."""
    kind = type_of(contents, channel)
    is_latched = contents.channels[channel].topic.rstrip("/").endswith("tf_static")
    if kind not in KEPT_TYPES or is_latched or not (kind == TF_TYPE or starts_with_header(kind)):
        return None
    return StampCensus(kind)


def _is_moving_transform(contents: Contents, channel: int) -> bool:
    """Return whether a channel holds transforms that may change."""
    known = contents.channels.get(channel)
    return (
        known is not None
        and type_of(contents, channel) == TF_TYPE
        and not known.topic.rstrip("/").endswith("tf_static")
    )


def _skeleton(contents: Contents) -> Recording:
    """Return a recording with the topics of a file but no messages."""
    recording = Recording(format="mcap")
    describe(recording, contents)
    for key, channel in contents.channels.items():
        kind = type_of(contents, key)
        recording.topics.setdefault(channel.topic, Topic(channel.topic, kind, channel.message_encoding))
    return recording


def _walk(
    path: Path,
    keep: Callable[[Contents, int, int, int, int, Any], None],
    on_damage: Callable[[Loss], None],
    progress: Progress | None,
) -> Contents:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        walk = RecordWalk(data, lambda *message: keep(walk.contents, *message), on_damage)
        walked(walk, len(data), progress)
        contents = walk.contents
        if contents.n_claimed is not None and contents.n_claimed != contents.n_messages:
            on_damage(
                Loss(
                    len(data),
                    len(data),
                    f"{contents.n_messages} messages, but its statistics state {contents.n_claimed}",
                )
            )
        return contents


def _steps(path: Path, keep: MessageSink) -> Iterator[int]:
    def changed(loss: Loss) -> None:
        raise LogError(f"{path} changed while it was read: {loss.why}; read it again when it is complete")

    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield from RecordWalk(data, keep, changed).steps()
