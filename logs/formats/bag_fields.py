"""The records of ROS 1 bags: headers of named fields, data, and the search for the next record after damage."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from itertools import permutations
from typing import TYPE_CHECKING, Any

from logs.errors import LogError
from logs.inflation import TooLarge, unpack
from logs.mcap.records import U4, DamagedRecord

if TYPE_CHECKING:
    from logs.mcap.records import Data

MESSAGE_DEFINITION, MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(1, 8)
MAGIC = re.compile(rb"#ROS(?:BAG|RECORD) V(\d+)\.(\d+)\r?\n")
VERSIONS = ((1, 2), (2, 0))
INDEX_ENTRY = 12
"""[bytes] time and offset of a message in an index of version 1."""
LONGEST_HEADER = 1 << 20
"""[bytes] maximum length of a record header; version 1.2 keeps message definitions in headers."""
SEARCH_BACK = 1 << 16
"""[bytes] before an `op` field in which the start of its record is searched after damage."""
_OP, _CONN, _AT = (U4.pack(size) + name for size, name in ((4, b"op="), (9, b"conn="), (13, b"time=")))
HEAD_SIZE = 38
"""[bytes] length of the header of a message in version 2.0: the fields op, conn and time in any order."""

Header = Mapping[bytes, bytes]


class MessageHead:
    """A message of version 2.0 with one order of its fields: header size, fields, data size."""

    def __init__(self, order: tuple[bytes, ...]) -> None:
        codes = {_OP: "7sB", _CONN: "9sI", _AT: "9sII"}
        self.unpack_from = struct.Struct(f"<I{''.join(codes[name] for name in order)}I").unpack_from
        starts = {name: 1 + sum(2 + (other == _AT) for other in order[:i]) for i, name in enumerate(order)}
        self.op, self.conn, self.time = starts[_OP], starts[_CONN], starts[_AT]

    def fits(self, values: tuple[Any, ...]) -> bool:
        """Return whether unpacked values are a message with this order of fields."""
        return bool(
            values[0] == HEAD_SIZE
            and values[self.op] == _OP
            and values[self.conn] == _CONN
            and values[self.time] == _AT
            and values[self.op + 1] == MESSAGE
        )


HEADS = [MessageHead(order) for order in permutations((_OP, _CONN, _AT))]


def check_bag(path: object, data: Data) -> None:
    """Reject a bag of another version, or an encrypted one.

    Raises
    ------
    LogError
        If the version is not in `VERSIONS`, or the messages are encrypted.
    """
    found = MAGIC.match(data[:64])
    version = tuple(map(int, found.groups())) if found else None
    if found is None or version not in VERSIONS:
        what = f"version {'.'.join(map(str, version))}" if version else f"the first line {data[:13]!r}"
        raise LogError(
            f"{path} is a ROS 1 bag with {what}, expected 1.2 or 2.0; convert it with `rosbag fix`"
        )
    try:
        encryptor = fields_of(data, *header_at(data, found.end(), len(data))).get(b"encryptor")
    except DamagedRecord:
        return
    if encryptor:
        raise LogError(f"{path} is encrypted ({encryptor!r:.60}); decrypt it with `rosbag decrypt`")


def header_at(data: Data, pos: int, end: int) -> tuple[int, int]:
    """Return start and end of the header of the record at pos, if its length is plausible."""
    if pos + 4 > end:
        raise DamagedRecord("it is truncated inside a record")
    (size,) = U4.unpack_from(data, pos)
    if not len(_OP) < size <= LONGEST_HEADER:
        raise DamagedRecord(f"no record starts here (its header would have {size} bytes)")
    if pos + 4 + size > end:
        raise DamagedRecord("it is truncated inside a record")
    return pos + 4, pos + 4 + size


def fields_of(data: Data, pos: int, end: int) -> dict[bytes, bytes]:
    """Read the fields of a header."""
    fields = {}
    while pos < end:
        if pos + 4 > end or (after := pos + 4 + U4.unpack_from(data, pos)[0]) > end:
            raise DamagedRecord("a field runs past the end of its header")
        name, equals, value = data[pos + 4 : after].partition(b"=")
        if not equals:
            raise DamagedRecord("a header has a field without a name")
        fields[name] = value
        pos = after
    return fields


def number(fields: Header, name: bytes, code: str) -> int:
    """Return a field as an integer."""
    try:
        return int(struct.unpack(code, fields[name])[0])
    except (KeyError, struct.error):
        raise DamagedRecord(f"a record has no valid field `{name.decode()}`") from None


def text(data: bytes) -> str:
    """Decode a text; bytes that are not UTF-8 are replaced."""
    return data.decode("utf-8", errors="replace")


def body_of(data: Data, stop: int, op: int, fields: Header) -> tuple[int, int]:
    """Return start and end of the data of a record whose header ends at `stop`."""
    if stop + 4 > len(data):
        raise DamagedRecord("it is truncated inside a record")
    body = stop + 4
    end = body + U4.unpack_from(data, stop)[0]
    if op == INDEX and fields.get(b"ver") == U4.pack(1) and b"count" in fields:
        by_count = body + INDEX_ENTRY * number(fields, b"count", "<I")  # as rosbag reads it
        if by_count != end and (by_count == len(data) or _starts_record(data, by_count)):
            end = by_count
    return body, end


def _starts_record(data: Data, pos: int) -> bool:
    """Return whether the header of a record starts at pos."""
    try:
        fields = fields_of(data, *header_at(data, pos, len(data)))
        return MESSAGE_DEFINITION <= number(fields, b"op", "<B") <= CONNECTION
    except DamagedRecord:
        return False


def next_record(data: Data, pos: int, end: int) -> int:
    """Return the first position from pos to `end` where a complete record starts, or `end`."""
    first = pos
    while (found := data.find(_OP, pos, end)) >= 0:
        for start in range(found - 4, max(first, found - SEARCH_BACK) - 1, -1):
            try:
                begin, stop = header_at(data, start, end)
                fields = fields_of(data, begin, stop)
                op = number(fields, b"op", "<B")
                _, after = body_of(data, stop, op, fields)
            except DamagedRecord:
                continue
            if MESSAGE_DEFINITION <= op <= CONNECTION and after <= end:
                return start
        pos = found + len(_OP)
    return end


def plain_chunk(kind: bytes, stored: bytes, size: int, most: int) -> bytes:
    """Decompress a chunk of the stated size [bytes], at most `most` bytes."""
    if kind not in (b"bz2", b"lz4"):
        raise DamagedRecord(f"the compression {kind!r:.20} is unknown; expected none, bz2 or lz4")
    try:
        plain = unpack(stored, min(size, most))
    except TooLarge as exc:
        raise DamagedRecord(f"a chunk {exc}, more than it states or a file of this size can hold") from exc
    except ValueError as exc:
        raise DamagedRecord(f"a {kind.decode()} chunk cannot be decompressed") from exc
    if len(plain) != size:
        raise DamagedRecord(f"a chunk holds {len(plain)} bytes, expected {size}")
    return plain
