"""Parse the records of MCAP files with the definitions of the package mcap, strictly; `walk` iterates over the records."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from logs.inflation import TooLarge, unpack

if TYPE_CHECKING:
    from mmap import mmap

    Data = bytes | mmap

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
U4 = struct.Struct("<I")
SUMMARY_ONLY = frozenset({
    Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.STATISTICS, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET, Opcode.FOOTER,
})  # fmt: skip
FIXED_LENGTHS = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}


class DamagedRecord(ValueError):
    """A record is damaged; the message states the reason."""


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


class Cursor(ReadDataStream):
    """Read the fields of one record; a field beyond its end is damage."""

    def __init__(self, data: Data, pos: int, end: int) -> None:
        super().__init__(BytesIO())
        self.data, self.pos, self.end = data, pos, end

    @property
    def count(self) -> int:
        """Position of the next field."""
        return self.pos

    def read(self, length: int) -> bytes:
        """Read `length` bytes."""
        if self.pos + length > self.end:
            raise DamagedRecord("a field runs past the end of its record")
        self.pos += length
        return self.data[self.pos - length : self.pos]


def parsed(kind: Any, data: Data, pos: int, end: int) -> Any:
    """Return the record of a class of `mcap.records` whose fields are between two positions.

    Raises
    ------
    DamagedRecord : A field runs past the end, bytes are left over, or a text is not UTF-8.
    """
    cursor = Cursor(data, pos, end)
    try:
        record = kind.read(cursor)
    except UnicodeDecodeError as exc:
        raise DamagedRecord("a text field is not UTF-8") from exc
    if cursor.pos != end:
        raise DamagedRecord(f"{end - cursor.pos} bytes are left over in a record")
    return record


def attachment(data: Data, pos: int, end: int) -> Attachment:
    """Read an attachment and verify its checksum."""
    found: Attachment = parsed(Attachment, data, pos, end)
    (crc,) = U4.unpack(data[end - 4 : end])
    if crc and crc != zlib.crc32(data[pos : end - 4]):
        raise DamagedRecord("an attachment does not match its checksum")
    return found


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
