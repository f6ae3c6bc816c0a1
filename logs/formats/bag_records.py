"""Read a ROS 1 bag record by record, without its index: versions 1.2 and 2.0.

An interrupted recorder writes no index, and the recorder of 2010 wrote wrong lengths into it. The walk has the interface
of `logs.mcap.walk.RecordWalk`, so `recover` copies the messages of both formats.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mcap.records import Channel, Schema

from logs.formats.bag_fields import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEAD_SIZE,
    HEADS,
    INDEX,
    MAGIC,
    MESSAGE,
    MESSAGE_DEFINITION,
    Header,
    body_of,
    fields_of,
    header_at,
    next_record,
    number,
    plain_chunk,
    text,
)
from logs.inflation import most_plain, unpack_start
from logs.mcap.records import U4, Contents, DamagedRecord, Loss

if TYPE_CHECKING:
    from logs.mcap.records import Data
    from logs.mcap.walk import DamageSink, MessageSink

_TIME = struct.Struct("<II")


class BagWalk:
    """Iterate over the records of a ROS 1 bag once; the channels have the encoding `ros1`."""

    def __init__(self, data: Data, on_message: MessageSink, on_damage: DamageSink) -> None:
        self.data, self.size = data, len(data)
        self.on_message, self._on_damage = on_message, on_damage
        self.contents = Contents(profile="ros1")
        self.index_pos: int | None = None
        """Position of the index; 0: the bag was not closed; None: a bag without an index."""
        self._ids: dict[bytes, int] = {}  # topic -> channel, in version 1.2
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._left = most_plain(self.size)  # [bytes] remaining decompressed size allowed for its chunks
        self._after_bad_chunk = False
        self._head = HEADS[0]
        self._lost_to = 0  # end of the last loss
        self._n_losses = 0
        self._chunks_read: set[int] = set()
        self._chunks_listed: set[int] = set()
        self._n_chunks_stated = -1

    def steps(self) -> Iterator[int]:
        """Read to the end and yield the position after each record."""
        found = MAGIC.match(self.data[:64])
        pos = found.end() if found else 0
        while pos < self.size:
            pos = self._step(pos)
            yield pos
        if self.index_pos and self.index_pos >= self.size and self._lost_to < self.size:
            why = f"it is truncated: its index would start at byte {self.index_pos}"
            self._damage(self.size, self.size, why)
        self.contents.is_finished = self.index_pos != 0

    def _step(self, pos: int) -> int:
        """Read the record at pos; return the position of the next one."""
        try:
            start, stop = header_at(self.data, pos, self.size)
            fields = fields_of(self.data, start, stop)
            op = number(fields, b"op", "<B")
            body, end = body_of(self.data, stop, op, fields)
        except DamagedRecord as exc:
            return self._resume(pos, self._end_of_data(pos), str(exc))
        try:
            if op == CHUNK:
                n_losses = self._n_losses
                after = self._chunk(fields, body, end, pos)
                if self._n_losses == n_losses:
                    self._chunks_read.add(pos)
                return after
            if end > self._end_of_data(pos):
                return self._resume(pos, self._end_of_data(pos), "it is truncated inside a record")
            self._record(op, fields, self.data, body, end)
        except DamagedRecord as exc:
            self._damage(pos, end, str(exc))
        return end

    @property
    def has_read_index(self) -> bool:
        """Return whether the index is complete and every chunk in it was read without a loss.

        Other bytes are no messages: `rosbag reindex` leaves the rest of a truncated chunk in the file.
        """
        is_complete = len(self._chunks_listed) == self._n_chunks_stated
        return is_complete and self._chunks_listed <= self._chunks_read

    def _damage(self, start: int, end: int, why: str) -> None:
        self._lost_to, self._n_losses = end, self._n_losses + 1
        self._on_damage(Loss(start, end, why))

    def _end_of_data(self, pos: int) -> int:
        """Return the end of the section that holds pos: the start of the index, or the end of the file."""
        is_before = self.index_pos is not None and pos < self.index_pos <= self.size
        return self.index_pos if is_before and self.index_pos else self.size

    def _record(self, op: int, fields: Header, data: Data, body: int, end: int) -> None:
        if op == MESSAGE:
            self._message(fields, data[body:end])
        elif op == CONNECTION:
            about = fields_of(data, body, end)
            topic = fields.get(b"topic", about.get(b"topic", b""))
            self._connect(number(fields, b"conn", "<I"), topic, about)
        elif op == MESSAGE_DEFINITION:
            self._define(fields)
        elif op == BAG_HEADER:
            self.index_pos = number(fields, b"index_pos", "<Q")
            if b"chunk_count" in fields:
                self._n_chunks_stated = number(fields, b"chunk_count", "<I")
        elif op == CHUNK_INFO:
            self._chunks_listed.add(number(fields, b"chunk_pos", "<Q"))
        elif op == INDEX and self._after_bad_chunk:
            conn, lost = number(fields, b"conn", "<I"), self.contents.lost_messages
            lost[conn] = lost.get(conn, 0) + number(fields, b"count", "<I")
        elif not MESSAGE_DEFINITION <= op <= CONNECTION:
            raise DamagedRecord(f"a record has the unknown type {op}")
        if op != INDEX:
            self._after_bad_chunk = False

    def _message(self, fields: Header, payload: bytes) -> None:
        if b"conn" in fields:
            conn, time = number(fields, b"conn", "<I"), fields.get(b"time", b"")
        else:
            time = fields.get(b"sec", b"") + fields.get(b"nsec", b"")
            known = self._ids.get(fields.get(b"topic", b""))
            conn = self._define(fields) if known is None else known
        if len(time) != _TIME.size:
            raise DamagedRecord("a message has no time")
        sec, nsec = _TIME.unpack(time)
        self._put(conn, sec * 1_000_000_000 + nsec, payload)

    def _put(self, conn: int, ns: int, payload: bytes | memoryview) -> None:
        self.contents.n_messages += 1
        self.on_message(conn, 0, ns, ns, payload)

    def _define(self, fields: Header) -> int:
        """Return the channel of a topic of version 1.2, which does not number its connections."""
        topic = fields.get(b"topic", b"")
        key = self._ids.setdefault(topic, len(self._ids))
        names = {b"type": b"type", b"md5": b"md5sum", b"def": b"message_definition"}
        self._connect(key, topic, {names[name]: value for name, value in fields.items() if name in names})
        return key

    def _connect(self, key: int, topic: bytes, about: Header) -> None:
        if key in self.contents.channels:
            return
        kind = (text(about.get(b"type", b"")), about.get(b"message_definition", b""))
        schema = self._schemas.setdefault(kind, len(self._schemas) + 1)
        self.contents.schemas[schema] = Schema(id=schema, name=kind[0], encoding="ros1msg", data=kind[1])
        kept = (b"md5sum", b"callerid", b"latching")
        others = {text(name): text(about[name]) for name in kept if name in about}
        self.contents.channels[key] = Channel(
            id=key, topic=text(topic), message_encoding="ros1", metadata=others, schema_id=schema
        )

    def _chunk(self, fields: Header, body: int, end: int, pos: int) -> int:
        """Read a chunk; return the position of the next record."""
        kind, size = fields.get(b"compression", b"none"), number(fields, b"size", "<I")
        self.contents.n_chunks += 1
        self._after_bad_chunk = False
        is_open = body == end and size == 0  # the recorder writes the sizes of a chunk when it closes it
        if is_open and kind == b"none":
            return end
        if is_open or end > self._end_of_data(pos):
            return self._cut_chunk(kind, body, pos)
        if kind == b"none":
            self._inner(self.data, body, end)
            return end
        try:
            plain = plain_chunk(kind, self.data[body:end], size, self._left)
            self._left -= size
            self._inner(plain, 0, size)
        except DamagedRecord as exc:
            self.contents.bad_chunks += 1
            self._after_bad_chunk = True
            self._damage(pos, end, str(exc))
        return end

    def _inner(self, data: Data, pos: int, end: int, *, is_cut: bool = False) -> int:
        """Read the records of a chunk between two positions; return the position after the last one.

        With `is_cut`, reading ends at the first incomplete record. Otherwise, a damaged record is skipped in an
        uncompressed chunk, and raises `DamagedRecord` in a compressed one.
        """
        while pos < end:
            pos = self._messages(data, pos, end)
            if pos == end:
                break
            try:
                start, stop = header_at(data, pos, end)
                fields = fields_of(data, start, stop)
                if stop + 4 > end or (after := stop + 4 + U4.unpack_from(data, stop)[0]) > end:
                    raise DamagedRecord("a record runs past the end of its chunk")
                op = number(fields, b"op", "<B")
                if op not in (MESSAGE, CONNECTION):
                    raise DamagedRecord(f"a chunk has a record of type {op}")
                self._record(op, fields, data, stop + 4, after)
                pos = after
            except DamagedRecord as exc:
                if is_cut:
                    break
                if data is not self.data:
                    raise
                pos = self._resume(pos, end, str(exc))
        return pos

    def _messages(self, data: Data, pos: int, end: int) -> int:
        """Read the consecutive messages of version 2.0 at pos; return the position after them.

        This does the same as `_record`, but unpacks each header in one step.
        """
        view, head = memoryview(data), self._head
        while pos + HEAD_SIZE + 8 <= end:
            values = head.unpack_from(data, pos)
            if not head.fits(values):
                fitting = (other for other in HEADS if other.fits(other.unpack_from(data, pos)))
                found = next(fitting, None)
                if found is None:
                    return pos
                self._head = head = found
                values = head.unpack_from(data, pos)
            body = pos + HEAD_SIZE + 8
            after = body + values[-1]
            if after > end:
                return pos
            ns = values[head.time + 1] * 1_000_000_000 + values[head.time + 2]
            self._put(values[head.conn + 1], ns, view[body:after])
            pos = after
        return pos

    def _cut_chunk(self, kind: bytes, body: int, pos: int) -> int:
        """Read the complete records at the start of a truncated chunk; return the position of the next record."""
        self.contents.bad_chunks += 1
        end = self._end_of_data(pos)
        if kind == b"none":
            start = stop = self._inner(self.data, body, end, is_cut=True)
        else:
            start, stop, plain = pos, body, unpack_start(self.data[body:end], self._left)
            self._inner(plain, 0, len(plain), is_cut=True)
        after = next_record(self.data, stop, end)
        why = "it is truncated inside a chunk" if after == end else "the length of a chunk is wrong"
        self._damage(start, after, why if kind == b"none" else f"{why}; `recover` keeps its complete records")
        return after

    def _resume(self, start: int, end: int, why: str) -> int:
        """Report the loss from start to the next record before `end`; return the position of that record."""
        pos = next_record(self.data, start + 1, end)
        self._damage(start, pos, why)
        return pos
