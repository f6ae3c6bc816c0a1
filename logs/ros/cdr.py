"""Pack and unpack the byte layouts of ROS 2 (CDR) and ROS 1 messages, whole columns at once.

The messages of one topic share a layout. It is parsed once, then every field is a column of a byte matrix. Reading
and writing of files is in other modules.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError

Bytes = NDArray[np.uint8]
Fields = tuple[tuple[str, Any], ...]

HEADER_FIELDS: Fields = (("sec", "i4"), ("nanosec", "u4"), ("frame_id", "str"))
TRANSFORM_FIELDS: Fields = (*HEADER_FIELDS, ("child_frame_id", "str"), ("transform", "f8:7"))
MESSAGE_FIELDS: dict[str, Fields] = {
    "sensor_msgs/msg/LaserScan": (
        *HEADER_FIELDS,
        ("limits", "f4:7"),
        ("ranges", "f4[]"),
        ("intensities", "f4[]"),
    ),
    "sensor_msgs/msg/Range": (*HEADER_FIELDS, ("radiation_type", "u1"), ("limits", "f4:4")),
    "geometry_msgs/msg/PoseStamped": (*HEADER_FIELDS, ("pose", "f8:7")),
    "geometry_msgs/msg/TransformStamped": (*HEADER_FIELDS, ("child_frame_id", "str"), ("pose", "f8:7")),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        *HEADER_FIELDS,
        ("pose", "f8:7"),
        ("covariance", "f8:36"),
    ),
    "geometry_msgs/msg/TwistStamped": (*HEADER_FIELDS, ("twist", "f8:6")),
    "geometry_msgs/msg/Twist": (("twist", "f8:6"),),
    "nav_msgs/msg/Odometry": (
        *HEADER_FIELDS,
        ("child_frame_id", "str"),
        ("pose", "f8:7"),
        ("pose_covariance", "f8:36"),
        ("twist", "f8:6"),
        ("twist_covariance", "f8:36"),
    ),
    "tf2_msgs/msg/TFMessage": (("transforms", TRANSFORM_FIELDS),),
    "nav_msgs/msg/OccupancyGrid": (
        *HEADER_FIELDS,
        ("load_sec", "i4"),
        ("load_nanosec", "u4"),
        ("resolution", "f4"),
        ("size", "u4:2"),
        ("origin", "f8:7"),
        ("data", "i1[]"),
    ),
}
"""Type -> fields in order: `f8` is one number, `f8:7` seven, `f4[]` a length-prefixed array, `str` a text.

