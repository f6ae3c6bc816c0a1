"""Write files atomically: a file is either complete or absent.

Every writer uses a unique temporary name, so two commands with the same output do not mix; the last one wins.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

unfinished: set[Path] = set()
"""Temporary files that are being written; a process that must end at once removes them."""


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path; rename it to `path` on success, and remove it after an exception.

    Raises
    ------
    IsADirectoryError
        If the path has no file name, such as `.`.
    """
    if not path.name:
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(path))
    part = path.with_name(f"{path.name}.{uuid4().hex[:8]}.part")
    unfinished.add(part)
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    finally:
        unfinished.discard(part)
