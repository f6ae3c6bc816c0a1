"""Read ROS bags: rosbag2 folders (mcap, sqlite3, compressed), single .db3 files, and ROS 1 bags."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from logs.errors import LogError
from logs.formats import mcap_file
from logs.inflation import BZIP2_MAGIC, LZ4_MAGIC, most_plain, unpack
from logs.ros.cdr import Messages
from logs.ros.definitions import typestore
from logs.ros.interpret import to_run
from logs.ros.recording import ENCODINGS, KEPT_TYPES, Recording, Topic, full_type
from logs.run import Run
from logs.types import Mounts, Progress
from logs.yaml_text import parse_yaml

ALLOW_OUTSIDE = "SENSORGRAPH_ALLOW_OUTSIDE"
"""Environment variable; 1 allows files outside the folder of a bag or a map."""
MAX_NAME = 1000
"""[characters] maximum length of a file name; the rest is ignored."""
SQLITE_MAGIC, ROS1_MAGIC = b"SQLite format 3\x00", b"#ROSBAG V"


def matches(path: Path, head: bytes) -> bool:
    """Return whether a path is a rosbag2 folder, a .db3 file or a ROS 1 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return head.startswith((SQLITE_MAGIC, ROS1_MAGIC))


def read(
    path: Path,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
    no_return: str | None = None,
    mounts: Mounts | None = None,
) -> Run:
    """Read a run from a bag.

    Raises
    ------
    LogError
        If the bag is damaged, incomplete, in an unknown storage format, or without scans.
    """
    return to_run(load(path, progress), path.name, topics, no_return, mounts)


def load(path: Path, progress: Progress | None = None) -> Recording:
    """Read the messages of a bag of any kind."""
    if path.is_dir():
        return _folder(path, progress)
    with path.open("rb") as file:
        is_sqlite = file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
    return _sqlite([path], progress) if is_sqlite else _by_rosbags(path, "rosbag1", progress)


def _folder(path: Path, progress: Progress | None) -> Recording:
    """Read a rosbag2 folder: the files listed in its metadata.yaml, in order."""
    about = _metadata(path)
    files = _listed(path, about)
    absent = [file.name for file in files if not file.is_file()]
    if absent or not files:
        what = f"lists {', '.join(absent)}, which {'is' if len(absent) == 1 else 'are'} missing"
        raise LogError(
            f"{path / 'metadata.yaml'} {what if absent else 'lists no files'}; copy the complete folder"
        )
    storage = about.get("storage_identifier")
    if storage not in ("mcap", "sqlite3"):
        raise LogError(
            f"{path} has the storage {str(storage)[:40]}, expected mcap or sqlite3; convert it with `ros2 bag convert`"
        )
    mode = str(about.get("compression_mode") or "none").lower()
    if mode == "file":
        with TemporaryDirectory() as plain:
            recording = _stored(_unpacked(files, Path(plain)), storage, progress)
    else:
        recording = _stored(files, storage, progress)
    if mode == "message":
        _unpack_messages(recording, path, most_plain(sum(file.stat().st_size for file in files)))
    if mode != "none":
        recording.format += ", compressed"
    claimed = about.get("message_count")
    found = sum(topic.n_messages for topic in recording.topics.values())
    if isinstance(claimed, int) and claimed != found:
        raise LogError(
            f"{path} holds {found} messages, but its metadata.yaml states {claimed}; check that the copy is complete"
        )
    return recording


def _listed(path: Path, about: Mapping[str, Any]) -> list[Path]:
    """Return the files listed in metadata.yaml; files outside the folder are rejected."""
    names = about.get("relative_file_paths") or []
    if not isinstance(names, list):
        raise LogError(
            f"{path / 'metadata.yaml'}: relative_file_paths is not a list; copy the complete folder"
        )
    files = [path / str(name)[:MAX_NAME] for name in names]
    outside = [file for file in files if not file.resolve().is_relative_to(path.resolve())]
    if outside and os.environ.get(ALLOW_OUTSIDE) != "1":
        raise LogError(
            f"{path / 'metadata.yaml'} lists {outside[0]}, outside its folder; copy the file into the folder, or, if "
            f"you trust the bag, set {ALLOW_OUTSIDE}=1"
        )
    return files


