"""Read text logs: plain, gzip or bzip2, detected from the content; a truncated stream is an error."""

from __future__ import annotations

import bz2
import codecs
import zlib
from pathlib import Path

from logs.errors import LogError
from logs.inflation import BZIP2_MAGIC, GZIP_MAGIC, TooLarge, most_plain, unpack

HEAD_SIZE = 1 << 16
MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
"""Byte order mark -> encoding of a text; Windows programs write one."""


def decoded(data: bytes) -> str:
    """Return a text without its byte order mark, which states the encoding; without a mark, it is UTF-8."""
    mark, encoding = next((known for known in MARKS if data.startswith(known[0])), (b"", "utf-8"))
    return data.removeprefix(mark).decode(encoding, errors="replace")


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file, decompressed if it is gzip or bzip2; empty for a folder.

    A text with a byte order mark is returned as UTF-8 without it.
    """
    head = _first_plain(path)
    return decoded(head).encode() if head.startswith(tuple(mark for mark, _ in MARKS)) else head


def _first_plain(path: Path) -> bytes:
    if path.is_dir():
        return b""
    with path.open("rb") as file:
        head = file.read(HEAD_SIZE)
    if head.startswith(BZIP2_MAGIC):
        return _first_of_bzip2(path)
    if not head.startswith(GZIP_MAGIC):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head, HEAD_SIZE)
    except zlib.error as exc:
        raise LogError(f"{path} is a damaged gzip file ({exc}); copy it again from its source") from exc


def _first_of_bzip2(path: Path) -> bytes:
    try:
        with bz2.open(path) as file:
            return file.read(HEAD_SIZE)
    except (EOFError, OSError) as exc:
        raise LogError(f"{path} is a damaged bzip2 file ({exc}); copy it again from its source") from exc


def read_lines(path: Path) -> list[str]:
    """Return all lines of a text file, plain, gzip or bzip2."""
    data = path.read_bytes()
    if data.startswith((GZIP_MAGIC, BZIP2_MAGIC)):
        kind, tool = ("gzip", "zcat") if data.startswith(GZIP_MAGIC) else ("bzip2", "bzcat")
        try:
            data = unpack(data, most_plain(len(data)))
        except TooLarge as exc:
            raise LogError(
                f"{path} is {len(data):,} bytes of {kind} and {exc}, which exceeds the limit for a log; if you trust "
                f"the file, unpack it: `{tool} {path} > {path.stem}`"
            ) from exc
        except ValueError as exc:
            why = "is truncated" if isinstance(exc.__cause__, EOFError) else "is damaged"
            raise LogError(
                f"{path} {why} ({kind}: {exc}); copy it again, or keep its intact first part with "
                f"`{tool} {path} > {path.stem}`"
            ) from exc
    return decoded(data).splitlines()


def parses_as_number(text: str) -> bool:
    """Tell whether a cell of a table is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
