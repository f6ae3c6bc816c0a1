"""Containers of logs: bags and rosbag2 folders by rosbags, MCAP files by mcap, CARMEN text; none of them by our own writer."""

from __future__ import annotations

import bz2
import gzip
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.writer import CompressionType, IndexType, Writer
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from benchmarks.fuzz.structure.carmen import carmen
from benchmarks.fuzz.structure.draft import Draft, Item, Laser
from benchmarks.fuzz.structure.packing import definition, full, nanoseconds, payload

Container = Callable[[Draft, Path], Path]
"""(log, folder) -> the path that a user gives to a command."""


def _fill(writer: Any, draft: Draft, items: Sequence[Item], digest: str) -> None:
    """Write messages with a writer of rosbags, whose name of a digest tells the version of ROS."""
    ros1 = digest == "md5sum"
    links = {}
    for topic, kind in draft.sources:
        text, sum_of_text = definition(kind, draft.definitions.get(kind, ""), ros1=ros1)
        links[topic, kind] = writer.add_connection(topic, full(kind), msgdef=text, **{digest: sum_of_text})
    for item in items:
        writer.write(links[item.topic, item.kind], nanoseconds(item.log), payload(item, ros1=ros1))


def write_bag(path: Path, draft: Draft, *, compression: str = "", chunk: int = 1 << 20) -> None:
    """Write a ROS 1 bag with chunks of some bytes, compressed by bz2, lz4 or not."""
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(writer.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk
    with writer:
        _fill(writer, draft, draft.items, "md5sum")


def write_file(
    path: Path, draft: Draft, items: Sequence[Item] | None = None, *, mode: str = "NONE", version: int = 9
) -> dict[str, Any]:
    """Write a file of rosbag2, .db3 or .mcap, whose messages or which itself may be compressed; return its metadata."""
    storage = StoragePlugin.MCAP if ".mcap" in path.suffixes else StoragePlugin.SQLITE3
    bag = path.with_name(f"{path.name}.bag")
    writer = rosbag2.Writer(bag, version=version, storage_plugin=storage)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        _fill(writer, draft, draft.items if items is None else items, "rihs01")
    about = yaml.safe_load((bag / "metadata.yaml").read_text())
    (file,) = (file for file in bag.iterdir() if file.name != "metadata.yaml")
    file.replace(path)
    shutil.rmtree(bag)
    return dict(about)


def write_mcap(path: Path, draft: Draft, *, ros1: bool = False, **options: Any) -> None:
    """Write an MCAP file with some options of its writer."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros1" if ros1 else "ros2", library="another")
        channels = {}
        for topic, kind in draft.sources:
            text, _ = definition(kind, draft.definitions.get(kind, ""), ros1=ros1)
            form, encoding = ("ros1msg", "ros1") if ros1 else ("ros2msg", "cdr")
            schema = writer.register_schema(full(kind, ros1=ros1), form, text.encode())
            channels[topic, kind] = writer.register_channel(topic, encoding, schema)
        for item in draft.items:
            at = nanoseconds(item.log)
            writer.add_message(channels[item.topic, item.kind], at, payload(item, ros1=ros1), at)
        writer.finish()


def _one(name: str, make: Callable[..., object], **options: Any) -> Container:
    """Return a writer of one file."""

    def write(draft: Draft, folder: Path) -> Path:
        made = make(folder / name, draft, **options)
        if isinstance(made, bytes):
            (folder / name).write_bytes(made)
        return folder / name

    return write


def _wal(draft: Draft, folder: Path) -> Path:
    path = _one("log.db3", write_file)(draft, folder)
    raw = bytearray(path.read_bytes())
    raw[18:20] = b"\2\2"  # read and write version of the file format
    path.write_bytes(raw)
    return path


def _folder(
    suffix: str = ".db3", *, parts: int = 1, mode: str = "NONE", name: str = "log", metadata: bool = True, **stated: Any
) -> Container:  # fmt: skip
    """Return a writer of a rosbag2 folder; `stated` is in its metadata, `name` is what its files are called meanwhile."""

    def write(draft: Draft, folder: Path) -> Path:
        bag = folder / "log"
        bag.mkdir()
        end = suffix + ".zstd" * (mode == "FILE")
        edges = np.linspace(0, len(draft.items), parts + 1).astype(int)
        for i, (a, b) in enumerate(pairwise(edges)):
            about = write_file(bag / f"{name}_{i}{end}", draft, draft.items[a:b], mode=mode)
        known = about["rosbag2_bagfile_information"]
        known |= {
            "message_count": len(draft.items),
            "relative_file_paths": [f"log_{i}{end}" for i in range(parts)],
        }
        if metadata:
            (bag / "metadata.yaml").write_text(
                yaml.safe_dump({"rosbag2_bagfile_information": known | stated})
            )
        return bag

    return write


def _text(name: str, pack: Callable[[bytes], bytes] = bytes, **style: str) -> Container:
    return _one(name, lambda _, draft: pack(carmen(draft, **style).encode()))


NO_SUMMARY = dict.fromkeys(
    ("use_statistics", "use_summary_offsets", "repeat_channels", "repeat_schemas"), False
)
CONTAINERS: dict[str, Container] = {
    "bag": _one("log.bag", write_bag),
    "bag_bz2": _one("log.bag", write_bag, compression="bz2"),
    "bag_lz4": _one("log.bag", write_bag, compression="lz4"),
    "bag_small_chunks": _one("log.bag", write_bag, chunk=5000),
    "db3": _one("log.db3", write_file),
    "db3_wal": _wal,
    "db3_packed_messages": _one("log.db3", write_file, mode="MESSAGE", version=8),
    "mcap": _one("log.mcap", write_mcap),
    "mcap_lz4": _one(
        "log.mcap", write_mcap, compression=CompressionType.LZ4, chunk_size=5000, enable_data_crcs=True
    ),
    "mcap_plain": _one("log.mcap", write_mcap, use_chunking=False),
    "mcap_without_summary": _one("log.mcap", write_mcap, index_types=IndexType.NONE, **NO_SUMMARY),
    "mcap_ros1": _one("log.mcap", write_mcap, ros1=True),
    "folder": _folder(),
    "folder_split": _folder(parts=4),
    "folder_mcap_split": _folder(".mcap", parts=3),
    "folder_packed_file": _folder(mode="FILE", parts=2),
    "folder_mcap_packed_file": _folder(".mcap", mode="FILE"),
    "folder_packed_messages": _folder(mode="MESSAGE"),
    "folder_without_metadata": _folder(".mcap", metadata=False, parts=2),
    "folder_renamed": _folder(name="kitchen"),
    "folder_without_storage": _folder(".mcap", storage_identifier=""),
    "folder_wrong_count": _folder(message_count=37),
    "carmen": _text("log.log"),
    "carmen_gz": _text("log.log.gz", partial(gzip.compress, mtime=0)),
    "carmen_bz2": _text("log.clf.bz2", bz2.compress),
    "carmen_robotlaser": _text("log.log", words="ROBOTLASER1"),
    "carmen_host_last": _text("log.log", trailer="host_last"),
    "carmen_time_only": _text("log.log", trailer="time_only"),
    "carmen_no_trailer": _text("log.log", trailer="none"),
    "carmen_ranges_alone": _text("log.log", trailer="ranges_alone"),
    "carmen_raw": _text("log.log", words="RAWLASER1"),
}
"""Name -> writer."""
PLAIN = ("bag", "db3", "mcap", "folder")
"""Containers of logs whose odd thing is another one."""
ALONE = {"lacks": ("odom",), "gauges": ("lever", "yaw")}
TEXTS: dict[str, dict[str, Any]] = {
    name: ALONE if name in ("carmen_ranges_alone", "carmen_raw") else {}
    for name in CONTAINERS
    if "carmen" in name
}
"""Containers of text -> what is true of the logs in them."""
CARMEN_LASER = (Laser(sweep=0, first=-90, n=180), Laser(sweep=0, first=-90, n=181))


def write(draft: Draft, folder: Path) -> Path:
    """Write a log into a folder; return what is given to the commands."""
    draft.items.sort(key=lambda item: item.arrival)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return CONTAINERS[draft.container](draft, folder)