def _stored(files: list[Path], storage: str, progress: Progress | None) -> Recording:
    """Read the files of a folder, in order."""
    if storage == "sqlite3":
        return _sqlite(files, progress)
    recording = Recording(format="rosbag2, mcap")
    for file in files:
        _merge(recording, mcap_file.load(file, progress))
    return recording


def _unpacked(files: list[Path], folder: Path) -> list[Path]:
    """Decompress whole files, NAME.zstd to NAME."""
    plain = []
    for file in files:
        data = file.read_bytes()
        plain.append(folder / (file.stem if file.suffix in (".zstd", ".zst") else file.name))
        try:
            plain[-1].write_bytes(unpack(data, most_plain(len(data))))
        except ValueError as exc:
            raise LogError(f"{file} cannot be decompressed ({exc}); copy it again") from exc
    return plain


def _unpack_messages(recording: Recording, path: Path, most: int) -> None:
    """Decompress individually compressed messages, in place; `most` [bytes] limits their total size."""
    for topic in recording.topics.values():
        plain = Messages()
        for i, payload in enumerate(topic.payloads):
            try:
                plain.append(data := unpack(payload, most))
            except ValueError as exc:
                raise LogError(
                    f"{path}: message {i} of {topic.name} cannot be decompressed ({exc}); copy the bag again"
                ) from exc
            most -= len(data)
        topic.payloads = plain


def _metadata(path: Path) -> dict[str, Any]:
    try:
        about = parse_yaml((path / "metadata.yaml").read_text(errors="replace"))
        about = about["rosbag2_bagfile_information"]
        if not isinstance(about, dict):
            raise TypeError("not a mapping")
    except (KeyError, TypeError, ValueError) as exc:
        raise LogError(
            f"{path / 'metadata.yaml'} is not a rosbag2 file ({' '.join(str(exc).split())[:80]}); "
            "expected rosbag2_bagfile_information, rebuild it with `ros2 bag reindex`"
        ) from exc
    return about


def _merge(recording: Recording, more: Recording) -> None:
    recording.attachments |= more.attachments
    recording.metadata |= more.metadata
    for name, topic in more.topics.items():
        known = recording.topics.setdefault(name, Topic(name, topic.type, topic.encoding))
        known.n_messages += topic.n_messages
        known.log_times += topic.log_times
        known.payloads.take(topic.payloads)


def _sqlite(files: list[Path], progress: Progress | None) -> Recording:
    """Read the sqlite3 files of rosbag2."""
    recording = Recording(format="rosbag2, sqlite3")
    for file in files:
        try:
            with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as base:
                _sqlite_file(base, recording, progress)
        except (sqlite3.Error, UnicodeDecodeError) as exc:
            raise LogError(
                f"{file} is damaged or not a rosbag2 file ({exc}); save the intact messages: "
                f"sqlite3 {file} .recover | sqlite3 {file.with_name(file.stem + '.recovered.db3')}"
            ) from exc
    return recording


