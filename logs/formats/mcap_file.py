"""Convert runs to and from MCAP (profile ros2), with the topics, frames, order and times that ROS tools expect."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import BinaryIO
from uuid import uuid4

import numpy as np

from logs.errors import LogError
from logs.formats.collecting import collect, damage_text, messages_of, open_bytes, recovered_name
from logs.mcap.records import MAGIC, Loss
from logs.mcap.walk import RecordWalk
from logs.ros import cdr
from logs.ros.definitions import QUALITY, definition, quality
from logs.ros.interpret import to_run
from logs.ros.messages import (
    GRID_TYPE,
    command_messages,
    map_message,
    odometry_messages,
    pose_covariance_messages,
    pose_messages,
    scan_messages,
    to_ns,
    transform_messages,
    zero_time,
)
from logs.ros.own_record import METADATA_NAME, sensor_facts
from logs.ros.recording import (
    COVARIANCE_TOPIC,
    ODOMETRY_TYPE,
    POSE_COVARIANCE_TYPE,
    POSE_TYPE,
    SCAN_TYPE,
    TF_TYPE,
    TWIST_STAMPED_TYPE,
    Recording,
)
from logs.run import OccupancyMap, RangeSensor, Run, pair
from logs.transforms import Stamps, compose, interpolate, invert
from logs.types import Progress, ReadOptions

logger = logging.getLogger(__name__)


messages = partial(messages_of, walk_of=RecordWalk)
CHUNK_SIZE = (
    64 * 1024
)  # [bytes] maximum loss in a crash; 1 MiB would make files 7 % smaller (`python -m benchmarks.infrastructure mcap`)
MEDIA_TYPES = {
    ".geojson": "application/geo+json",
    ".json": "application/json",
    ".yaml": "application/yaml",
    ".csv": "text/csv",
    ".pgm": "image/x-portable-graymap",
    ".png": "image/png",
}


class RosFile:
    """An MCAP file being written to `NAME.part`, or to a unique name if that exists; renamed when complete."""

    def __init__(self, path: Path) -> None:
        from mcap.writer import Writer

        if path.is_dir():  # found now, and not when the drive is over
            raise IsADirectoryError(errno.EISDIR, "Is a directory", str(path))
        self.path = path
        self.part, self._stream = _open_part(path)
        self._writer = Writer(_Flushed(self._stream), chunk_size=CHUNK_SIZE, enable_data_crcs=True)  # type: ignore[arg-type]
        try:
            self._writer.start(profile="ros2", library="sensorgraph")
        except BaseException:
            self.abandon()
            raise
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[int, int] = {}

    def channel(self, topic: str, msgtype: str) -> int:
        """Return the channel of a topic; register it on first use."""
        if topic not in self._channels:
            if msgtype not in self._schemas:
                self._schemas[msgtype] = self._writer.register_schema(msgtype, "ros2msg", definition(msgtype))
            metadata = {QUALITY: quality(topic)}
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schemas[msgtype], metadata
            )
            self._counts[self._channels[topic]] = 0
        return self._channels[topic]

    def put(self, channel: int, ns: int, message: bytes) -> None:
        """Add one message with log and publish time `ns`."""
        sequence = self._counts[channel]
        self._counts[channel] = sequence + 1
        self._writer.add_message(channel, ns, message, ns, sequence)

    def describe(self, name: str, pairs: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(pairs))

    def attach(self, name: str, data: bytes, ns: int) -> None:
        """Add an attachment."""
        media_type = MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        self._writer.add_attachment(0, ns, name, media_type, data)

    def finish(self, *, interrupted: bool = False) -> Path:
        """Write the index and rename the file to its final name, or to `NAME.interrupted.mcap`.

        Raises
        ------
        OSError
            If the disk is full; the data written so far stay under the temporary name.
        """
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()
        kept = self.path.with_name(self.path.name.removesuffix(".mcap") + ".interrupted.mcap")
        return self.part.replace(kept if interrupted else self.path)

    def abandon(self) -> None:
        """Remove the incomplete file."""
        with suppress(OSError):  # a full disk was already reported to the caller
            self._stream.close()
        self.part.unlink(missing_ok=True)

    def __enter__(self) -> RosFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if exc is not None:
            self.abandon()
            return
        try:
            self.finish()
        except BaseException:
            self.abandon()
            raise


def _open_part(path: Path) -> tuple[Path, BinaryIO]:
    """Open a new temporary file; the file of another writer is not overwritten."""
    part = path.with_name(path.name + ".part")
    try:
        return part, part.open("xb")
    except FileExistsError:
        part = path.with_name(f"{path.name}.{uuid4().hex[:8]}.part")
        return part, part.open("xb")


class _Flushed:
    """A stream that flushes every write to the operating system, so that a killed process loses no data."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def write(self, data: bytes) -> int:
        count = self._stream.write(data)
        self._stream.flush()
        return count

    def tell(self) -> int:
        return self._stream.tell()


def latch(file: RosFile, ns: int, sensor: RangeSensor, occupancy: OccupancyMap | None) -> None:
    """Write the latched messages: the mount of the laser, and the map."""
    at = np.array([ns], dtype=np.int64)
    mount = transform_messages(at, ("base_link", "laser", sensor.mount[None]), z=sensor.height)
    file.put(file.channel("/tf_static", TF_TYPE), ns, mount.tobytes())
    if occupancy is not None:
        file.put(file.channel("/map", GRID_TYPE), ns, map_message(at, occupancy).tobytes())


