"""Damage files as disks, programs and people do: bytes, one value of a text, one member of a zip, one record of an MCAP."""

from __future__ import annotations

import gzip
import io
import struct
import zipfile
import zlib

import numpy as np

TOKENS = (
    b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-inf", b"null", b"true", b"[]", b"{}", b'""', b"1e9",
    b"99999999999999999999", b"2147483648", b"-0.0", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b",", b":", b"#",
    b"&a [*a, *a]", b"!!python/object:os.system x", b"../../../../etc/passwd", b"/dev/zero", b"~", b"0x10", b"1_000",
    b"[" * 5000, b"{a: " * 3000, b"2026-11-22", "é".encode(), b"' ", b'"',
)  # fmt: skip


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a file as disks, programs and people do, a few times over."""
    out = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 2, 4, 16]))):
        if not out:
            break
        at = int(rng.integers(len(out)))
        size = int(min(rng.choice([1, 2, 4, 8, 64, 1024]), len(out) - at))
        match int(rng.integers(9)):
            case 0:
                out[at] ^= 1 << int(rng.integers(8))
            case 1:
                out[at : at + size] = rng.bytes(size)
            case 2:
                del out[at : at + size]
            case 3:
                out[at:at] = out[at : at + size]
            case 4:
                del out[at:]
            case 5:
                odd = int(rng.choice([0, 1, 0x7F, 0xFF]))
                out[at : at + size] = bytes([odd]) * size
            case 6:
                value = int(rng.choice([0, 1, 2**31 - 1, 2**32 - 1, 10**6]))
                out[at : at + 4] = struct.pack("<I", value)[: len(out) - at]
            case 7:
                other = int(rng.integers(len(out)))
                out[at : at + size] = out[other : other + size]
            case _:
                out[at : at + size] = TOKENS[int(rng.integers(len(TOKENS)))]
    return bytes(out)


def swap_token(data: bytes, rng: np.random.Generator) -> bytes:
    """Put an odd value in the place of one of a text's numbers, names or separators."""
    starts = [i for i, c in enumerate(data) if chr(c) in " :,[\t\n="]
    if not starts:
        return mutate(data, rng)
    at = int(rng.choice(starts)) + 1
    end = at
    while end < len(data) and chr(data[end]) not in " ,]}\t\n":
        end += 1
    return data[:at] + TOKENS[int(rng.integers(len(TOKENS)))] + data[end:]


def rezip(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage one member of a zip file, and zip it again with right checksums."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            members = {name: file.read(name) for name in file.namelist()}
    except Exception:  # damaged already
        return mutate(data, rng)
    name = list(members)[int(rng.integers(len(members)))]
    text = name.endswith(".json") and rng.random() < 0.8
    members[name] = swap_token(members[name], rng) if text else mutate(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for member, content in members.items():
            file.writestr(member, content)
    return out.getvalue()


def repack(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage what a gzip file holds, and pack it again with a right checksum."""
    return gzip.compress(swap_token(gzip.decompress(data), rng), mtime=0)


def remcap(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage the content of one chunk or record of an MCAP file whose checksums are then right (or 0, not given)."""
    out, pos, records = bytearray(data), 8, []
    while pos + 9 <= len(out) - 8:
        opcode, length = struct.unpack_from("<BQ", out, pos)
        records.append((opcode, pos + 9, pos + 9 + length))
        pos += 9 + length
    for opcode, body, _ in records:
        if opcode == 15:  # data end: its checksum is optional
            out[body : body + 4] = bytes(4)
        if opcode == 2:  # footer: so is that of the summary
            out[body + 16 : body + 20] = bytes(4)
    opcode, body, end = records[int(rng.integers(len(records)))]
    if opcode == 6:
        name_size = struct.unpack_from("<I", out, body + 28)[0]
        head = body + 32 + name_size + 8
        content = mutate(bytes(out[head:end]), rng)[: end - head]
        content += bytes(end - head - len(content))
        out[head:end] = content
        struct.pack_into("<I", out, body + 24, zlib.crc32(content) if rng.random() < 0.5 else 0)
    else:
        content = mutate(bytes(out[body:end]), rng)[: end - body]
        out[body:end] = content + bytes(end - body - len(content))
    return bytes(out)
