"""MCAP records: walk a file byte by byte, check every checksum, and find the way again after damage.

What the messages mean is said in `ros_run`; what is written is said in `mcap_file`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mmap import mmap

    Data = bytes | mmap

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_U2, _U4, _U8 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_CHUNK = struct.Struct("<QQQI")
_CHANNEL = struct.Struct("<HH")
_LENGTHS = {FOOTER: 20, DATA_END: 4, SUMMARY_OFFSET: 17}
_BLOCK = 1 << 20


class Damaged(ValueError):
    """Say why a record cannot be trusted."""


@dataclass(frozen=True)
class Schema:
    """What the messages of a channel look like."""

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
    """A file inside the file."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    data: bytes


@dataclass(frozen=True)
class Loss:
    """A stretch of the file that says nothing."""

    start: int
    end: int
    why: str


MessageSink = Callable[[int, int, int, int, bytes], None]
"""Called with (channel id, sequence, log time [ns], publish time [ns], payload)."""
DamageSink = Callable[[Loss], None]


@dataclass
class Contents:
    """Everything in the file but its messages."""

    profile: str = ""
    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    n_chunks: int = 0
    bad_chunks: int = 0
    lost_messages: dict[int, int] = field(default_factory=dict)
    """Channel id -> count of messages in chunks that could not be trusted, as their indexes tell."""
    n_messages: int = 0
    n_claimed: int | None = None
    """Count of messages that the file's own statistics claim."""
    is_finished: bool = False
    """The file ends with its footer and magic."""


class _Cursor:
    """Read fields of one record; running past its end is damage."""

    def __init__(self, data: Data, pos: int, end: int) -> None:
        self.data, self.pos, self.end = data, pos, end

    def take(self, size: int) -> bytes:
        if self.pos + size > self.end:
            raise Damaged("a field runs past the end of its record")
        self.pos += size
        return self.data[self.pos - size : self.pos]

    def number(self, kind: struct.Struct) -> int:
        return int(kind.unpack(self.take(kind.size))[0])

    def text(self) -> str:
        try:
            return self.take(self.number(_U4)).decode()
        except UnicodeDecodeError as exc:
            raise Damaged("a text field is not UTF-8") from exc

    def mapping(self) -> dict[str, str]:
        inner = _Cursor(self.data, self.pos + 4, self.pos + 4 + self.number(_U4))
        if inner.end > self.end:
            raise Damaged("a map runs past the end of its record")
        pairs = {}
        while inner.pos < inner.end:
            key = inner.text()
            pairs[key] = inner.text()
        self.pos = inner.end
        return pairs

    def finish(self) -> None:
        if self.pos != self.end:
            raise Damaged(f"{self.end - self.pos} bytes are left over in a record")


def inflate(compression: str, data: bytes) -> bytes:
    """Decompress as much of a chunk as is there."""
    try:
        if compression == "zstd":
            import zstandard

            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        if compression == "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))
    except Exception as exc:  # each library has its own error, and they have no common root
        raise Damaged(f"a {compression} chunk does not decompress") from exc
    if compression:
        raise Damaged(f"compression {compression!r} is not known; expected zstd, lz4 or none")
    return data


