"""One log of a kind: made, written, read and judged; a kind, a number and a seed determine it."""

from __future__ import annotations

import shutil
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.fuzz.structure import drives
from benchmarks.fuzz.structure.draft import Draft
from benchmarks.fuzz.structure.judge import Outcome, look
from benchmarks.fuzz.structure.kinds import KINDS
from benchmarks.fuzz.structure.start import Start
from benchmarks.fuzz.structure.writers import write


def draft_of(name: str, number: int, seed: int, cache: Path = drives.CACHE) -> Draft:
    """Make one log of a kind."""
    return KINDS[name](Start(np.random.default_rng([seed, number, zlib.crc32(name.encode())]), cache=cache))


def case(name: str, number: int, seed: int, folder: Path, cache: Path = drives.CACHE) -> Outcome:
    """Make, write, read and judge one log of a kind."""
    draft = draft_of(name, number, seed, cache)
    try:
        return look(draft, write(draft, folder), name, number)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def case_of_job(job: tuple[str, int], seed: int, cache: Path) -> Outcome:
    """Judge one log in a folder of its own; for a pool of processes."""
    base = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        return case(*job, seed, base / "log", cache)
    finally:
        shutil.rmtree(base, ignore_errors=True)


def jobs_of(names: Sequence[str], n: int) -> Iterator[tuple[str, int]]:
    """Yield the kinds in turn, each time with another number."""
    for k in range(n):
        yield names[k % len(names)], k // len(names)
