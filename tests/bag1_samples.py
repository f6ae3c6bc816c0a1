"""ROS 1 bags made byte by byte: versions 1.2 and 2.0, closed or interrupted, with the lengths of the recorder of 2010."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import numpy as np

SCAN, ODOMETRY, TWIST = "sensor_msgs/LaserScan", "nav_msgs/Odometry", "geometry_msgs/Twist"
PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "none": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress
}  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """One message of a bag."""

    topic: str
    kind: str
    stamp: float
    data: bytes
    publisher: int = 0


def header(seq: int, stamp: float, frame: str) -> bytes:
    sec, nsec = divmod(round(stamp * 1e9), 10**9)
    return struct.pack("<IIII", seq, sec, nsec, len(frame)) + frame.encode()


def laser(stamp: float, ranges: Sequence[float], *, topic: str = "/scan", frame: str = "laser") -> Sample:
    limits = [-0.5, -0.5 + 0.25 * (len(ranges) - 1), 0.25, 0.0, 0.1, 0.1, 10.0]
    body = struct.pack("<7f", *limits) + struct.pack("<I", len(ranges)) + np.float32(ranges).tobytes()
    return Sample(topic, SCAN, stamp, header(7, stamp, frame) + body + struct.pack("<I", 0))


def twist(stamp: float, v: float) -> Sample:
    return Sample("/cmd_vel", TWIST, stamp, struct.pack("<6d", v, 0, 0, 0, 0, 0.5))


def record(fields: Mapping[str, bytes], data: bytes, *, size: int | None = None) -> bytes:
    """A record; `size` is the stated length of its data."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    head = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data) if size is None else size) + data


def fields_of(values: Mapping[str, str]) -> bytes:
    parts = [f"{name}={value}".encode() for name, value in values.items()]
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)


def time(stamp: float) -> bytes:
    return struct.pack("<II", *divmod(round(stamp * 1e9), 10**9))


def u4(value: int) -> bytes:
    return struct.pack("<I", value)


def bag_header(index_pos: int, n_connections: int, n_chunks: int) -> bytes:
    fields = {"op": b"\x03", "index_pos": struct.pack("<Q", index_pos)}
    fields |= {"conn_count": u4(n_connections), "chunk_count": u4(n_chunks)}
    return record(fields, b" " * 100)


def connection(number: int, topic: str, kind: str) -> bytes:
    about = {"topic": topic, "type": kind, "md5sum": "0" * 32, "message_definition": "float64 x\n"}
    return record({"op": b"\x07", "conn": u4(number), "topic": topic.encode()}, fields_of(about))


def chunks_of(
    samples: Sequence[Sample], *, compression: str = "none", per_chunk: int = 10, entry: int = 12,
    order: Sequence[str] = ("op", "conn", "time"),
) -> tuple[list[bytes], list[bytes]]:  # fmt: skip
    """Return the chunks with their indexes, and the connections; `entry` is the stated size of an index entry."""
    sources = list(dict.fromkeys((sample.topic, sample.kind, sample.publisher) for sample in samples))
    known: set[int] = set()
    chunks = []
    for first in range(0, len(samples), per_chunk):
        plain, index = b"", dict[int, list[bytes]]()
        for sample in samples[first : first + per_chunk]:
            number = sources.index((sample.topic, sample.kind, sample.publisher))
            if number not in known:
                plain += connection(number, sample.topic, sample.kind)
                known.add(number)
            index.setdefault(number, []).append(time(sample.stamp) + u4(len(plain)))
            fields = {"op": b"\x02", "conn": u4(number), "time": time(sample.stamp)}
            plain += record({name: fields[name] for name in order}, sample.data)
        chunk = record(
            {"op": b"\x05", "compression": compression.encode(), "size": u4(len(plain))},
            PACKERS[compression](plain),
        )
        for number, entries in index.items():
            about = {"op": b"\x04", "ver": u4(1), "conn": u4(number), "count": u4(len(entries))}
            chunk += record(about, b"".join(entries), size=entry * len(entries))
        chunks.append(chunk)
    return chunks, [connection(i, topic, kind) for i, (topic, kind, _) in enumerate(sources)]


def bag20(
    samples: Sequence[Sample], *, is_closed: bool = True, junk: bytes = b"", **options: object
) -> bytes:
    """A bag of version 2.0; one that is not closed has no index, and its last chunk states the length 0.

    `junk` lies between the last chunk and the index.
    """
    chunks, connections = chunks_of(samples, **options)  # type: ignore[arg-type]
    start = b"#ROSBAG V2.0\n"
    if not is_closed:
        n = len(record({"op": b"\x05", "compression": b"none", "size": u4(0)}, b""))
        last = struct.unpack_from("<I", chunks[-1], n - 4)[0]
        open_chunk = record({"op": b"\x05", "compression": b"none", "size": u4(0)}, b"")
        return start + bag_header(0, 0, 0) + b"".join(chunks[:-1]) + open_chunk + chunks[-1][n : n + last]
    index_pos = len(start) + len(bag_header(0, 0, 0)) + sum(map(len, chunks))
    index_pos += len(junk)
    head = bag_header(index_pos, len(connections), len(chunks))
    infos, at = [], len(start) + len(head)
    for chunk in chunks:
        about = {"op": b"\x06", "ver": u4(1), "chunk_pos": struct.pack("<Q", at), "count": u4(0)}
        infos.append(record(about, b""))
        at += len(chunk)
    return b"".join([start, head, *chunks, junk, *connections, *infos])


def bag12(samples: Sequence[Sample], *, with_header: bool = True) -> bytes:
    """A bag of version 1.2: definitions and messages without chunks."""
    out = [b"#ROSRECORD V1.2\n" if not with_header else b"#ROSBAG V1.2\n"]
    out += [record({"op": b"\x03", "index_pos": struct.pack("<Q", 0)}, b" " * 50)] if with_header else []
    known: set[str] = set()
    for sample in samples:
        about = {"topic": sample.topic.encode(), "md5": b"0" * 32, "type": sample.kind.encode()}
        if sample.topic not in known:
            out.append(record({"op": b"\x01", **about, "def": b"float64 x\n"}, b""))
            known.add(sample.topic)
        sec, nsec = divmod(round(sample.stamp * 1e9), 10**9)
        out.append(record({"op": b"\x02", **about, "sec": u4(sec), "nsec": u4(nsec)}, sample.data))
    return b"".join(out)


def drive(n: int = 25) -> list[Sample]:
    """Scans whose first range counts them, and commands."""
    out = []
    for i in range(n):
        out += [laser(1e9 + i / 10, [1 + i / 100, 2, 3, 4, 5]), twist(1e9 + i / 10 + 0.01, 0.1 * i)]
    return out
