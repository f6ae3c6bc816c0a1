"""Containers of logs: ROS 1 bags, rosbag2 files and folders, MCAP, CARMEN text; none of them by our own writer."""

from __future__ import annotations

import bz2
import gzip
import shutil
import sqlite3
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from benchmarks.fuzz.structure.bag1 import Style, bag12, bag20
from benchmarks.fuzz.structure.carmen import carmen
from benchmarks.fuzz.structure.draft import Draft, Item
from benchmarks.fuzz.structure.packing import definition, full, nanoseconds, payload

Container = Callable[[Draft, Path], Path]
"""(log, folder) -> the path that a user gives to a command."""


def _bytes(name: str, make: Callable[[Draft], bytes]) -> Container:
    def write(draft: Draft, folder: Path) -> Path:
        path = folder / name
        path.write_bytes(make(draft))
        return path

    return write


def _bag(**style: object) -> Container:
    return _bytes("log.bag", lambda draft: bag20(draft, Style(**style)))  # type: ignore[arg-type]


def write_sqlite(
    path: Path, draft: Draft, items: list[Item], *, schema: int = 3, packed: bool = False
) -> None:
    """Write a .db3; `schema` 1 has no quality of service, 4 has hashes and definitions."""
    pack = zstandard.ZstdCompressor().compress if packed else bytes
    columns = (
        "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL"
    )
    columns += ", offered_qos_profiles TEXT NOT NULL" if schema >= 3 else ""
    columns += ", type_description_hash TEXT NOT NULL" if schema >= 4 else ""
    with closing(sqlite3.connect(path)) as base:
        if schema >= 3:
            base.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
            base.execute("INSERT INTO schema VALUES(?, 'iron')", (schema,))
        if schema >= 4:
            base.execute(
                "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL)"
            )
            base.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL, "
                "encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)"
            )
        base.execute(f"CREATE TABLE topics({columns})")
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        base.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        sources = draft.sources
        more = [""] * (schema >= 3) + ["RIHS01_0"] * (schema >= 4)
        for i, (topic, kind) in enumerate(sources):
            row = (i + 1, topic, full(kind), "cdr", *more)
            base.execute(f"INSERT INTO topics VALUES({','.join('?' * len(row))})", row)
        number = {source: i + 1 for i, source in enumerate(sources)}
        base.executemany(
            "INSERT INTO messages VALUES(NULL, ?, ?, ?)",
            (
                (number[item.topic, item.kind], nanoseconds(item.log), pack(payload(item, ros1=False)))
                for item in items
            ),
        )
        base.commit()


def _mcap(
    path: Path,
    draft: Draft,
    items: list[Item],
    *,
    ros1: bool = False,
    packed: bool = False,
    **options: object,
) -> None:
    pack = zstandard.ZstdCompressor().compress if packed else bytes
    with path.open("wb") as file:
        writer = Writer(file, **options)  # type: ignore[arg-type]
        writer.start(profile="ros1" if ros1 else "ros2", library="another")
        channels: dict[tuple[str, str], int] = {}
        for topic, kind in draft.sources:
            text, _ = definition(kind, draft.definitions.get(kind, ""), ros1=ros1)
            schema = writer.register_schema(
                full(kind, ros1=ros1), "ros1msg" if ros1 else "ros2msg", text.encode()
            )
            encoding = "ros1" if ros1 else "cdr"
            channels[topic, kind] = writer.register_channel(topic, encoding, schema)
        for item in items:
            at = nanoseconds(item.log)
            writer.add_message(channels[item.topic, item.kind], at, pack(payload(item, ros1=ros1)), at)
        writer.finish()


def _single(suffix: str, **options: object) -> Container:
    def write(draft: Draft, folder: Path) -> Path:
        path = folder / f"log{suffix}"
        (_mcap if suffix == ".mcap" else write_sqlite)(path, draft, draft.items, **options)  # type: ignore[operator]
        return path

    return write


def _wal(draft: Draft, folder: Path) -> Path:
    path = _single(".db3")(draft, folder)
    raw = bytearray(path.read_bytes())
    raw[18:20] = b"\2\2"  # read and write version of the file format
    path.write_bytes(raw)
    return path


def _no_summary(draft: Draft, folder: Path) -> Path:
    off = {
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    }
    return _single(".mcap", index_types=IndexType.NONE, **off)(draft, folder)


def _metadata(
    draft: Draft, names: list[str], storage: str, *, version: int, mode: str = "", count: int | None = None
) -> str:
    """Return the text of a metadata.yaml."""
    counts = Counter((item.topic, item.kind) for item in draft.items)
    topics = [
        {
            "topic_metadata": {
                "name": topic, "type": full(kind), "serialization_format": "cdr", "offered_qos_profiles": "",
            },
            "message_count": counts[topic, kind],
        }
        for topic, kind in draft.sources
    ]  # fmt: skip
    stamps = [nanoseconds(item.log) for item in draft.items] or [0]
    information = {
        "version": version, "storage_identifier": storage, "duration": {"nanoseconds": max(stamps) - min(stamps)},
        "starting_time": {"nanoseconds_since_epoch": min(stamps)},
        "message_count": len(draft.items) if count is None else count, "topics_with_message_count": topics,
        "compression_format": "zstd" if mode else "", "compression_mode": mode, "relative_file_paths": names,
    }  # fmt: skip
    return yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)


