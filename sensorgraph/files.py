"""Write folders atomically: either all files are written or none; `logs.files` does the same for one file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from logs.files import atomic_file

unfinished: set[Path] = set()
"""Temporary folders that are being written; a process that must end at once removes them."""


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder; at the end, move its files to `folder`.

    After an exception no file is moved, and folders created here are removed.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        part = Path(mkdtemp(prefix=".part-", dir=folder))
        unfinished.add(part)
        try:
            yield part
            for path in sorted(p for p in part.rglob("*") if p.is_file()):
                target = folder / path.relative_to(part)
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)
        finally:
            shutil.rmtree(part, ignore_errors=True)
            unfinished.discard(part)
    except BaseException:
        with suppress(OSError):  # another command may write there
            for path in made:
                path.rmdir()
        raise


def write_timing(folder: Path, seconds: Mapping[str, Any]) -> None:
    """Write the computing times to timing.json, separate from the files that depend only on the seed."""
    with atomic_file(folder / "timing.json") as part:
        part.write_text(json.dumps(seconds, indent=1) + "\n", encoding="utf-8")
