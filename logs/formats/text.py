"""Text logs: plain or gzip, told by content; a cut gzip stream is an error, never a shorter log."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path

from logs.errors import LogError

GZIP_MAGIC = b"\x1f\x8b"
HEAD_SIZE = 1 << 16


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file, unpacked if it is gzip; none of a folder."""
    if path.is_dir():
        return b""
    with path.open("rb") as file:
        head = file.read(HEAD_SIZE)
    if not head.startswith(GZIP_MAGIC):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head)
    except zlib.error as exc:
        raise LogError(f"{path} is a damaged gzip file ({exc}); copy it again from where it came") from exc


def read_lines(path: Path) -> list[str]:
    """Return all lines of a text file, plain or gzip."""
    data = path.read_bytes()
    if data.startswith(GZIP_MAGIC):
        try:
            data = gzip.GzipFile(fileobj=io.BytesIO(data)).read()
        except (EOFError, OSError, zlib.error) as exc:
            why = "is cut short" if isinstance(exc, EOFError) else "is damaged"
            raise LogError(
                f"{path} {why} (gzip: {exc}); copy it again, or keep its whole start with "
                f"`zcat {path} > {path.stem}`"
            ) from exc
    return data.decode("utf-8", errors="replace").splitlines()