A nested tuple is a length-prefixed sequence of such fields."""

FIRST_FIELDS: dict[str, Fields] = {
    "sensor_msgs/msg/MultiEchoLaserScan": (*HEADER_FIELDS, ("limits", "f4:7")),
    "sensor_msgs/msg/PointCloud2": (
        *HEADER_FIELDS,
        ("size", "u4:2"),
        ("fields", (("name", "str"), ("offset", "u4"), ("datatype", "u1"), ("count", "u4"))),
        ("is_bigendian", "u1"),
        ("steps", "u4:2"),
        ("data", "u1[]"),
    ),
}
"""Types of which `unpack` reads only the first fields."""

_ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little-endian
MAX_ALIGNMENT = {b"\x00\x01": 8, b"\x00\x07": 4}
"""First bytes of a message, little-endian CDR and CDR2 -> [bytes] the alignment of its largest numbers."""
_U4 = struct.Struct("<I")


@dataclass(frozen=True)
class _FieldLayout:
    """Position of a numeric field in a message."""

    offset: int
    dtype: np.dtype[Any]
    count: int


@dataclass
class _Layout:
    """Position of every field of one message; `fixed` are the bytes that determine the layout."""

    places: dict[str, _FieldLayout] = field(default_factory=dict)
    strings: dict[str, str] = field(default_factory=dict)
    fixed: list[tuple[int, bytes]] = field(default_factory=list)
    end: int = 4
    is_ros1: bool = False
    max_alignment: int = 8

    def align(self, size: int) -> None:
        if not self.is_ros1:
            self.end += -(self.end - 4) % min(size, self.max_alignment)

    def numbers(self, name: str, code: str, count: int) -> None:
        dtype = np.dtype("<" + code)
        if count:
            self.align(dtype.itemsize)
        self.places[name] = _FieldLayout(self.end, dtype, count)
        self.end += dtype.itemsize * count

    def keep(self, data: bytes) -> None:
        self.fixed.append((self.end, data))
        self.end += len(data)


@dataclass(frozen=True)
class MessageColumns:
    """Messages of one layout."""

    index: NDArray[np.intp]
    """(m,) indices of these messages among those given."""
    strings: Mapping[str, str]
    """The text fields, equal in all of these messages."""
    rows: Bytes
    """(m, size) the messages."""
    places: Mapping[str, _FieldLayout]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the column `name`, (m, count)."""
        place = self.places[name]
        stop = place.offset + place.dtype.itemsize * place.count
        return np.ascontiguousarray(self.rows[:, place.offset : stop]).view(place.dtype)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(m,) [ns] stamps of the headers."""
        sec, nanosec = self["sec"][:, 0].astype(np.int64), self["nanosec"][:, 0].astype(np.int64)
        return sec * 1_000_000_000 + nanosec

    def part(self, i: int) -> MessageColumns:
        """Return the i-th element of a repeated part as separate columns."""
        head = f"{i}."
        return MessageColumns(
            index=self.index,
            rows=self.rows,
            strings={k.removeprefix(head): v for k, v in self.strings.items() if k.startswith(head)},
            places={k.removeprefix(head): v for k, v in self.places.items() if k.startswith(head)},
        )

    @property
    def n_parts(self) -> int:
        """Number of elements of a repeated part."""
        return len({name.split(".")[0] for name in self.places if "." in name})


class Messages:
    """The messages of a topic; messages of one size share a buffer, which needs half the memory of a list."""

    def __init__(self, messages: Iterable[bytes] = ()) -> None:
        self._buffers: dict[int, bytearray] = {}
        self._index: dict[int, array[int]] = {}
        self._n = 0
        for message in messages:
            self.append(message)

    def __len__(self) -> int:
        return self._n

    def append(self, message: bytes | memoryview) -> None:
        """Append a message."""
        size = len(message)
        if size not in self._buffers:
            self._buffers[size], self._index[size] = bytearray(), array("q")
        self._buffers[size] += message
        self._index[size].append(self._n)
        self._n += 1

    def take(self, more: Messages) -> None:
        """Move the messages of another part of the topic to the end, in order."""
        for size, buffer in more._buffers.items():
            if size not in self._buffers:
                self._buffers[size], self._index[size] = bytearray(), array("q")
            self._buffers[size] += buffer
            self._index[size].extend(self._n + i for i in more._index[size])
            buffer.clear()
        self._n += more._n
        more._buffers, more._index, more._n = {}, {}, 0

    def by_size(self) -> Iterator[tuple[NDArray[np.intp], Bytes]]:
        """Yield the indices (m,) of the messages of one size and their bytes (m, size), smallest size first."""
        for size in sorted(self._buffers):
            index = np.array(self._index[size], dtype=np.intp)
            yield index, np.frombuffer(self._buffers[size], dtype=np.uint8).reshape(len(index), size)

    def __iter__(self) -> Iterator[bytes]:
        """Yield the messages in order."""
        size_of = np.empty(self._n, dtype=np.int64)
        for size, index in self._index.items():
            size_of[np.array(index, dtype=np.intp)] = size
        at = dict.fromkeys(self._buffers, 0)
        for size in size_of.tolist():
            yield bytes(self._buffers[size][at[size] : at[size] + size])
            at[size] += size


def fields_of(msgtype: str) -> Fields:
    """Return the fields of a type that `unpack` reads."""
    return MESSAGE_FIELDS.get(msgtype) or FIRST_FIELDS[msgtype]


def unpack(
    messages: Messages | Sequence[bytes], msgtype: str, topic: str, encoding: str = "cdr"
) -> Iterator[MessageColumns]:
    """Yield columns of `messages`, one block per layout; the encoding is `cdr` or `ros1`."""
    spec = fields_of(msgtype)
    packed = messages if isinstance(messages, Messages) else Messages(messages)
    for index, rows in packed.by_size():
        if rows.shape[1] < 4:
            raise LogError(_bad(topic, msgtype, int(index[0]), f"it has {rows.shape[1]} bytes"))
        while len(index):
            try:
                layout = _walk(spec, rows[0].tobytes(), is_ros1=encoding == "ros1")
            except (ValueError, struct.error) as exc:
                raise LogError(_bad(topic, msgtype, int(index[0]), str(exc))) from exc
            same = np.ones(len(index), dtype=np.bool_)
            for offset, data in layout.fixed:
                part = np.frombuffer(data, dtype=np.uint8)
                same &= (rows[:, offset : offset + len(data)] == part).all(axis=1)
            if same.all():
                yield MessageColumns(index, layout.strings, rows, layout.places)
                break
            yield MessageColumns(index[same], layout.strings, rows[same], layout.places)
            index, rows = index[~same], rows[~same]


def pack(
    msgtype: str, n: int, *, strings: Mapping[str, str], columns: Mapping[str, NDArray[Any]], parts: int = 0
) -> Bytes:
    """Pack n messages with equal texts; missing fields are 0.

    Parameters
    ----------
    columns : Name -> (n,), (n, count) or (count,). The last axis is the length of an array field.
    parts : Number of elements of the repeated part in each message; its fields are `0.frame_id`, `1.frame_id`, …

    Returns
    -------
    (n, size) bytes, one message per row
    """
    layout = _Layout()
    layout.fixed.append((0, _ENCAPSULATION))
    _lay_out(layout, MESSAGE_FIELDS[msgtype], "", strings, columns, parts)
    template = np.zeros(layout.end, dtype=np.uint8)
    for offset, data in layout.fixed:
        template[offset : offset + len(data)] = np.frombuffer(data, dtype=np.uint8)
    rows = np.empty((n, layout.end), dtype=np.uint8)
    rows[:] = template
    for name, values in columns.items():
        place = layout.places[name]
        shape = (n, place.count)
        given = values[:, None] if values.ndim == 1 and place.count == 1 else values
        column = np.ascontiguousarray(np.broadcast_to(given, shape), dtype=place.dtype)
        rows[:, place.offset : place.offset + column.itemsize * place.count] = column.view(np.uint8)
    return rows


def _lay_out(
    layout: _Layout,
    spec: Fields,
    head: str,
    strings: Mapping[str, str],
    columns: Mapping[str, NDArray[Any]],
    parts: int,
) -> None:
    """Determine the layout of fields to pack."""
    for name, kind in spec:
        if not isinstance(kind, str):
            layout.align(4)
            layout.keep(_U4.pack(parts))
            for i in range(parts):
                _lay_out(layout, kind, f"{head}{i}.", strings, columns, parts)
        elif kind == "str":
            text = strings.get(head + name, "").encode() + b"\x00"
            layout.align(4)
            layout.keep(_U4.pack(len(text)) + text)
        elif kind.endswith("[]"):
            count = columns[head + name].shape[-1] if head + name in columns else 0
            layout.align(4)
            layout.keep(_U4.pack(count))
            layout.numbers(head + name, kind[:-2], count)
        else:
            code, _, count_text = kind.partition(":")
            layout.numbers(head + name, code, int(count_text or 1))


def _walk(spec: Fields, data: bytes, *, is_ros1: bool) -> _Layout:
    """Find the positions of the fields of one message.

    ROS 1 has the same fields in the same order, without alignment and encapsulation, and numbers its headers.
    """
    if is_ros1:
        layout = _Layout(end=0, is_ros1=True)
    elif data[:2] not in MAX_ALIGNMENT:
        raise ValueError(
            f"it starts with {data[:4].hex(' ')}, expected little-endian CDR or CDR2 without parameter lists, 00 01 or 00 07"
        )
    else:
        layout = _Layout(fixed=[(0, data[:2])], max_alignment=MAX_ALIGNMENT[data[:2]])
    _find(layout, spec, "", data)
    if layout.end > len(data):
        raise ValueError(f"it has {len(data)} bytes, but its fields need {layout.end}")
    return layout


def _find(layout: _Layout, spec: Fields, head: str, data: bytes) -> None:
    for name, kind in spec:
        if isinstance(kind, str) and kind != "str" and not kind.endswith("[]"):
            code, _, count_text = kind.partition(":")
            if name == "sec" and layout.is_ros1:
                layout.numbers(head + "seq", "u4", 1)
            layout.numbers(head + name, code, int(count_text or 1))
            continue
        layout.align(4)
        (count,) = _U4.unpack_from(data, layout.end)
        if count > len(data):
            raise ValueError(f"field {name} claims {count} elements in a message of {len(data)} bytes")
        layout.keep(data[layout.end : layout.end + 4])
        if not isinstance(kind, str):
            for i in range(count):
                _find(layout, kind, f"{head}{i}.", data)
        elif kind == "str":
            text = data[layout.end : layout.end + count]
            if len(text) < count:
                raise ValueError(f"field {name} runs past the end of the message")
            layout.strings[head + name] = text.rstrip(b"\x00").decode("utf-8", errors="replace")
            layout.keep(text)
        else:
            layout.numbers(head + name, kind[:-2], count)


def _bad(topic: str, msgtype: str, i: int, why: str) -> str:
    return (
        f"message {i} on {topic} is not a valid {msgtype}: {why}; the file is damaged or states a wrong type"
    )