def _folder(
    storage: str = "sqlite3", *, version: int = 5, parts: int = 1, mode: str = "", stated: str | None = None,
    metadata: bool = True, renamed: bool = False, missing: int = 0,
) -> Container:  # fmt: skip
    """Return a writer of a rosbag2 folder; `stated` is the storage in its metadata, `missing` are messages not counted."""

    def write(draft: Draft, folder: Path) -> Path:
        bag = folder / "log"
        bag.mkdir()
        suffix = ".mcap" if storage == "mcap" else ".db3"
        names = []
        edges = np.linspace(0, len(draft.items), parts + 1).astype(int)
        for i, (a, b) in enumerate(pairwise(edges)):
            path = bag / f"log_{i}{suffix}"
            (_mcap if storage == "mcap" else write_sqlite)(
                path, draft, draft.items[a:b], packed=mode == "MESSAGE"
            )  # type: ignore[operator]
            if mode == "FILE":
                packed = path.with_name(path.name + ".zstd")
                packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
                path.unlink()
                path = packed
            names.append(path.name)
        count = len(draft.items) - missing
        text = _metadata(
            draft, names, storage if stated is None else stated, version=version, mode=mode, count=count
        )
        if metadata:
            (bag / "metadata.yaml").write_text(text)
        if renamed:
            for i, name in enumerate(names):
                (bag / name).rename(bag / f"kitchen_{i}{suffix}")
        return bag

    return write


def _packed_text(name: str, pack: Callable[[bytes], bytes], **style: str) -> Container:
    return _bytes(name, lambda draft: pack(carmen(draft, **style).encode()))


CONTAINERS: dict[str, Container] = {
    "bag": _bag(),
    "bag_bz2": _bag(compression="bz2"),
    "bag_lz4": _bag(compression="lz4"),
    "bag_small_chunks": _bag(per_chunk=7),
    "bag_of_2010": _bag(index_entry=20, order=("conn", "op", "time")),
    "bag_without_index": _bag(is_closed=False),
    "bag_12": _bytes("log.bag", bag12),
    "db3": _single(".db3"),
    "db3_wal": _wal,
    "db3_schema_1": _single(".db3", schema=1),
    "db3_schema_4": _single(".db3", schema=4),
    "db3_packed_messages": _single(".db3", packed=True),
    "mcap": _single(".mcap"),
    "mcap_lz4": _single(".mcap", compression=CompressionType.LZ4),
    "mcap_plain": _single(".mcap", use_chunking=False),
    "mcap_small_chunks": _single(".mcap", chunk_size=5000, enable_data_crcs=True),
    "mcap_without_summary": _no_summary,
    "mcap_ros1": _single(".mcap", ros1=True),
    "folder": _folder(),
    "folder_mcap": _folder("mcap", version=9),
    "folder_split": _folder(parts=4),
    "folder_mcap_split": _folder("mcap", parts=3, version=8),
    "folder_packed_file": _folder(mode="FILE", parts=2),
    "folder_mcap_packed_file": _folder("mcap", mode="FILE"),
    "folder_packed_messages": _folder(mode="MESSAGE"),
    "folder_version_1": _folder(version=1),
    "folder_without_metadata": _folder(metadata=False),
    "folder_mcap_without_metadata": _folder("mcap", metadata=False, parts=2),
    "folder_renamed": _folder(renamed=True),
    "folder_without_storage": _folder("mcap", stated=""),
    "folder_wrong_storage": _folder("mcap", stated="sqlite3"),
    "folder_wrong_count": _folder(missing=37),
    "carmen": _packed_text("log.log", bytes),
    "carmen_gz": _packed_text("log.log.gz", partial(gzip.compress, mtime=0)),
    "carmen_bz2": _packed_text("log.clf.bz2", bz2.compress),
    "carmen_robotlaser": _packed_text("log.log", bytes, words="ROBOTLASER1"),
    "carmen_host_last": _packed_text("log.log", bytes, trailer="host_last"),
    "carmen_time_only": _packed_text("log.log", bytes, trailer="time_only"),
    "carmen_no_trailer": _packed_text("log.log", bytes, trailer="none"),
    "carmen_ranges_alone": _packed_text("log.log", bytes, trailer="ranges_alone"),
    "carmen_raw": _packed_text("log.log", bytes, words="RAWLASER1"),
}
"""Name -> writer."""
PLAIN = ("bag", "db3", "mcap", "folder")
"""Containers of logs whose odd thing is another one."""


def write(draft: Draft, folder: Path) -> Path:
    """Write a log into a folder; return what is given to the commands."""
    draft.items.sort(key=lambda item: item.arrival)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return CONTAINERS[draft.container](draft, folder)
