"""Parse the fields of MCAP records; `walk` iterates over the records."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from logs.inflation import TooLarge, unpack

if TYPE_CHECKING:
    from mmap import mmap

    Data = bytes | mmap

MAGIC = b"\x89MCAP0\r\n"
HEADER_RECORD, FOOTER, SCHEMA, CHANNEL_RECORD, MESSAGE, CHUNK_RECORD, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
U2, U4, U8 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
CHUNK_HEAD = struct.Struct("<QQQI")
SUMMARY_ONLY = frozenset({CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET, FOOTER})
FIXED_LENGTHS = {FOOTER: 20, DATA_END: 4, SUMMARY_OFFSET: 17}


class DamagedRecord(ValueError):
    """A record is damaged; the message states the reason."""


@dataclass(frozen=True)
class Schema:
    """The message definition of a channel."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    """One topic of the file."""

    topic: str
    schema_id: int
    encoding: str
    metadata: dict[str, str]


@dataclass(frozen=True)
class Attachment:
    """An attached file."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    data: bytes


@dataclass(frozen=True)
class Loss:
    """An unusable section of the file."""

    start: int
    end: int
    why: str


@dataclass
class Contents:
    """The contents of the file except its messages."""

    profile: str = ""
    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    n_chunks: int = 0
    bad_chunks: int = 0
    lost_messages: dict[int, int] = field(default_factory=dict)
    """Channel id -> number of messages in damaged chunks, according to their indexes."""
    n_messages: int = 0
    n_claimed: int | None = None
    """Number of messages according to the statistics of the file."""
    is_finished: bool = False
    """Whether the file ends with its footer and magic."""


class Cursor:
    """Read the fields of one record; a field beyond its end is damage."""

    def __init__(self, data: Data, pos: int, end: int) -> None:
        self.data, self.pos, self.end = data, pos, end

    def take(self, size: int) -> bytes:
        """Read `size` bytes."""
        if self.pos + size > self.end:
            raise DamagedRecord("a field runs past the end of its record")
        self.pos += size
        return self.data[self.pos - size : self.pos]

    def number(self, kind: struct.Struct) -> int:
        """Read one integer."""
        return int(kind.unpack(self.take(kind.size))[0])

    def text(self) -> str:
        """Read a length-prefixed UTF-8 text."""
        try:
            return self.take(self.number(U4)).decode()
        except UnicodeDecodeError as exc:
            raise DamagedRecord("a text field is not UTF-8") from exc

    def mapping(self) -> dict[str, str]:
        """Read a length-prefixed map of texts."""
        inner = Cursor(self.data, self.pos + 4, self.pos + 4 + self.number(U4))
        if inner.end > self.end:
            raise DamagedRecord("a map runs past the end of its record")
        pairs = {}
        while inner.pos < inner.end:
            key = inner.text()
            pairs[key] = inner.text()
        self.pos = inner.end
        return pairs

    def finish(self) -> None:
        """Check that the record has been read completely."""
        if self.pos != self.end:
            raise DamagedRecord(f"{self.end - self.pos} bytes are left over in a record")


def inflate(compression: str, data: bytes, most: int) -> bytes:
    """Decompress the available part of a chunk, at most `most` bytes."""
    if not compression:
        return data
    if compression not in ("zstd", "lz4"):
        raise DamagedRecord(f"compression {compression!r} is unknown; expected zstd, lz4 or none")
    try:
        return unpack(data, most)
    except TooLarge as exc:
        raise DamagedRecord(f"a chunk {exc}, more than it states or a file of this size can hold") from exc
    except ValueError as exc:
        raise DamagedRecord(f"a {compression} chunk cannot be decompressed") from exc


def chunk_fields(cursor: Cursor) -> tuple[int, int, str, bytes]:
    """Return the size and checksum of the content of a chunk, its compression, and its stored bytes."""
    _, _, size, crc = CHUNK_HEAD.unpack(cursor.take(CHUNK_HEAD.size))
    compression = cursor.text()
    data = cursor.take(cursor.number(U8))
    cursor.finish()
    return size, crc, compression, data


def read_attachment(cursor: Cursor) -> Attachment:
    """Read an attachment and verify its checksum."""
    start = cursor.pos
    log_time, create_time = cursor.number(U8), cursor.number(U8)
    name, media_type = cursor.text(), cursor.text()
    data = cursor.take(cursor.number(U8))
    computed = zlib.crc32(cursor.data[start : cursor.pos])
    crc = cursor.number(U4)
    cursor.finish()
    if crc and crc != computed:
        raise DamagedRecord("an attachment does not match its checksum")
    return Attachment(name, media_type, log_time, create_time, data)
