"""Save every complete message of a truncated or damaged MCAP file or ROS 1 bag, and list every loss; no message is guessed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from mmap import mmap
from pathlib import Path

from mcap.records import Channel

from logs.errors import LogError
from logs.files import atomic_file
from logs.formats import rosbag1
from logs.formats.bag_fields import check_bag
from logs.formats.bag_records import BagWalk
from logs.formats.collecting import WalkOf, open_bytes, walked
from logs.formats.mcap_file import CHUNK_SIZE
from logs.mcap.records import MAGIC, Contents, Loss
from logs.mcap.walk import RecordWalk
from logs.ros.cdr import MESSAGE_FIELDS
from logs.ros.definitions import QUALITY, definition, quality
from logs.ros.own_record import METADATA_NAME, is_intact
from logs.types import Progress
from logs.yaml_text import parse_yaml

POLICIES = ("history", "reliability", "durability")
"""Policies of a channel's quality of service that are a word or a small number."""
OTHER_FORMATS = (
    (
        b"SQLite format 3\x00",
        "a sqlite bag: save its intact messages with `sqlite3 {path} .recover | sqlite3 OUT.db3`",
    ),
    (b"\x1f\x8b", "a gzip file: save its intact first part with `zcat {path} > OUT.log`"),
)


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """The parts of a file that were saved, and those that were lost."""

    written: dict[str, int]
    """Topic -> number of messages saved."""
    lost: dict[str, int]
    """Topic -> number of messages known to be lost, from the indexes of damaged chunks."""
    n_claimed: int | None
    """Number of messages according to the statistics of the file; None if these are lost."""
    orphans: int
    """Number of messages that could not be saved because the file does not describe their channel."""
    losses: tuple[Loss, ...]
    """Unusable sections of the file, each with the reason."""
    n_chunks: int
    bad_chunks: int
    attachments: tuple[str, ...]
    metadata: tuple[str, ...]

    @property
    def is_whole(self) -> bool:
        """Return whether the file was intact."""
        return not self.losses and not self.orphans

    @property
    def bytes_lost(self) -> int:
        """Number of unusable bytes."""
        return sum(loss.end - loss.start for loss in self.losses)

    def lines(self) -> list[str]:
        """Return the result as lines of text."""
        out = [f"saved {sum(self.written.values()):,} messages"]
        out += [f"  {topic}: {count:,}" for topic, count in self.written.items()]
        if self.attachments:
            out.append(f"  attachments: {', '.join(self.attachments)}")
        if self.metadata:
            out.append(f"  metadata: {', '.join(self.metadata)}")
        if self.is_whole:
            return [*out, "lost nothing: the file was intact"]
        out.append(f"lost {self.bytes_lost:,} bytes, {self.bad_chunks} of {self.n_chunks} chunks damaged")
        n_saved = sum(self.written.values())
        if self.n_claimed is not None and self.n_claimed > n_saved:
            out.append(
                f"  {self.n_claimed - n_saved:,} of {self.n_claimed:,} messages, according to the file"
            )
        out += [f"  {topic}: {count:,} messages" for topic, count in self.lost.items()]
        if self.orphans:
            out.append(f"  {self.orphans:,} messages whose channel description is lost")
        return out + [f"  bytes {loss.start:,} to {loss.end:,}: {loss.why}" for loss in self.losses]


def recover(path: Path | str, out: Path | str, *, progress: Progress | None = None) -> Recovery:
    """Write every complete message of a damaged MCAP file or ROS 1 bag to the MCAP file `out`.

    Attachments and metadata are kept. The messages of a ROS 1 bag keep their encoding (profile `ros1`).

    Chunks that do not match their checksum are skipped. After damaged framing, reading resumes at the next plausible
    record. The complete records at the start of a truncated last chunk are kept.

    Raises
    ------
    LogError
        If the file is of another format, contains nothing intact, or `out` is a folder or the damaged file itself.
    """
    path, out = Path(path), Path(out)
    walk_of = _check(path, out)
    data = open_bytes(path)
    known = _read_contents(data, walk_of)
    losses: list[Loss] = []
    if any(name == METADATA_NAME and not is_intact(said) for name, said in known.metadata):
        known.metadata = [(name, said) for name, said in known.metadata if name != METADATA_NAME]
        losses.append(
            Loss(
                0,
                0,
                f"the metadata record `{METADATA_NAME}` has changed and was left out, so the file reads as a foreign log",
            )
        )
    if not (known.n_messages or known.attachments or known.metadata):
        raise LogError(f"{path} has no intact message, attachment or metadata; nothing can be recovered")
    with (
        atomic_file(out) as part,
        part.open("wb") as stream,
    ):  # a unique name, because NAME.part may be the damaged file
        copy = _RecoveredFile(stream, known)
        walk = walk_of(data, copy.take, lambda loss: _add(losses, loss))
        walked(walk, len(data), progress)
        copy.finish()
    topics = {key: channel.topic for key, channel in known.channels.items()}
    lost: dict[str, int] = {}
    for key, count in walk.contents.lost_messages.items():
        topic = topics.get(key, f"channel {key}")
        lost[topic] = lost.get(topic, 0) + count
    return Recovery(
        written=copy.written,
        lost=lost,
        n_claimed=walk.contents.n_claimed,
        orphans=copy.orphans,
        losses=tuple(losses),
        n_chunks=known.n_chunks,
        bad_chunks=known.bad_chunks,
        attachments=tuple(attachment.name for attachment in known.attachments),
        metadata=tuple(name for name, _ in known.metadata),
    )


