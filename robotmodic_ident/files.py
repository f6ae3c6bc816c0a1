"""Atomic writes: a file is complete or not there.

Each writer has a temporary name of its own, so that two commands that write one output do not mix: the later one wins.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name to write to; on leaving it becomes `path`, after an exception it is removed.

    Raises
    ------
    IsADirectoryError
        if the path names no file, as `.`
    """
    if not path.name:
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(path))
    part = path.with_name(f"{path.name}.{uuid4().hex[:8]}.part")
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
