"""Read ROS bags: rosbag2 folders (mcap, sqlite3, compressed), single .db3 files, and ROS 1 bags."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from logs.errors import LogError
from logs.formats import rosbag1, sqlite_bag
from logs.formats.bag_folder import STORES, files_of, logs_in, plain, storage_of
from logs.inflation import LZ4_MAGIC, ZSTD_MAGIC, most_plain, unpack
from logs.ros.cdr import Messages
from logs.ros.interpret import to_run
from logs.ros.recording import Recording, Topic
from logs.run import Run
from logs.types import Progress, ReadOptions

PACKED = (ZSTD_MAGIC, LZ4_MAGIC)
"""First bytes of a compressed message; those of a plain one are 00 01 or 00 00."""


def matches(path: Path, head: bytes) -> bool:
    """Return whether a path is a folder with bag files or with a metadata.yaml, a .db3 file or a ROS 1 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or bool(logs_in(path))
    return head.startswith((sqlite_bag.MAGIC, *rosbag1.MAGICS))


def read(path: Path, how: ReadOptions) -> Run:
    """Read a run from a bag.

    Raises
    ------
    LogError
        If the bag is damaged, incomplete, in an unknown storage format, or without scans.
    """
    return to_run(load(path, how.progress), path.name, how)


def load(path: Path, progress: Progress | None = None) -> Recording:
    """Read the messages of a bag of any kind."""
    if path.is_dir():
        return _folder(path, progress)
    storage = storage_of(path)
    assert storage is not None, path
    recording = STORES[storage].load(path, progress)
    recording.again = partial(_messages, (path,), storage)
    _unpack_messages(recording, path, most_plain(path.stat().st_size))
    return recording


def _folder(path: Path, progress: Progress | None) -> Recording:
    """Read a folder: the files of its bag, in order."""
    bag = files_of(path)
    recording = Recording(format="")
    for file in bag.files:
        with plain(file) as copy:
            _merge(recording, STORES[bag.storage].load(copy, progress))
        is_packed = copy != file
    is_packed |= _unpack_messages(
        recording,
        path,
        most_plain(sum(file.stat().st_size for file in bag.files)),
        is_stated=bag.is_compressed,
    )
    name = bag.storage if bag.storage == "rosbag1" else f"rosbag2, {bag.storage}"
    recording.format = name + (", compressed" if is_packed else "")
    recording.notes = [*bag.notes, *recording.notes]
    recording.again = partial(_messages, bag.files, bag.storage)
    found = sum(topic.n_messages for topic in recording.topics.values())
    if bag.n_stated not in (None, found):
        recording.notes.append(
            f"metadata.yaml states {bag.n_stated} messages, the files hold {found}, all were read"
        )
    return recording


def _messages(files: tuple[Path, ...], storage: str, topic: str) -> Iterator[tuple[int, bytes | memoryview]]:
    """Read the messages of one topic again; a compressed message is decompressed."""
    for file in files:
        with plain(file) as copy:
            most = most_plain(file.stat().st_size)
            for at, payload in STORES[storage].messages(copy, topic):
                is_packed = bytes(payload[:4]) in PACKED
                yield at, unpack(bytes(payload), most) if is_packed else payload


def _unpack_messages(recording: Recording, path: Path, most: int, *, is_stated: bool = False) -> bool:
    """Decompress individually compressed messages, in place; return whether there are any.

    Parameters
    ----------
    most : [bytes] Limit of their total size.
    is_stated : Whether the metadata states that messages are compressed. Otherwise, the first bytes of messages decide.
    """
    any_packed = is_stated
    for topic in recording.topics.values():
        first = next(iter(topic.payloads), b"")
        if topic.encoding != "cdr" or not (is_stated or first.startswith(PACKED)):
            continue
        any_packed, unpacked = True, Messages()
        for i, payload in enumerate(topic.payloads):
            try:
                unpacked.append(data := unpack(payload, most))
            except ValueError as exc:
                raise LogError(
                    f"{path}: message {i} of {topic.name} cannot be decompressed ({exc}); copy the bag again"
                ) from exc
            most -= len(data)
        topic.payloads = unpacked
    return any_packed


def _merge(recording: Recording, more: Recording) -> None:
    recording.attachments |= more.attachments
    recording.metadata |= more.metadata
    recording.notes += more.notes
    for name, topic in more.topics.items():
        known = recording.topics.setdefault(name, Topic(name, topic.type, topic.encoding))
        known.n_messages += topic.n_messages
        known.log_times += topic.log_times
        known.payloads.take(topic.payloads)
