"""What the command lines of the benchmarks share: arguments, kept results, time, memory, tables, and means with their intervals."""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from planners.types import Floats


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is the docstring of its module, as it stands; from here on each line is printed at once."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def existing(text: str) -> Path:
    """Return the path of a file, or of a folder such as a bag, that is there."""
    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"{text}: there is no such file or folder")
    return path


def kept(path: Path | None) -> list[dict[str, Any]]:
    """Return the results in a file of JSON lines; none of a file that is not there."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []


def keep(path: Path | None, result: dict[str, Any]) -> None:
    """Add a result to a file of JSON lines, if there is to be one."""
    if path:
        with path.open("a") as file:
            file.write(json.dumps(result) + "\n")


def log_of_halves(parser: argparse.ArgumentParser) -> None:
    """Take a raw log, and a folder for what `localize_in_map.halves` makes of it."""
    parser.add_argument("log", type=Path)
    parser.add_argument(
        "--work", type=Path, default=Path("runs/in_map"), help="folder of located run and graph"
    )


def heads(*columns: str, text: int = 1) -> str:
    """Return the heads of a table in Markdown, of which the first columns hold text and the others numbers."""
    rule = "---|" * text + "---:|" * (len(columns) - text)
    return f"| {' | '.join(columns)} |\n|{rule}"


def half_interval(values: Floats) -> Floats:
    """Return half the 95 % interval of the mean over the first axis, by Student's t; nan for fewer than two values."""
    n = len(values)
    if n < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(student.ppf(0.975, n - 1) * values.std(axis=0, ddof=1) / np.sqrt(n))


def processor_time() -> float:
    """Return the processor time [s] of this process and of those that it has ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


@dataclass
class Took:
    """What a block took."""

    cpu: float = 0.0
    """[s] of the processor, with that of the processes that it ended."""
    wall: float = 0.0
    """[s]"""


@contextmanager
def timed() -> Iterator[Took]:
    """Measure the time of a block; it is known after the block."""
    took, cpu, wall = Took(), processor_time(), time.perf_counter()
    yield took
    took.cpu, took.wall = processor_time() - cpu, time.perf_counter() - wall


def peak_memory(*, with_children: bool = False) -> float:
    """Return the most memory [MiB] of this process, and of the largest that it has ended."""
    counted = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)[: 1 + with_children]
    unit = 1 if sys.platform == "darwin" else 1024  # [B]
    return sum(resource.getrusage(who).ru_maxrss for who in counted) * unit / 2**20


def fastest(work: Callable[[], object], repeats: int) -> float:
    """Return the processor time [s] of the fastest of several repeats."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)
