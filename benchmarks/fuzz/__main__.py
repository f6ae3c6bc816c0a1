"""Read the command line, fuzz, and print a table."""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import benchmarks.fuzz
from benchmarks.arguments import parser_of
from benchmarks.fuzz.commands import COMMANDS, COST, COSTLY, fuzz_command
from benchmarks.fuzz.readers import READERS, fuzz_reader

COMMAND = "$ "
"""Stands before the names of commands."""
MOST_KINDS = 12
"""Kinds of findings that are printed of each reader and command."""


def targets() -> dict[str, Callable[[int, int, Path], Counter[str]]]:
    """Return everything that is fuzzed, by name."""
    readers = {name: partial(fuzz_reader, name) for name in READERS}
    return readers | {COMMAND + name: partial(fuzz_command, name) for name in COMMANDS}


def cost(name: str) -> float:
    """Return how many times fewer inputs a reader or a command gets."""
    return COSTLY.get(name.removeprefix(COMMAND), COST) if name.startswith(COMMAND) else 1.0


def main() -> int:
    """Fuzz, print a table, and return 1 if anything was found."""
    parser = parser_of(benchmarks.fuzz.__doc__)
    parser.add_argument(
        "--inputs", type=int, default=100_000, help="of all together; slow commands get fewer"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="names as in the table, separated by commas")
    parser.add_argument("--keep", type=Path, help="folder for one input of each finding")
    given = parser.parse_args()
    chosen = {
        name: fuzz for name, fuzz in targets().items() if not given.only or name in given.only.split(",")
    }
    shares = {name: 1.0 / cost(name) for name in chosen}
    counts = {
        name: max(round(given.inputs * share / sum(shares.values())), 1) for name, share in shares.items()
    }
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    total = 0
    for name, fuzz in chosen.items():
        began = time.monotonic()
        found = fuzz(counts[name], given.seed, folder)
        seconds = time.monotonic() - began
        kinds = f"{found.total():5,} findings of {len(found)} kinds"
        print(f"{name:14} {counts[name]:7,} inputs {seconds:6.0f} s  {kinds}")
        for wrong, count in found.most_common(MOST_KINDS):
            print(f"    {count:5}  {wrong}")
        total += found.total()
    print(f"{sum(counts.values()):,} inputs, {total:,} findings")
    if given.keep and (folder / "found").is_dir():
        shutil.copytree(folder / "found", given.keep, dirs_exist_ok=True)
    shutil.rmtree(folder)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
