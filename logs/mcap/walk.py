"""Read an MCAP file record by record, verify every checksum, and find the next intact record after damage.

`ros.interpret` interprets the messages; `formats.mcap_file` reads and writes whole files.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from mcap import records
from mcap.opcode import Opcode

from logs.inflation import most_plain
from logs.mcap.records import (
    FIXED_LENGTHS,
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    SUMMARY_ONLY,
    U4,
    Contents,
    Cursor,
    DamagedRecord,
    Loss,
    attachment,
    inflate,
    parsed,
)

if TYPE_CHECKING:
    from logs.mcap.records import Data

SEARCH_BLOCK = 1 << 20  # [bytes] searched at a time
MESSAGE = int(Opcode.MESSAGE)  # compared with every record
CHUNK_HEAD_SIZE = 28  # [bytes] times, size and checksum of the content


MessageSink = Callable[[int, int, int, int, bytes | memoryview], None]
"""Called with (channel id, sequence, log time [ns], publish time [ns], payload)."""


DamageSink = Callable[[Loss], None]


class RecordWalk:
    """Iterate over the records of an MCAP file once."""

    def __init__(self, data: Data, on_message: MessageSink, on_damage: DamageSink) -> None:
        self.data, self.size = data, len(data)
        self.on_message, self._on_damage = on_message, on_damage
        self.contents = Contents()
        self._pos = 0
        self._is_whole = True
        self._after_bad_chunk = False
        self._has_chunks = True
        self._in_summary = False
        self._left = most_plain(self.size)  # [bytes] remaining decompressed size allowed for its chunks

    def steps(self) -> Iterator[int]:
        """Read to the end and yield the position after each record."""
        if self.data[:8] != MAGIC:
            self._damage(Loss(0, 8, "it does not start with the MCAP magic"))
        self._pos = 8
        while self._pos < self.size:
            if self.contents.is_finished:  # only the magic remains, which the footer check has verified
                if self._pos + 8 == self.size:
                    return
                self._damage(Loss(self._pos, self.size, "bytes follow the end of the file"))
                return
            self._step()
            yield self._pos
        if not self.contents.is_finished:
            self._damage(
                Loss(self.size, self.size, "it ends without a footer because its writer was interrupted")
            )

    def _damage(self, loss: Loss) -> None:
        self._is_whole = False
        self._on_damage(loss)

    def _step(self) -> None:
        start = self._pos
        try:
            opcode, body, end = self._frame(start)
        except DamagedRecord as exc:
            if self._recover_open_chunk(start):
                self._pos = self.size
                self._damage(Loss(start, self.size, f"{exc}; the complete records at its start were kept"))
            else:
                self._resume(start, str(exc))
            return
        try:
            self._record(opcode, body, end)
            self._pos = end
        except _BadChunk as exc:  # the framing is intact, so the position of the next record is known
            self.contents.bad_chunks += 1
            self._after_bad_chunk = True
            self._damage(Loss(start, end, str(exc)))
            self._pos = end
        except DamagedRecord as exc:
            self._resume(start, str(exc))

    def _resume(self, start: int, why: str) -> None:
        self._pos = self._resync(start + 1)
        self._damage(Loss(start, self._pos, why))

    def _frame(self, pos: int) -> tuple[int, int, int]:
        """Return opcode, start and end of the record at pos, if these are plausible."""
        if pos + 9 > self.size:
            raise DamagedRecord("it is truncated inside a record")
        opcode, length = RECORD_HEAD.unpack_from(self.data, pos)
        end = pos + 9 + length
        if not 1 <= opcode <= Opcode.DATA_END and opcode < 0x80:
            raise DamagedRecord(f"no record starts here (opcode {opcode:#04x})")
        if end > self.size:
            raise DamagedRecord(f"a record of {length} bytes runs past the end of the file")
        if FIXED_LENGTHS.get(opcode, length) != length:
            raise DamagedRecord(f"a record with opcode {opcode:#04x} has {length} bytes")
        return opcode, pos + 9, end

    def _record(self, opcode: int, body: int, end: int) -> None:
        if opcode in SUMMARY_ONLY and not self._in_summary:
            raise DamagedRecord(f"a record with opcode {opcode:#04x} is before the end of the data section")
        contents = self.contents
        if opcode == Opcode.CHUNK:
            self._chunk(parsed(records.Chunk, self.data, body, end))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, MESSAGE):
            self._has_chunks &= self._in_summary
            if opcode == MESSAGE and (
                contents.n_chunks or Cursor(self.data, body, end).read2() not in contents.channels
            ):
                raise DamagedRecord("a message is outside the chunks, or before its channel")
            self._content(opcode, self.data, body, end)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._message_index(Cursor(self.data, body, end))
        elif opcode == Opcode.HEADER:
            contents.profile = parsed(records.Header, self.data, body, end).profile
        elif opcode == Opcode.ATTACHMENT:
            contents.attachments.append(attachment(self.data, body, end))
        elif opcode == Opcode.METADATA:
            about = parsed(records.Metadata, self.data, body, end)
            contents.metadata.append((about.name, about.metadata))
        elif opcode == Opcode.STATISTICS:
            contents.n_claimed = parsed(records.Statistics, self.data, body, end).message_count
        elif opcode == Opcode.DATA_END:
            crc = parsed(records.DataEnd, self.data, body, end).data_section_crc
            self._in_summary = True
            if crc and self._is_whole and crc != self._crc32(0, body - 9):
                raise DamagedRecord("the data section does not match its checksum")
        elif opcode == Opcode.FOOTER:
            self._footer(parsed(records.Footer, self.data, body, end), body)
        if opcode != Opcode.MESSAGE_INDEX:
            self._after_bad_chunk = False

    def _footer(self, footer: records.Footer, body: int) -> None:
        if not self._in_summary:
            raise DamagedRecord("the data section has no end record")
        start = footer.summary_start or body - 9
        if footer.summary_crc and self._is_whole and footer.summary_crc != self._crc32(start, body + 16):
            raise DamagedRecord("the summary does not match its checksum")
        if self.data[body + 20 : body + 28] != MAGIC:
            raise DamagedRecord("the file does not end with the MCAP magic")
        self.contents.is_finished = True

    def _crc32(self, start: int, end: int) -> int:
        with memoryview(self.data) as view, view[start:end] as part:
            return zlib.crc32(part)

    def _message_index(self, cursor: Cursor) -> None:
        channel, size = cursor.read2(), cursor.read4()
        if size % 16 or size != cursor.end - cursor.pos:
            raise DamagedRecord("an index record has a wrong size")
        if self._after_bad_chunk:
            lost = self.contents.lost_messages
            lost[channel] = lost.get(channel, 0) + size // 16

    def _chunk(self, chunk: records.Chunk) -> None:
        size, crc = chunk.uncompressed_size, chunk.uncompressed_crc
        self.contents.n_chunks += 1
        try:
            plain = inflate(chunk.compression, chunk.data, min(size, self._left))
            self._left -= len(plain)
            if len(plain) != size:
                raise DamagedRecord(f"a chunk holds {len(plain)} bytes, expected {size}")
            if crc and crc != zlib.crc32(plain):
                raise DamagedRecord("a chunk does not match its checksum")
        except DamagedRecord as exc:
            raise _BadChunk(str(exc)) from exc
        self._chunk_content(plain, complete=True)

    def _chunk_content(self, plain: bytes, *, complete: bool) -> None:
        pos, size = 0, len(plain)
        while pos < size:
            end = pos + 9
            if end <= size:
                opcode, length = RECORD_HEAD.unpack_from(plain, pos)
                end += length
            if end > size:
                if complete:
                    raise _BadChunk("a record runs past the end of its chunk")
                return
            try:
                self._content(opcode, plain, pos + 9, end)
            except DamagedRecord as exc:
                raise _BadChunk(str(exc)) from exc
            pos = end

    def _content(self, opcode: int, data: Data, body: int, end: int) -> None:
        """Process a record that may be inside a chunk."""
        if opcode == MESSAGE:
            if end - body < MESSAGE_HEAD.size:
                raise DamagedRecord(f"a message record has {end - body} bytes")
            self.contents.n_messages += 1
            channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(data, body)
            self.on_message(channel, sequence, log_time, publish_time, data[body + MESSAGE_HEAD.size : end])
        elif opcode == Opcode.SCHEMA:
            schema = parsed(records.Schema, data, body, end)
            self.contents.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            found = parsed(records.Channel, data, body, end)
            self.contents.channels.setdefault(found.id, found)

    def _recover_open_chunk(self, pos: int) -> bool:
        """Read the complete records of a truncated last chunk; return whether there is such a chunk."""
        if pos + 9 > self.size or self.data[pos] != Opcode.CHUNK:
            return False
        cursor = Cursor(self.data, pos + 9, self.size)
        try:
            cursor.read(CHUNK_HEAD_SIZE)
            compression = cursor.read_prefixed_string()
            if cursor.read8() <= self.size - cursor.pos:
                return False  # not truncated: its length is wrong
            rest = inflate(compression, self.data[cursor.pos : self.size], self._left)
            self._chunk_content(rest, complete=False)
        except (DamagedRecord, UnicodeDecodeError):
            return True
        return True

    def _resync(self, pos: int) -> int:
        """Return the first position at or after pos where a plausible record starts."""
        while pos + 9 <= self.size:
            block = np.frombuffer(self.data[pos : pos + SEARCH_BLOCK + 8], dtype=np.uint8)
            n = len(block) - 8
            likely = (block[:n] >= 1) & (block[:n] <= Opcode.DATA_END)
            for i in range(5, 9):  # no record is above 4 GiB
                likely &= block[i : n + i] == 0
            for offset in np.flatnonzero(likely).tolist():
                if self._is_plausible(pos + offset):
                    return pos + int(offset)
            pos += n
        return self.size

    def _is_plausible(self, pos: int, depth: int = 2) -> bool:
        """Return whether the record at pos is complete and followed by another complete record."""
        try:
            opcode, body, end = self._frame(pos)
            if opcode == Opcode.CHUNK:
                parsed(records.Chunk, self.data, body, end)
                return True
            if opcode == Opcode.ATTACHMENT:
                attachment(self.data, body, end)
                return True
            if opcode == Opcode.FOOTER:
                return bool(self.data[end:] == MAGIC)
            if opcode == MESSAGE:
                # inside a chunk without framing, an apparent message may be part of compressed data
                if (
                    self._has_chunks
                    or end - body < MESSAGE_HEAD.size
                    or Cursor(self.data, body, end).read2() not in self.contents.channels
                ):
                    return False
            elif opcode == Opcode.MESSAGE_INDEX and end - body != 6 + U4.unpack_from(self.data, body + 2)[0]:
                return False
        except (DamagedRecord, struct.error):
            return False
        return end == self.size or depth == 0 or self._is_plausible(end, depth - 1)


class _BadChunk(DamagedRecord):
    """A chunk with intact framing but damaged content."""
