"""Make logs, read them, and print a table by kind."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from fnmatch import fnmatchcase
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import benchmarks.fuzz.structure
from benchmarks.arguments import keep, kept, parser_of
from benchmarks.fuzz.structure import drives
from benchmarks.fuzz.structure.judge import Outcome, look
from benchmarks.fuzz.structure.kinds import KINDS, draft_of
from benchmarks.fuzz.structure.writers import write

WORST = 25
"""Cases that are listed after the table."""


def table(results: Sequence[Outcome]) -> list[str]:
    """Return a table by group and kind, and the worst cases."""
    lines = [
        f"{'kind':34} {'logs':>5} {'crash':>5} {'silent':>6} {'unsaid':>6} {'unread':>6} {'usable':>6} {'used':>6} {'covered':>7} {'s':>5}"
    ]

    def row(name: str, part: Sequence[Outcome]) -> str:
        usable = [one for one in part if one.usable]
        covered = [one.covered for one in part if np.isfinite(one.covered)]
        return (
            f"{name:34} {len(part):5} {sum(one.is_crash for one in part):5} {sum(one.is_silent for one in part):6} "
            f"{sum(not one.is_said for one in part):6} {sum(bool(one.missing) for one in part):6} "
            f"{len(usable):6} {sum(one.is_used for one in usable):6} "
            f"{np.mean(covered) if covered else np.nan:7.2f} {np.mean([one.seconds for one in part]):5.1f}"
        )

    names = list(dict.fromkeys(one.kind for one in results))
    for name in names:
        lines.append(row(name, [one for one in results if one.kind == name]))
    for group in dict.fromkeys(name.partition(".")[0] for name in names):
        lines.append(row(group, [one for one in results if one.kind.partition(".")[0] == group]))
    lines.append(row("all", results))
    bad = [one for one in results if one.is_crash or one.is_silent or (one.usable and not one.is_used)]
    bad.sort(key=lambda one: (-one.is_crash, -one.is_silent, -one.beyond_xy))
    for one in bad[:WORST]:
        what = one.inspect if one.inspect not in ("ok", "refused") else one.locate
        what = f"refused: {one.refusal}" if what == "refused" else what
        lines.append(
            f"{one.kind} {one.seed} {one.container}: {what[:140]}; {one.ok:.0%} ok, {one.n_silent} silent, "
            f"{100 * one.error_xy:.1f} cm, {np.degrees(one.error_yaw):.1f}°"
        )
    return lines


def case(job: tuple[str, int], seed: int) -> Outcome:
    """Make, write, read and judge one log of a kind; for a pool of processes."""
    draft, in_memory = draft_of(*job, seed), Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=in_memory if in_memory.is_dir() else None) as base:
        return look(draft, write(draft, Path(base) / "log"), *job)


def main() -> int:
    """Fuzz, print a table, and return 1 if anything crashed or was silently wrong."""
    parser = parser_of(benchmarks.fuzz.structure.__doc__)
    parser.add_argument("--n", type=int, default=1000, help="number of logs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--only", default="", help="kinds, or patterns such as 'clocks.*', separated by commas"
    )
    parser.add_argument(
        "--number", type=int, help="the one log of this number, as listed among the worst cases"
    )
    parser.add_argument(
        "--keep", type=Path, help="JSON lines of the results; what is there already is not repeated"
    )
    parser.add_argument("--logs", type=Path, help="only write the logs, into this folder")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    names = [
        name for name in KINDS if not given.only or any(fnmatchcase(name, p) for p in given.only.split(","))
    ]
    turns = range(
        given.n if given.number is None else len(names)
    )  # the kinds in turn, each time with another number
    jobs = [(names[k % len(names)], k // len(names) if given.number is None else given.number) for k in turns]
    for name in drives.NAMES:
        drives.load(name)
    if given.logs is not None:
        for name, number in jobs:
            print(write(draft_of(name, number, given.seed), given.logs / f"{name}-{number}"))
        return 0
    before = {(row["kind"], row["seed"]): Outcome(**row) for row in kept(given.keep)}
    results = [before[job] for job in jobs if job in before]
    jobs = [job for job in jobs if job not in before]
    began = time.monotonic()
    work = partial(case, seed=given.seed)
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        for one in pool.map(work, jobs) if given.processes > 1 else map(work, jobs):
            results.append(one)
            keep(given.keep, asdict(one))
    print("\n".join(table(results)))
    print(f"{len(results):,} logs, {len(jobs):,} of them now, in {time.monotonic() - began:.0f} s")
    return int(any(one.is_crash or one.is_silent for one in results))


if __name__ == "__main__":
    sys.exit(main())
