"""ROS 1 bags byte by byte, as several recorders wrote them."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]

from benchmarks.fuzz.structure.draft import Draft
from benchmarks.fuzz.structure.packing import definition, full, nanoseconds, payload

PACKERS: dict[str, Callable[[bytes], bytes]] = {"none": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress}


@dataclass(frozen=True, kw_only=True)
class Style:
    """How a recorder writes a bag of version 2.0."""

    compression: str = "none"
    per_chunk: int = 400
    index_entry: int = 12
    """Bytes of an index entry by the stated lengths: the recorder of 2010 stated 20."""
    is_closed: bool = True
    order: tuple[str, ...] = ("op", "conn", "time")


def _u4(value: int) -> bytes:
    return struct.pack("<I", value)


def _u8(value: int) -> bytes:
    return struct.pack("<Q", value)


def _time(at: float) -> bytes:
    return struct.pack("<II", *divmod(nanoseconds(at), 10**9))


def _fields(values: Mapping[str, bytes]) -> bytes:
    parts = [name.encode() + b"=" + value for name, value in values.items()]
    return b"".join(_u4(len(part)) + part for part in parts)


def _record(values: Mapping[str, bytes], data: bytes, stated: int | None = None) -> bytes:
    head = _fields(values)
    return _u4(len(head)) + head + _u4(len(data) if stated is None else stated) + data


def _about(draft: Draft, topic: str, kind: str) -> dict[str, bytes]:
    text, digest = definition(kind, draft.definitions.get(kind, ""), ros1=True)
    return {
        "topic": topic.encode(), "type": full(kind, ros1=True).encode(), "md5sum": digest.encode(),
        "message_definition": text.encode(),
    }  # fmt: skip


def _header(index_pos: int, n_connections: int, n_chunks: int) -> bytes:
    values = {
        "op": b"\x03",
        "index_pos": _u8(index_pos),
        "conn_count": _u4(n_connections),
        "chunk_count": _u4(n_chunks),
    }
    size = len(_fields(values))
    return _record(values, b" " * (4096 - size - 8))


def bag20(draft: Draft, style: Style = Style()) -> bytes:
    """Return a bag of version 2.0."""
    sources = draft.sources
    links = [
        _record({"op": b"\x07", "conn": _u4(i), "topic": topic.encode()}, _fields(_about(draft, topic, kind)))
        for i, (topic, kind) in enumerate(sources)
    ]
    number = {source: i for i, source in enumerate(sources)}
    start = b"#ROSBAG V2.0\n"
    chunks, infos, at, known = [], [], len(start) + len(_header(0, 0, 0)), set[int]()
    for first in range(0, len(draft.items), style.per_chunk):
        part = draft.items[first : first + style.per_chunk]
        plain, index = bytearray(), dict[int, bytes]()
        for item in part:
            link = number[item.topic, item.kind]
            if link not in known:
                known.add(link)
                plain += links[link]
            index[link] = index.get(link, b"") + _time(item.log) + _u4(len(plain))
            values = {"op": b"\x02", "conn": _u4(link), "time": _time(item.log)}
            plain += _record({name: values[name] for name in style.order}, payload(item, ros1=True))
        is_open = not style.is_closed and first + style.per_chunk >= len(draft.items)
        about = {
            "op": b"\x05",
            "compression": style.compression.encode(),
            "size": _u4(0 if is_open else len(plain)),
        }
        packed = bytes(plain) if is_open else PACKERS[style.compression](bytes(plain))
        chunk = _record(about, packed, 0 if is_open else None)
        for link, entries in () if is_open else index.items():
            n = len(entries) // 12
            about = {"op": b"\x04", "ver": _u4(1), "conn": _u4(link), "count": _u4(n)}
            chunk += _record(about, entries, style.index_entry * n)
        counts = b"".join(_u4(link) + _u4(len(entries) // 12) for link, entries in index.items())
        about = {"op": b"\x06", "ver": _u4(1), "chunk_pos": _u8(at), "start_time": _time(part[0].log),
                 "end_time": _time(part[-1].log), "count": _u4(len(index))}  # fmt: skip
        infos.append(_record(about, counts))
        chunks.append(chunk)
        at += len(chunk)
    if not style.is_closed:
        return start + _header(0, 0, 0) + b"".join(chunks)
    return b"".join([start, _header(at, len(sources), len(chunks)), *chunks, *links, *infos])


def bag12(draft: Draft) -> bytes:
    """Return a bag of version 1.2: definitions and messages, without chunks and without an index."""
    out = [b"#ROSRECORD V1.2\n"]
    known = set[str]()
    for item in draft.items:
        about = _about(draft, item.topic, item.kind)
        common = {"topic": about["topic"], "md5": about["md5sum"], "type": about["type"]}
        if item.topic not in known:
            known.add(item.topic)
            out.append(_record({"op": b"\x01", **common, "def": about["message_definition"]}, b""))
        sec, nanosec = divmod(nanoseconds(item.log), 10**9)
        values = {"op": b"\x02", **common, "sec": _u4(sec), "nsec": _u4(nanosec)}
        out.append(_record(values, payload(item, ros1=True)))
    return b"".join(out)
