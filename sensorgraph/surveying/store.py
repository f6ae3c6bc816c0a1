"""Keep the result of each log by its content, the version of the program and the settings."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from logs.files import atomic_file
from sensorgraph.errors import SensorgraphError

LOGS = (".mcap", ".bag", ".db3", ".log", ".clf", ".log.gz", ".clf.gz", ".log.bz2", ".clf.bz2")
"""Ends of the names of logs in a folder."""
BLOCK = 1 << 22
FOLDER = "results"
"""Folder of the kept results in the output folder."""
INDEX = "contents.json"


def find_logs(sources: Sequence[Path | str]) -> list[Path]:
    """Return the logs among files, folders (with their sub-folders) and patterns, sorted and without repetition.

    A rosbag2 folder, with metadata.yaml, is one log.

    Raises
    ------
    SensorgraphError : A source does not exist, or there is no log.
    """
    found: dict[Path, None] = {}
    for source in sources:
        path = Path(source)
        root = Path(path.anchor)
        parts = str(path.relative_to(root))
        matched = [path] if path.exists() else []
        if not matched and any(one in parts for one in "*?["):
            matched = sorted(root.glob(parts))
        if not matched:
            raise SensorgraphError(f"{source} does not exist, expected a log, a folder or a pattern")
        found.update(dict.fromkeys(log for one in matched for log in _logs_in(one)))
    if not found:
        raise SensorgraphError(
            f"no log in {', '.join(map(str, sources))}; expected files such as *.mcap, *.bag, *.log or rosbag2 folders"
        )
    return sorted(found)


def _logs_in(path: Path) -> Iterable[Path]:
    """Yield a log, or the logs in a folder and its sub-folders."""
    if path.is_file():
        yield path
    for root, folders, names in os.walk(path):
        folders.sort()
        if "metadata.yaml" in names:
            folders.clear()
            yield Path(root)
            continue
        for name in sorted(names):
            if name.lower().endswith(LOGS) and (Path(root) / name).is_file():
                yield Path(root) / name


@dataclass(eq=False)
class ResultStore:
    """Kept results in an output folder."""

    folder: Path
    settings: str
    """Version of the program and settings of the analysis; results of others are not used."""
    contents: dict[str, list[Any]] = field(default_factory=dict)
    """Path -> size, time of the last change and hash, so that an unchanged file is read once."""

    @classmethod
    def open(cls, out: Path, settings: Mapping[str, Any]) -> ResultStore:
        """Open or create the results in an output folder."""
        folder = out / FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(settings, sort_keys=True)
        store = cls(folder, hashlib.blake2b(text.encode(), digest_size=8).hexdigest())
        try:
            store.contents = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            store.contents = {}
        return store

    def key(self, log: Path) -> str:
        """Return the hash of a log's content."""
        files = [log] if log.is_file() else sorted(one for one in log.rglob("*") if one.is_file())
        stamp = [
            sum(one.stat().st_size for one in files),
            max((one.stat().st_mtime_ns for one in files), default=0),
        ]
        known = self.contents.get(str(log.absolute()))
        if known is not None and known[:2] == stamp:
            return str(known[2])
        digest = hashlib.blake2b(digest_size=16)
        for one in files:
            if log.is_dir():
                digest.update(f"{one.relative_to(log)}\0".encode())
            with one.open("rb") as file:
                while block := file.read(BLOCK):
                    digest.update(block)
        self.contents[str(log.absolute())] = [*stamp, digest.hexdigest()]
        return digest.hexdigest()

    def keep_contents(self) -> None:
        """Write the hashes of known files."""
        with atomic_file(self.folder / INDEX) as part:
            part.write_text(json.dumps(self.contents), encoding="utf-8")

    def get(self, key: str) -> dict[str, Any] | None:
        """Return the kept result of a content; None without one of these settings."""
        try:
            data = json.loads(self._path(key).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return data if isinstance(data, dict) else None

    def put(self, key: str, result: Mapping[str, Any]) -> None:
        """Keep a result."""
        with atomic_file(self._path(key)) as part:
            part.write_text(json.dumps(result), encoding="utf-8")

    def others(self, keys: Iterable[str]) -> int:
        """Return how many of these contents have results of another version or of other settings."""
        there = {path.name.split(".")[0] for path in self.folder.glob("*.*.json")}
        return sum(key in there and not self._path(key).exists() for key in keys)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.{self.settings}.json"