def _add(losses: list[Loss], loss: Loss) -> None:
    """Add a loss; merge it with the previous one if they are adjacent."""
    if losses and losses[-1].end == loss.start < loss.end:
        losses[-1] = replace(losses[-1], end=loss.end)
    else:
        losses.append(loss)


def _read_contents(data: bytes | mmap, walk_of: WalkOf) -> Contents:
    """Read everything except the messages first, because a channel may be described after its messages.

    Header and definitions have no checksum. In a damaged file, known definitions are restored.
    """
    losses: list[Loss] = []
    walk = walk_of(data, lambda *_: None, losses.append)
    for _ in walk.steps():
        pass
    known = walk.contents
    if losses:
        if any(channel.message_encoding == "cdr" for channel in known.channels.values()):
            known.profile = "ros2"
        for key, schema in known.schemas.items():
            if schema.name in MESSAGE_FIELDS and schema.encoding == "ros2msg":
                known.schemas[key] = replace(schema, data=definition(schema.name))
        for key, channel in known.channels.items():
            if not _is_quality(channel.metadata.get(QUALITY, "[]")):
                own = channel.metadata | {QUALITY: quality(channel.topic)}
                known.channels[key] = replace(channel, metadata=own)
    return known


def _is_quality(text: str) -> bool:
    """Return whether readers can parse the text as a list of quality-of-service profiles."""
    try:
        profiles = parse_yaml(text)
    except ValueError:
        return False
    return isinstance(profiles, list) and all(
        isinstance(one, dict)
        and all(isinstance(one.get(name), str) or one.get(name) in range(6) for name in POLICIES)
        for one in profiles
    )


def _check(path: Path, out: Path) -> WalkOf:
    """Return the walk for the format of the input; reject another format, and an output that is the input or a folder."""
    if out.is_dir():
        raise LogError(f"{out} is a folder; give the name of a file to write")
    if path.is_dir():
        inside = sorted([*path.glob("*.mcap"), *path.glob("*.bag*")])
        what = (
            f"recover its files one by one: {', '.join(map(str, inside[:3]))}"
            if inside
            else "it contains no .mcap or .bag file"
        )
        raise LogError(f"{path} is a folder; {what}")
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        raise LogError(f"{path} is empty; nothing can be recovered")
    for magic, what in OTHER_FORMATS:
        if head.startswith(magic):
            raise LogError(
                f"{path} is {what.format(path=path)}; recover reads only MCAP files and ROS 1 bags"
            )
    if out.exists() and out.samefile(path):
        raise LogError(f"{out} is the damaged file itself; give another output name")
    if head.startswith(rosbag1.MAGICS):
        check_bag(path, open_bytes(path))
        return BagWalk
    if path.name.removesuffix(".active").endswith(".bag"):
        return BagWalk
    looks_alike = sum(a == b for a, b in zip(head, MAGIC, strict=False)) >= 5
    if not looks_alike and not path.name.removesuffix(".part").endswith(".mcap"):
        raise LogError(
            f"{path} is no MCAP file and no ROS 1 bag (it starts with {head[:8]!r}); recover reads only these"
        )
    return RecordWalk


class _RecoveredFile:
    """The new file: definitions, metadata and attachments first, then the messages."""

    def __init__(self, stream: object, known: Contents) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream, chunk_size=CHUNK_SIZE, enable_data_crcs=True)  # type: ignore[arg-type]
        self._writer.start(profile=known.profile, library="sensorgraph recover")
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}
        self.written: dict[str, int] = {}
        self.orphans = 0
        schemas: dict[int, int] = {0: 0}
        for name, pairs in known.metadata:
            self._writer.add_metadata(name, pairs)
        for item in known.attachments:
            self._writer.add_attachment(
                item.create_time, item.log_time, item.name, item.media_type, item.data
            )
        for key, schema in known.schemas.items():
            schemas[key] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        for key, channel in known.channels.items():
            if channel.schema_id in schemas:
                self._register(key, channel, schemas[channel.schema_id])

    def _register(self, key: int, channel: Channel, schema: int) -> None:
        made = self._writer.register_channel(
            channel.topic, channel.message_encoding, schema, channel.metadata
        )
        self._channels[key], self._topics[made] = made, channel.topic
        self.written.setdefault(channel.topic, 0)

    def take(
        self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes | memoryview
    ) -> None:
        """Copy one message."""
        made = self._channels.get(channel)
        if made is None:
            self.orphans += 1
            return
        self._writer.add_message(made, log_time, bytes(payload), publish_time, sequence)
        self.written[self._topics[made]] += 1

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
