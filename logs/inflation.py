"""Unpack compressed bytes, never more than a log can honestly hold: a small file must not fill the memory."""

from __future__ import annotations

import bz2
import gzip
import io
import zlib

ALLOWANCE = 64 * 1024 * 1024
"""[bytes] that any file may unpack to."""
MAX_RATIO = 100
"""Bytes that each stored byte may give beyond ALLOWANCE; logs reach 5 to 20."""
GZIP_MAGIC, BZIP2_MAGIC, LZ4_MAGIC, ZSTD_MAGIC = b"\x1f\x8b", b"BZh", b"\x04\x22\x4d\x18", b"\x28\xb5\x2f\xfd"


class TooLarge(ValueError):
    """More comes out than was promised, or than a log can honestly hold."""


def most_plain(stored: int) -> int:
    """Return how many bytes a file of `stored` bytes may unpack to."""
    return ALLOWANCE + MAX_RATIO * stored


def unpack(data: bytes, most: int) -> bytes:
    """Unpack zstd, lz4, gzip or bzip2, told by the first bytes; as much as is there of a cut zstd or lz4 stream.

    Raises
    ------
    TooLarge
        if more than `most` bytes come out
    ValueError
        if it is damaged, or compressed in none of these ways
    """
    try:
        plain = _unpack(data, most + 1)
    except Exception as exc:  # each library has its own error, and they have no common root
        raise ValueError(f"{type(exc).__name__}: {exc}") from exc
    if len(plain) > most:
        raise TooLarge(f"unpacks to more than {most:,} bytes")
    return plain


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
