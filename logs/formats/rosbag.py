"""Read ROS bags: rosbag2 folders (mcap, sqlite3, compressed), single .db3 files, and ROS 1 bags.

The files of a folder are checked against its metadata.yaml, which may be absent or wrong.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from logs.errors import LogError
from logs.formats import mcap_file, rosbag1, sqlite_bag
from logs.inflation import LZ4_MAGIC, ZSTD_MAGIC, most_plain, unpack, unpack_start
from logs.mcap.records import MAGIC
from logs.ros.cdr import Messages
from logs.ros.interpret import to_run
from logs.ros.recording import Recording, Topic
from logs.run import Run
from logs.types import Progress, ReadOptions
from logs.yaml_text import parse_yaml

ALLOW_OUTSIDE = "SENSORGRAPH_ALLOW_OUTSIDE"
"""Environment variable; 1 allows files outside the folder of a bag or a map."""
MAX_NAME = 1000
"""[characters] maximum length of a file name; the rest is ignored."""
HEAD_SIZE = 64
"""[bytes] of a file that determine its storage."""
PACKED_HEAD_SIZE = 1 << 18
"""[bytes] of a compressed file that yield them: zstd compresses blocks of 128 KiB."""


class Store(NamedTuple):
    """How the files of one storage are read."""

    load: Callable[[Path, Progress | None], Recording]
    messages: Callable[[Path, str], Iterator[tuple[int, bytes | memoryview]]]
    """Read log time [ns] and payload of each message of one topic."""


STORES = {
    "mcap": Store(mcap_file.load, mcap_file.messages),
    "sqlite3": Store(sqlite_bag.load, sqlite_bag.messages),
    "rosbag1": Store(rosbag1.load, rosbag1.messages),
}
_MAGICS = {"mcap": (MAGIC,), "sqlite3": (sqlite_bag.MAGIC,), "rosbag1": rosbag1.MAGICS}
_ENDS = re.compile(r"(\.(zstd|zst|mcap|db3|bag|active))+$")
_PART = re.compile(r"(?:_\d{4}(?:-\d\d){5})?_(\d+)$")
"""The number of a part, after the start time that `rosbag record --split` writes into each name."""


@dataclass(frozen=True)
class BagFiles:
    """The files of a bag, in order."""

    files: tuple[Path, ...]
    storage: str
    """One of `STORES`."""
    is_compressed: bool
    """Whether the metadata states that messages are compressed one by one."""
    n_stated: int | None
    """Number of messages according to the metadata."""
    notes: tuple[str, ...]


def storage_of(file: Path) -> str | None:
    """Return the storage of a file from its first bytes, also of a compressed one; None: it is no part of a bag."""
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD_SIZE)
            if head.startswith(ZSTD_MAGIC):
                head = unpack_start(head + stream.read(PACKED_HEAD_SIZE), HEAD_SIZE)
    except PermissionError:  # another file of the folder may be private
        return None
    return next((name for name, magics in _MAGICS.items() if head.startswith(magics)), None)


def logs_in(folder: Path) -> list[list[Path]]:
    """Return the logs in a folder: files of one storage whose names differ only in the number of the part, in order."""
    groups: dict[tuple[str, str], list[Path]] = {}
    stored = {file: storage_of(file) for file in sorted(folder.iterdir()) if file.is_file()}
    names = [file.name for file, storage in stored.items() if storage is not None]
    for file, storage in stored.items():
        is_derived = any(file.name.startswith(f"{name}.") for name in names)  # such as NAME.located.mcap
        if storage is not None and not is_derived:
            groups.setdefault((storage, _PART.sub("", _ENDS.sub("", file.name))), []).append(file)
    return [sorted(files, key=_part_number) for files in groups.values()]


def _part_number(file: Path) -> int:
    found = _PART.search(_ENDS.sub("", file.name))
    return int(found[1]) if found else -1


def files_of(folder: Path) -> BagFiles:
    """Return the files of a bag: those listed in its metadata.yaml, otherwise the only log in the folder.

    Raises
    ------
    LogError
        If a listed file is missing or outside the folder, or the folder holds no log, or several.
    """
    about, fault = _metadata(folder)
    found = logs_in(folder)
    listed = _listed(folder, about)
    absent = [file.name for file in listed if not file.is_file()]
    notes: list[str] = []
    if listed and not absent:
        group = next((files for files in found if set(listed) <= set(files)), [])
        files = group or listed
        if len(files) > len(listed):
            more = [file.name for file in files if file not in listed]
            notes.append(f"metadata.yaml does not list {', '.join(more)}, read as further parts")
    elif len(found) == 1 and len(found[0]) >= len(listed):
        files = found[0]
        lists = f"lists {', '.join(absent)}, which {'is' if len(absent) == 1 else 'are'} missing"
        what = fault or (f"metadata.yaml {lists}" if absent else "metadata.yaml lists no files")
        notes.append(
            f"{what}, so the files in the folder were read: {', '.join(file.name for file in files)}"
        )
    else:
        raise LogError(_refusal(folder, found, absent, fault))
    empty = [file.name for file in files if file.stat().st_size == 0]
    if empty and len(empty) < len(files):  # the recorder stopped before the first message of its last part
        notes.append(f"{', '.join(empty)} {'is' if len(empty) == 1 else 'are'} empty")
        files = [file for file in files if file.name not in empty]
    storage = storage_of(files[0])
    if storage is None:
        raise LogError(f"{files[0]} is neither mcap nor sqlite3; convert the bag with `ros2 bag convert`")
    stated = about.get("storage_identifier")
    if about and not fault and stated != storage:
        notes.append(f"metadata.yaml states the storage {str(stated)[:40]!r}, the files are {storage}")
    n_stated = about.get("message_count")
    return BagFiles(
        files=tuple(files),
        storage=storage,
        is_compressed=str(about.get("compression_mode")).lower() == "message",
        n_stated=n_stated if isinstance(n_stated, int) else None,
        notes=tuple(notes),
    )


@contextmanager
def plain(file: Path) -> Iterator[Path]:
    """Yield a file, or the decompressed copy of a file that is compressed as a whole."""
    with file.open("rb") as stream:
        is_packed = stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    if not is_packed:
        yield file
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder) / (file.stem if file.suffix in (".zstd", ".zst") else file.name)
        data = file.read_bytes()
        try:
            copy.write_bytes(unpack(data, most_plain(len(data))))
        except ValueError as exc:
            raise LogError(f"{file} cannot be decompressed ({exc}); copy it again") from exc
        yield copy


def _metadata(folder: Path) -> tuple[dict[str, Any], str]:
    """Return the contents of metadata.yaml, and what is wrong with it if it cannot be used."""
    path = folder / "metadata.yaml"
    if not path.is_file():
        return {}, "metadata.yaml is missing"
    try:
        about = parse_yaml(path.read_text(errors="replace"))["rosbag2_bagfile_information"]
        if not isinstance(about, dict):
            raise TypeError("not a mapping")
    except (KeyError, TypeError, ValueError) as exc:
        return {}, f"metadata.yaml is not a file of rosbag2 ({' '.join(str(exc).split())[:80]})"
    return about, ""


def _listed(folder: Path, about: Mapping[str, Any]) -> list[Path]:
    """Return the files listed in metadata.yaml; early recorders wrote them with the name of the folder.

    Raises
    ------
    LogError
        If a file is outside the folder.
    """
    names = about.get("relative_file_paths")
    files = [folder / str(name)[:MAX_NAME] for name in (names if isinstance(names, list) else [])]
    inside = [folder / file.name if (folder / file.name).is_file() else file for file in files]
    outside = [file for file in inside if not file.resolve().is_relative_to(folder.resolve())]
    if outside and os.environ.get(ALLOW_OUTSIDE) != "1":
        raise LogError(
            f"{folder / 'metadata.yaml'} lists {outside[0]}, outside its folder; copy the file into the folder, or, if "
            f"you trust the bag, set {ALLOW_OUTSIDE}=1"
        )
    return inside


def _refusal(folder: Path, found: list[list[Path]], absent: list[str], fault: str) -> str:
    """Describe why the files of a bag are unclear."""
    if absent:
        what = f"lists {', '.join(absent)}, which {'is' if len(absent) == 1 else 'are'} missing"
        return f"{folder / 'metadata.yaml'} {what}; copy the complete folder"
    if len(found) > 1:
        names = ", ".join(files[0].name for files in found)
        return f"{folder} holds {len(found)} unrelated logs: {names}; give one of them"
    about = (
        f"{folder / 'metadata.yaml'} {fault.removeprefix('metadata.yaml ')}"
        if fault
        else f"{folder} lists no files"
    )
    return f"{about}, and the folder has no mcap or sqlite3 file; copy the complete folder"


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
        recording.topics.setdefault(name, Topic(name, topic.type, topic.encoding)).take(topic)
