"""Decompress data up to a size limit, so that a small malicious file cannot fill the memory."""

from __future__ import annotations

import bz2
import gzip
import io
import zlib

ALLOWANCE = 64 * 1024 * 1024
"""[bytes] decompressed size that every file may reach."""
MAX_RATIO = 100
"""Decompressed bytes per stored byte that are allowed beyond ALLOWANCE; logs reach 5 to 20."""
GZIP_MAGIC, BZIP2_MAGIC, LZ4_MAGIC, ZSTD_MAGIC = b"\x1f\x8b", b"BZh", b"\x04\x22\x4d\x18", b"\x28\xb5\x2f\xfd"


class TooLarge(ValueError):
    """The decompressed data exceed the stated size, or the limit for a file of this size."""


def most_plain(stored: int) -> int:
    """Return the maximum decompressed size [bytes] of a file of `stored` bytes."""
    return ALLOWANCE + MAX_RATIO * stored


def unpack(data: bytes, most: int) -> bytes:
    """Decompress zstd, lz4, gzip or bzip2, detected from the first bytes.

    A truncated zstd or lz4 stream yields the part that is present.

    Raises
    ------
    TooLarge
        If the result exceeds `most` bytes.
    ValueError
        If the data are damaged, or use another compression.
    """
    try:
        plain = _unpack(data, most + 1)
    except Exception as exc:  # each library has its own error class, without a common base
        raise ValueError(f"{type(exc).__name__}: {exc}") from exc
    if len(plain) > most:
        raise TooLarge(f"unpacks to more than {most:,} bytes")
    return plain


def unpack_start(data: bytes, size: int) -> bytes:
    """Decompress the intact start of truncated data, at most `size` bytes; empty if nothing is intact."""
    try:
        if data.startswith(BZIP2_MAGIC):
            return bz2.BZ2Decompressor().decompress(data, size)
        return _unpack(data, size)
    except Exception:  # each library has its own error class, without a common base
        return b""


def _unpack(data: bytes, size: int) -> bytes:
    if data.startswith(ZSTD_MAGIC):
        import zstandard

        reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
        return bytes(reader.read(size))
    if data.startswith(LZ4_MAGIC):
        import lz4.frame  # type: ignore[import-untyped]

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
    if data.startswith(GZIP_MAGIC):
        return gzip.GzipFile(fileobj=io.BytesIO(data)).read(size)
    if data.startswith(BZIP2_MAGIC):
        return bz2.BZ2File(io.BytesIO(data)).read(size)
    raise zlib.error("neither zstd, lz4, gzip nor bzip2")