def write(
    run: Run, path: Path | str, *, occupancy: OccupancyMap | None = None, progress: Progress | None = None
) -> None:
    """Write a run as MCAP; equal runs give equal bytes."""
    stamps = (run.stamps, run.pose_stamps, run.odom_stamps, run.cmd_stamps)
    first = min((float(part[0]) for part in stamps if len(part)), default=0.0)
    zero = zero_time(run.epoch_ns, first)
    start = zero + round(first * 1e9)
    if not run.sensor.is_evenly_spaced:
        logger.warning(
            "bearings are not evenly spaced: LaserScan messages contain the mean step, the metadata the exact bearings"
        )
    stated = sensor_facts(
        run.sensor, pose_frame=run.pose_frame, epoch_ns=run.epoch_ns, zero_ns=zero, meta=run.meta
    )
    with RosFile(Path(path)) as file:
        file.describe(METADATA_NAME, stated)
        for name, data in run.attachments.items():
            file.attach(name, data, start)
        latch(file, start, run.sensor, occupancy)
        parts = [part for part in _messages(run, zero) if len(part.ns)]
        _interleave(file, parts, progress)


@dataclass(frozen=True)
class _Part:
    """The messages of one topic with one layout."""

    topic: str
    msgtype: str
    ns: Stamps
    rows: cdr.Bytes


def _interleave(file: RosFile, parts: list[_Part], progress: Progress | None) -> None:
    """Write the messages of all parts in order of time; at equal times, in the order of the parts."""
    if not parts:
        return
    ns = np.concatenate([part.ns for part in parts])
    which = np.repeat(np.arange(len(parts)), [len(part.ns) for part in parts])
    row = np.concatenate([np.arange(len(part.ns)) for part in parts])
    order = np.lexsort((which, ns))
    channels = [file.channel(part.topic, part.msgtype) for part in parts]
    sizes, blobs = [part.rows.shape[1] for part in parts], [part.rows.tobytes() for part in parts]
    total = len(order)
    turns = zip(which[order].tolist(), row[order].tolist(), ns[order].tolist(), strict=True)
    for done, (k, i, at) in enumerate(turns):
        file.put(channels[k], at, blobs[k][i * sizes[k] : (i + 1) * sizes[k]])
        if progress is not None and done % 512 == 0:
            progress(done, total)
    if progress is not None:
        progress(total, total)


def _messages(run: Run, zero: int) -> Iterator[_Part]:
    """Yield the messages of each topic, in the order used at equal times."""
    ns = to_ns(run.stamps, zero)
    yield from _transforms(run, ns)
    at = to_ns(run.pose_stamps, zero)
    yield _Part("/pose", POSE_TYPE, at, pose_messages(at, run.poses))
    if len(run.pose_covariances):
        rows = pose_covariance_messages(at, run.poses, run.pose_covariances)
        yield _Part(COVARIANCE_TOPIC, POSE_COVARIANCE_TYPE, at, rows)
    at = to_ns(run.odom_stamps, zero)
    yield _Part("/odom", ODOMETRY_TYPE, at, odometry_messages(at, run.odometry, run.odom_twists))
    at = to_ns(run.cmd_stamps, zero)
    yield _Part("/cmd_vel", TWIST_STAMPED_TYPE, at, command_messages(at, run.commands))
    yield _Part("/scan", SCAN_TYPE, ns, scan_messages(run.sensor, ns, run.ranges, run.intensities))


def _transforms(run: Run, ns: Stamps) -> Iterator[_Part]:
    """Yield the transforms at every scan: map -> odom -> base_link, equal to the reference pose if there is one.

    Without odometry, the tree is map -> base_link. Poses of the laser are converted with the mount, so the tree is the
    same for all logs. /pose keeps the poses of the laser, and the metadata state their frame.
    """
    pairing = pair(run, whole_sweep=False)
    poses, paired = pairing.poses[pairing.paired], pairing.paired
    if run.pose_frame == "laser":
        poses = compose(poses, invert(run.sensor.mount))
    if len(run.odom_stamps) == 0:
        if paired.any():
            yield _Part(
                "/tf", TF_TYPE, ns[paired], transform_messages(ns[paired], ("map", "base_link", poses))
            )
        return
    driven = interpolate(run.stamps, run.odom_stamps, run.odometry)
    if paired.any():
        T_map_odom = compose(poses, invert(driven[paired]))
        both = (("map", "odom", T_map_odom), ("odom", "base_link", driven[paired]))
        yield _Part("/tf", TF_TYPE, ns[paired], transform_messages(ns[paired], *both))
    if not paired.all():
        alone = ("odom", "base_link", driven[~paired])
        yield _Part("/tf", TF_TYPE, ns[~paired], transform_messages(ns[~paired], alone))


def matches(path: Path, head: bytes) -> bool:
    """Return whether a file is MCAP."""
    return head.startswith(MAGIC)


def read(path: Path, how: ReadOptions) -> Run:
    """Read a run from MCAP; a damaged file is rejected and not read partially.

    Raises
    ------
    LogError
        If a checksum fails, the file is truncated, or it holds no scans.
    """
    return to_run(load(path, how.progress), path.name, how)


def load(path: Path, progress: Progress | None = None) -> Recording:
    """Read the messages of an MCAP file and verify every checksum."""

    def refuse(loss: Loss) -> None:
        raise LogError(damage_text(path, loss))

    recording, walk = collect(open_bytes(path), RecordWalk, refuse, progress)
    contents = walk.contents
    if contents.n_claimed is not None and contents.n_claimed != contents.n_messages:
        raise LogError(
            f"{path} holds {contents.n_messages} messages, but its statistics state {contents.n_claimed}; "
            f"save the intact messages: sensorgraph recover {path} -o {recovered_name(path)}"
        )
    recording.again = partial(messages, path)
    return recording