class Walk:
    """Walk the records of an MCAP file once."""

    def __init__(self, data: Data, on_message: MessageSink, on_damage: DamageSink) -> None:
        self.data, self.size = data, len(data)
        self.on_message, self._on_damage = on_message, on_damage
        self.contents = Contents()
        self._pos = 0
        self._is_whole = True
        self._after_bad_chunk = False
        self._has_chunks = True
        self._in_summary = False

    def steps(self) -> Iterator[int]:
        """Walk to the end, yielding the position after each record."""
        if self.data[:8] != MAGIC:
            self._damage(Loss(0, 8, "it does not start with the MCAP magic"))
        self._pos = 8
        while self._pos < self.size:
            if self.contents.is_finished:  # only the magic is left, as the footer's check has seen
                if self._pos + 8 == self.size:
                    return
                self._damage(Loss(self._pos, self.size, "bytes follow the end of the file"))
                return
            self._step()
            yield self._pos
        if not self.contents.is_finished:
            self._damage(Loss(self.size, self.size, "it ends without its footer: the writer was cut off"))

    def _damage(self, loss: Loss) -> None:
        self._is_whole = False
        self._on_damage(loss)

    def _step(self) -> None:
        start = self._pos
        try:
            opcode, body, end = self._frame(start)
        except Damaged as exc:
            if self._salvage_open_chunk(start):
                self._pos = self.size
                self._damage(Loss(start, self.size, f"{exc}; what is whole at its start was kept"))
            else:
                self._resume(start, str(exc))
            return
        try:
            self._record(opcode, body, end)
            self._pos = end
        except _BadChunk as exc:  # the framing holds, so the next record is where it should be
            self.contents.bad_chunks += 1
            self._after_bad_chunk = True
            self._damage(Loss(start, end, str(exc)))
            self._pos = end
        except Damaged as exc:
            self._resume(start, str(exc))

    def _resume(self, start: int, why: str) -> None:
        self._pos = self._resync(start + 1)
        self._damage(Loss(start, self._pos, why))

    def _frame(self, pos: int) -> tuple[int, int, int]:
        """Return opcode, start and end of the record at pos, if it can be one."""
        if pos + 9 > self.size:
            raise Damaged("it is cut inside a record")
        opcode, length = _HEAD.unpack_from(self.data, pos)
        end = pos + 9 + length
        if not 1 <= opcode <= DATA_END and opcode < 0x80:
            raise Damaged(f"no record starts here (opcode {opcode:#04x})")
        if end > self.size:
            raise Damaged(f"a record of {length} bytes runs past the end of the file")
        if _LENGTHS.get(opcode, length) != length:
            raise Damaged(f"a record with opcode {opcode:#04x} has {length} bytes")
        return opcode, pos + 9, end

    def _record(self, opcode: int, body: int, end: int) -> None:
        cursor = _Cursor(self.data, body, end)
        contents = self.contents
        if opcode == CHUNK:
            self._chunk(cursor)
        elif opcode in (SCHEMA, CHANNEL, MESSAGE):
            self._has_chunks &= self._in_summary
            self._content(opcode, self.data, body, end)
        elif opcode == MESSAGE_INDEX:
            self._message_index(cursor)
        elif opcode == HEADER:
            contents.profile, contents.library = cursor.text(), cursor.text()
        elif opcode == ATTACHMENT:
            contents.attachments.append(_attachment(cursor))
        elif opcode == METADATA:
            name = cursor.text()
            pairs = cursor.mapping()
            cursor.finish()
            contents.metadata.append((name, pairs))
        elif opcode == STATISTICS:
            contents.n_claimed = cursor.number(_U8)
        elif opcode == DATA_END:
            crc = cursor.number(_U4)
            if crc and self._is_whole and crc != self._crc32(0, body - 9):
                raise Damaged("the data section does not match its checksum")
            self._in_summary = True
        elif opcode == FOOTER:
            self._footer(cursor, body)
        if opcode != MESSAGE_INDEX:
            self._after_bad_chunk = False

    def _footer(self, cursor: _Cursor, body: int) -> None:
        summary_start, _, crc = cursor.number(_U8), cursor.number(_U8), cursor.number(_U4)
        start = summary_start or body - 9
        if crc and self._is_whole and crc != self._crc32(start, body + 16):
            raise Damaged("the summary does not match its checksum")
        if self.data[cursor.end : cursor.end + 8] != MAGIC:
            raise Damaged("the file does not end with the MCAP magic")
        self.contents.is_finished = True

    def _crc32(self, start: int, end: int) -> int:
        with memoryview(self.data) as view, view[start:end] as part:
            return zlib.crc32(part)

    def _message_index(self, cursor: _Cursor) -> None:
        channel = cursor.number(_U2)
        size = cursor.number(_U4)
        if size % 16 or size != cursor.end - cursor.pos:
            raise Damaged("an index record has a wrong size")
        if self._after_bad_chunk:
            lost = self.contents.lost_messages
            lost[channel] = lost.get(channel, 0) + size // 16

    def _chunk(self, cursor: _Cursor) -> None:
        size, crc, compression, data = _chunk_fields(cursor)
        self.contents.n_chunks += 1
        try:
            plain = inflate(compression, data)
            if len(plain) != size:
                raise Damaged(f"a chunk holds {len(plain)} bytes, expected {size}")
            if crc and crc != zlib.crc32(plain):
                raise Damaged("a chunk does not match its checksum")
        except Damaged as exc:
            raise _BadChunk(str(exc)) from exc
        self._chunk_content(plain, complete=True)

    def _chunk_content(self, plain: bytes, *, complete: bool) -> None:
        pos, size = 0, len(plain)
        while pos < size:
            end = pos + 9
            if end <= size:
                opcode, length = _HEAD.unpack_from(plain, pos)
                end += length
            if end > size:
                if complete:
                    raise _BadChunk("a record runs past the end of its chunk")
                return
            try:
                self._content(opcode, plain, pos + 9, end)
            except Damaged as exc:
                raise _BadChunk(str(exc)) from exc
            pos = end

    def _content(self, opcode: int, data: Data, body: int, end: int) -> None:
        """Take a record that may stand inside a chunk."""
        if opcode == MESSAGE:
            if end - body < _MESSAGE.size:
                raise Damaged(f"a message record has {end - body} bytes")
            self.contents.n_messages += 1
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, body)
            self.on_message(channel, sequence, log_time, publish_time, data[body + _MESSAGE.size : end])
            return
        cursor = _Cursor(data, body, end)
        if opcode == SCHEMA:
            key = cursor.number(_U2)
            schema = Schema(cursor.text(), cursor.text(), cursor.take(cursor.number(_U4)))
            cursor.finish()
            self.contents.schemas.setdefault(key, schema)
        elif opcode == CHANNEL:
            key, schema_id = cursor.number(_U2), cursor.number(_U2)
            channel = Channel(cursor.text(), schema_id, cursor.text(), cursor.mapping())
            cursor.finish()
            self.contents.channels.setdefault(key, channel)

    def _salvage_open_chunk(self, pos: int) -> bool:
        """Take what is whole in a chunk that the end of the file cuts; tell whether it is one."""
        if pos + 9 > self.size or self.data[pos] != CHUNK:
            return False
        cursor = _Cursor(self.data, pos + 9, self.size)
        try:
            cursor.take(_CHUNK.size)
            compression = cursor.text()
            stored = cursor.number(_U8)
            if stored <= self.size - cursor.pos:
                return False  # not cut: its length is wrong
            self._chunk_content(inflate(compression, self.data[cursor.pos : self.size]), complete=False)
        except Damaged:
            return True
        return True

    def _resync(self, pos: int) -> int:
        """Find the next place from pos on where a record stands that proves itself."""
        while pos + 9 <= self.size:
            block = np.frombuffer(self.data[pos : pos + _BLOCK + 8], dtype=np.uint8)
            n = len(block) - 8
            likely = (block[:n] >= 1) & (block[:n] <= DATA_END)
            for i in range(5, 9):  # no record is above 4 GiB
                likely &= block[i : n + i] == 0
            for offset in np.flatnonzero(likely).tolist():
                if self._proves_itself(pos + offset):
                    return pos + int(offset)
            pos += n
        return self.size

    def _proves_itself(self, pos: int, depth: int = 2) -> bool:
        """Tell whether the record at pos is whole and followed by such another."""
        try:
            opcode, body, end = self._frame(pos)
            cursor = _Cursor(self.data, body, end)
            if opcode == CHUNK:
                _chunk_fields(cursor)
                return True
            if opcode == ATTACHMENT:
                _attachment(cursor)
                return True
            if opcode == FOOTER:
                return self.data[end:] == MAGIC
            if opcode == MESSAGE:
                # in a chunk whose framing is lost, what looks like a message may be cut by compression
                if (
                    self._has_chunks
                    or end - body < _MESSAGE.size
                    or cursor.number(_U2) not in self.contents.channels
                ):
                    return False
            elif opcode == MESSAGE_INDEX and end - body != 6 + _U4.unpack_from(self.data, body + 2)[0]:
                return False
        except (Damaged, struct.error):
            return False
        return end == self.size or depth == 0 or self._proves_itself(end, depth - 1)


class _BadChunk(Damaged):
    """A chunk whose framing holds but whose content does not."""


def _chunk_fields(cursor: _Cursor) -> tuple[int, int, str, bytes]:
    _, _, size, crc = _CHUNK.unpack(cursor.take(_CHUNK.size))
    compression = cursor.text()
    data = cursor.take(cursor.number(_U8))
    cursor.finish()
    return size, crc, compression, data


def _attachment(cursor: _Cursor) -> Attachment:
    start = cursor.pos
    log_time, create_time = cursor.number(_U8), cursor.number(_U8)
    name, media_type = cursor.text(), cursor.text()
    data = cursor.take(cursor.number(_U8))
    computed = zlib.crc32(cursor.data[start : cursor.pos])
    crc = cursor.number(_U4)
    cursor.finish()
    if crc and crc != computed:
        raise Damaged("an attachment does not match its checksum")
    return Attachment(name, media_type, log_time, create_time, data)
