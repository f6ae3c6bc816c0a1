"""Read the sqlite3 files of rosbag2, without writing next to them."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

from logs.errors import LogError
from logs.formats.collecting import is_kept
from logs.ros.recording import Recording, Topic, full_type
from logs.types import Progress

MAGIC = b"SQLite format 3\x00"
TABLES = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("topic_id", "timestamp", "data"),
}
"""Tables of rosbag2 -> the columns that are read."""
PENDING = ("-wal", "-journal")
"""Ends of the names of files with changes that are not in the database yet."""


@contextmanager
def opened(file: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading; its folder may be read-only, and no file in it is created or changed.

    SQLite creates files next to a database in WAL mode, even for reading, unless the database counts as immutable.
    Changes that are not in the database yet are applied to a temporary copy.
    """
    file = file.resolve()
    beside = [file.with_name(file.name + end) for end in PENDING]
    pending = [path for path in beside if path.is_file() and path.stat().st_size > 0]
    address = f"{file.as_uri()}?immutable=1"
    with ExitStack() as stack:
        if pending:
            folder = Path(stack.enter_context(TemporaryDirectory())).resolve()
            for path in (file, *pending):
                copyfile(path, folder / path.name)
            address = (folder / file.name).as_uri()
        yield stack.enter_context(closing(sqlite3.connect(address, uri=True)))


def load(file: Path, progress: Progress | None = None) -> Recording:
    """Read the messages of a database.

    Raises
    ------
    LogError
        If the database is damaged, or is of another program than rosbag2.
    """
    recording = Recording(format="rosbag2, sqlite3")
    try:
        with opened(file) as base:
            _check_tables(file, base)
            _load(base, recording, progress)
    except (sqlite3.Error, UnicodeDecodeError) as exc:
        raise LogError(
            f"{file} is damaged or not a rosbag2 file ({exc}); save the intact messages: "
            f"sqlite3 {file} .recover | sqlite3 {file.with_name(file.stem + '.recovered.db3')}"
        ) from exc
    return recording


def messages(file: Path, topic: str) -> Iterator[tuple[int, bytes]]:
    """Yield log time [ns] and payload of each message of one topic."""
    query = (
        "SELECT timestamp, data FROM messages WHERE topic_id IN (SELECT id FROM topics WHERE name = ?) "
        "ORDER BY id"
    )
    with opened(file) as base:
        yield from base.execute(query, (topic,))


def _check_tables(file: Path, base: sqlite3.Connection) -> None:
    """Reject a database that has not the tables of rosbag2.

    Raises
    ------
    LogError
        If it belongs to another program, such as rtabmap or Gazebo (state.tlog).
    """
    tables = [
        str(row[0])
        for row in base.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    ]
    there = {(table, str(row[1])) for table in TABLES for row in base.execute(f"PRAGMA table_info({table})")}
    if not {(table, column) for table, columns in TABLES.items() for column in columns} <= there:
        raise LogError(
            f"{file} is an SQLite database of another program than rosbag2 (its tables are {', '.join(tables)[:200]}); give the "
            "bag from which it was made, or record the topics while it is replayed"
        )


def _load(base: sqlite3.Connection, recording: Recording, progress: Progress | None) -> None:
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
    kept = [key for key, topic in topics.items() if is_kept(topic)]
    kept_keys, marks = set(kept), ",".join("?" * len(kept))
    query = (
        f"SELECT topic_id, timestamp, CASE WHEN topic_id IN ({marks}) THEN data END FROM messages ORDER BY id"
    )
    for done, (key, stamp, data) in enumerate(base.execute(query, kept)):
        if key not in topics or not isinstance(stamp, int) or not isinstance(data, bytes | None):
            raise sqlite3.DatabaseError(f"message {done} has topic {key!r:.20} and time {stamp!r:.20}")
        topics[key].add(stamp, (data or b"") if key in kept_keys else None)
        if progress is not None and done % 512 == 0:
            progress(done, total)
