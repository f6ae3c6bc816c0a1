"""One log of a kind: made, written, read and judged; a kind, a number and a seed determine it."""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.fuzz.structure.draft import Draft
from benchmarks.fuzz.structure.judge import Outcome, look
from benchmarks.fuzz.structure.kinds import KINDS
from benchmarks.fuzz.structure.start import Start
from benchmarks.fuzz.structure.writers import write


def draft_of(name: str, number: int, seed: int) -> Draft:
    """Make one log of a kind."""
    return KINDS[name](Start(np.random.default_rng([seed, number, zlib.crc32(name.encode())])))


def case(job: tuple[str, int], seed: int) -> Outcome:
    """Make, write, read and judge one log of a kind; for a pool of processes."""
    draft = draft_of(*job, seed)
    in_memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=in_memory if in_memory.is_dir() else None) as base:
        return look(draft, write(draft, Path(base) / "log"), *job)


def jobs_of(names: Sequence[str], n: int) -> Iterator[tuple[str, int]]:
    """Yield the kinds in turn, each time with another number."""
    for k in range(n):
        yield names[k % len(names)], k // len(names)
