"""Save every complete message of a cut or damaged MCAP file; nothing is guessed, and every loss is listed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from mmap import mmap
from pathlib import Path

from logs.errors import LogError
from logs.files import atomic_file
from logs.formats.mcap_file import CHUNK_SIZE, open_bytes
from logs.mcap.records import MAGIC, Channel, Contents, Loss
from logs.mcap.walk import RecordWalk
from logs.ros.cdr import MESSAGE_FIELDS
from logs.ros.definitions import QUALITY, definition, quality
from logs.ros.own_record import METADATA_NAME, is_intact
from logs.types import Progress
from logs.yaml_text import parse_yaml

POLICIES = ("history", "reliability", "durability")
"""What a profile of a channel's quality of service says by a word or a small number."""
OTHER_FORMATS = (
    (
        b"SQLite format 3\x00",
        "a sqlite bag: save what is whole with `sqlite3 {path} .recover | sqlite3 OUT.db3`",
    ),
    (b"#ROSBAG V", "a ROS 1 bag: save what is whole with `rosbag reindex {path}`"),
    (b"\x1f\x8b", "a gzip file: keep its whole start with `zcat {path} > OUT.log`"),
)


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """What was saved of a file, and what was not."""

    written: dict[str, int]
    """Topic -> count of messages saved."""
    lost: dict[str, int]
    """Topic -> count of messages known to be lost: those that the indexes of damaged chunks count."""
    n_claimed: int | None
    """Count of messages that the file's own statistics claim, where they are left."""
    orphans: int
    """Count of messages whose channel is described nowhere in the file; they could not be saved."""
    losses: tuple[Loss, ...]
    """Stretches of the file that could not be used, with the reason."""
    n_chunks: int
    bad_chunks: int
    attachments: tuple[str, ...]
    metadata: tuple[str, ...]

    @property
    def is_whole(self) -> bool:
        """Tell whether nothing was wrong with the file."""
        return not self.losses and not self.orphans

    @property
    def bytes_lost(self) -> int:
        """Count of bytes that could not be used."""
        return sum(loss.end - loss.start for loss in self.losses)

    def lines(self) -> list[str]:
        """Return everything as text, one thing a line."""
        out = [f"saved {sum(self.written.values()):,} messages"]
        out += [f"  {topic}: {count:,}" for topic, count in self.written.items()]
        if self.attachments:
            out.append(f"  attachments: {', '.join(self.attachments)}")
        if self.metadata:
            out.append(f"  metadata: {', '.join(self.metadata)}")
        if self.is_whole:
            return [*out, "lost nothing: the file was whole"]
        out.append(f"lost {self.bytes_lost:,} bytes, {self.bad_chunks} of {self.n_chunks} chunks damaged")
        n_saved = sum(self.written.values())
        if self.n_claimed is not None and self.n_claimed > n_saved:
            out.append(f"  {self.n_claimed - n_saved:,} of {self.n_claimed:,} messages that the file had")
        out += [f"  {topic}: {count:,} messages" for topic, count in self.lost.items()]
        if self.orphans:
            out.append(f"  {self.orphans:,} messages of channels that the file no longer describes")
        return out + [f"  bytes {loss.start:,} to {loss.end:,}: {loss.why}" for loss in self.losses]


def recover(path: Path | str, out: Path | str, *, progress: Progress | None = None) -> Recovery:
    """Write every complete message of a damaged MCAP file to `out`, with its attachments and metadata.

    Chunks that do not match their checksum are left out; after damaged framing the next plausible record is
    searched. What stands whole at the start of a chunk that the end of the file cuts is kept.

    Raises
    ------
    LogError
        if the file is no MCAP, nothing in it is whole, or `out` is a folder or the damaged file itself
    """
    path, out = Path(path), Path(out)
    _check(path, out)
    data = open_bytes(path)
    known = _read_contents(data)
    losses: list[Loss] = []
    if any(name == METADATA_NAME and not is_intact(said) for name, said in known.metadata):
        known.metadata = [(name, said) for name, said in known.metadata if name != METADATA_NAME]
        losses.append(
            Loss(
                0,
                0,
                f"the metadata record `{METADATA_NAME}` has changed, left out: read it as a foreign file",
            )
        )
    if not (known.n_messages or known.attachments or known.metadata):
        raise LogError(f"{path} has no whole message, attachment or metadata left; there is nothing to save")
    with (
        atomic_file(out) as part,
        part.open("wb") as stream,
    ):  # NAME.part may be the very file that is to be saved
        copy = _RecoveredFile(stream, known)
        walk = RecordWalk(data, copy.take, lambda loss: _add(losses, loss))
        for step, pos in enumerate(walk.steps()):
            if progress is not None and step % 64 == 0:
                progress(pos, len(data))
        copy.finish()
    if progress is not None:
        progress(len(data), len(data))
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
    """Note a loss, as one with the loss before where they touch."""
    if losses and losses[-1].end == loss.start < loss.end:
        losses[-1] = replace(losses[-1], end=loss.end)
    else:
        losses.append(loss)


def _read_contents(data: bytes | mmap) -> Contents:
    """Read everything but the messages first: a channel may be described after its messages.

    Header and definitions carry no checksum of their own: in a damaged file they are restored where they are known.
    """
    losses: list[Loss] = []
    walk = RecordWalk(data, lambda *_: None, losses.append)
    for _ in walk.steps():
        pass
    known = walk.contents
    if losses:
        if any(channel.encoding == "cdr" for channel in known.channels.values()):
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
    """Tell whether readers can read it as the quality of service of a channel's publishers."""
    try:
        profiles = parse_yaml(text)
    except ValueError:
        return False
    return isinstance(profiles, list) and all(
        isinstance(one, dict)
        and all(isinstance(one.get(name), str) or one.get(name) in range(6) for name in POLICIES)
        for one in profiles
    )


def _check(path: Path, out: Path) -> None:
    """Refuse what is no MCAP file, and saving a file over itself or a folder."""
    if out.is_dir():
        raise LogError(f"{out} is a folder; give the name of a file to write")
    if path.is_dir():
        inside = sorted(path.glob("*.mcap"))
        what = (
            f"recover its files one by one: {', '.join(map(str, inside[:3]))}"
            if inside
            else "it has no .mcap"
        )
        raise LogError(f"{path} is a folder; {what}")
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        raise LogError(f"{path} is empty; there is nothing to save")
    for magic, what in OTHER_FORMATS:
        if head.startswith(magic):
            raise LogError(f"{path} is {what.format(path=path)}; recover is for MCAP")
    looks_alike = sum(a == b for a, b in zip(head, MAGIC, strict=False)) >= 5
    if not looks_alike and not path.name.removesuffix(".part").endswith(".mcap"):
        raise LogError(f"{path} is no MCAP file (it starts with {head[:8]!r}); recover is for MCAP")
    if out.exists() and out.samefile(path):
        raise LogError(f"{out} is the damaged file itself; give another name, it stays as it is")


class _RecoveredFile:
    """The new file: everything known first, then message after message."""

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
        made = self._writer.register_channel(channel.topic, channel.encoding, schema, channel.metadata)
        self._channels[key], self._topics[made] = made, channel.topic
        self.written.setdefault(channel.topic, 0)

    def take(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Copy one message."""
        made = self._channels.get(channel)
        if made is None:
            self.orphans += 1
            return
        self._writer.add_message(made, log_time, payload, publish_time, sequence)
        self.written[self._topics[made]] += 1

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