def _sqlite_file(base: sqlite3.Connection, recording: Recording, progress: Progress | None) -> None:
    views = base.execute("SELECT name FROM sqlite_master WHERE type IN ('view', 'trigger')").fetchone()
    if views is not None:
        raise sqlite3.DatabaseError(f"it holds a view or trigger, {views[0]!s:.40}, which a bag never does")
    damage = base.execute("PRAGMA quick_check(1)").fetchone()[0]
    if damage != "ok":
        raise sqlite3.DatabaseError(" ".join(str(damage).split()))
    topics: dict[int, Topic] = {}
    for row in base.execute("SELECT id, name, type, serialization_format FROM topics"):
        if not (isinstance(row[0], int) and all(isinstance(text, str) for text in row[1:])):
            raise sqlite3.DatabaseError(f"a topic is {str(row)[:80]}, expected a number and three texts")
        key, name, kind, encoding = row
        topics[key] = recording.topics.setdefault(name, Topic(name, full_type(kind), encoding))
    (total,) = base.execute("SELECT count(*) FROM messages").fetchone()
    kept = [key for key, topic in topics.items() if topic.type in KEPT_TYPES and topic.encoding in ENCODINGS]
    kept_keys, marks = set(kept), ",".join("?" * len(kept))
    query = f"SELECT topic_id, timestamp, CASE WHEN topic_id IN ({marks}) THEN data END FROM messages ORDER BY timestamp, id"
    for done, (key, stamp, data) in enumerate(base.execute(query, kept)):
        if key not in topics or not isinstance(stamp, int) or not isinstance(data, bytes | None):
            raise sqlite3.DatabaseError(f"message {done} has topic {key!r:.20} and time {stamp!r:.20}")
        topic = topics[key]
        topic.n_messages += 1
        topic.log_times.append(stamp)
        if key in kept_keys:
            topic.payloads.append(data or b"")
        if progress is not None and done % 512 == 0:
            progress(done, total)


def _by_rosbags(path: Path, kind: str, progress: Progress | None) -> Recording:
    """Read with the rosbags library, which supports ROS 1."""
    from rosbags.highlevel import AnyReader

    recording = Recording(format=kind)
    encoding = "ros1" if kind == "rosbag1" else "cdr"
    try:
        with AnyReader([path], default_typestore=typestore()) as reader:
            for connection in reader.connections:
                name = connection.topic
                topic = recording.topics.setdefault(
                    name, Topic(name, full_type(connection.msgtype), encoding)
                )
                topic.n_messages += connection.msgcount
            total = reader.message_count
            cap_chunks(reader, path.stat().st_size)
            kept = [c for c in reader.connections if full_type(c.msgtype) in KEPT_TYPES]
            for done, (connection, stamp, raw) in enumerate(reader.messages(kept) if kept else ()):
                topic = recording.topics[connection.topic]
                topic.log_times.append(stamp)
                topic.payloads.append(bytes(raw))
                if progress is not None and done % 512 == 0:
                    progress(done, total)
    except OSError:
        raise
    except Exception as exc:  # rosbags raises many kinds of errors for a damaged file, also from its asserts
        why = " ".join(str(exc).split()) or type(exc).__name__
        cure = f"`rosbag reindex {path}`" if kind == "rosbag1" else f"`ros2 bag reindex {path}`"
        raise LogError(f"{path} is damaged ({why[:120]}); try {cure}, or copy it again") from exc
    for topic in recording.topics.values():
        if topic.payloads and len(topic.payloads) != topic.n_messages:
            raise LogError(
                f"{path}: {topic.name} holds {len(topic.payloads)} messages, but its index states {topic.n_messages}; "
                f"the bag is damaged, copy it again or use `rosbag reindex {path}`"
            )
    return recording


def cap_chunks(reader: Any, stored: int) -> None:
    """Limit the decompressed size of the chunks of a ROS 1 bag to that allowed for `stored` bytes."""
    most, sizes = most_plain(stored), dict[int, int]()

    def inflate(at: int, data: bytes) -> bytes:
        if not data.startswith((BZIP2_MAGIC, LZ4_MAGIC)):
            return data
        plain = unpack(
            data, most - sum(sizes.values()) + sizes.get(at, 0)
        )  # a chunk may be read several times
        sizes[at] = len(plain)
        return plain

    for bag in reader.readers:
        bag.chunks = {
            at: chunk._replace(decompressor=partial(inflate, at)) for at, chunk in bag.chunks.items()
        }
