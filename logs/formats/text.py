"""Text logs: plain, gzip or bzip2, told by content; a cut stream is an error, never a shorter log."""

from __future__ import annotations

import bz2
import gzip
import io
import zlib
from pathlib import Path

from logs.errors import LogError

GZIP_MAGIC, BZIP2_MAGIC = b"\x1f\x8b", b"BZh"
HEAD_SIZE = 1 << 16


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file, unpacked if it is gzip or bzip2; none of a folder."""
    if path.is_dir():
        return b""
    with path.open("rb") as file:
        head = file.read(HEAD_SIZE)
    if head.startswith(BZIP2_MAGIC):
        return _first_of_bzip2(path)
    if not head.startswith(GZIP_MAGIC):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head)
    except zlib.error as exc:
        raise LogError(f"{path} is a damaged gzip file ({exc}); copy it again from where it came") from exc


def _first_of_bzip2(path: Path) -> bytes:
    try:
        with bz2.open(path) as file:
            return file.read(HEAD_SIZE)
    except (EOFError, OSError) as exc:
        raise LogError(f"{path} is a damaged bzip2 file ({exc}); copy it again from where it came") from exc


def read_lines(path: Path) -> list[str]:
    """Return all lines of a text file, plain, gzip or bzip2."""
    data = path.read_bytes()
    if data.startswith((GZIP_MAGIC, BZIP2_MAGIC)):
        is_gzip = data.startswith(GZIP_MAGIC)
        packed = io.BytesIO(data)
        try:
            data = gzip.GzipFile(fileobj=packed).read() if is_gzip else bz2.BZ2File(packed).read()
        except (EOFError, OSError, zlib.error) as exc:
            why = "is cut short" if isinstance(exc, EOFError) else "is damaged"
            kind, tool = ("gzip", "zcat") if is_gzip else ("bzip2", "bzcat")
            raise LogError(
                f"{path} {why} ({kind}: {exc}); copy it again, or keep its whole start with "
                f"`{tool} {path} > {path.stem}`"
            ) from exc
    return data.decode("utf-8", errors="replace").splitlines()
