"""Each tuned number of a package, halved and doubled: which answers change.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.sensitivity [GROUP ...] [--only faces.FACES,reach.MIN_SHARE]

Numbers are the constants of modules and the fields of settings that are written as literals. A few short cases
(`cases`) are answered with the numbers as they are, and again with one number times 2 and times 0.5. Numbers of one
module are first varied together; if no answer changes, none of them is varied alone. A number that changes no answer
is counted; one that changes any is listed with what it changed.

An answer of the diagnosis is the set of names with their places, and whether something unknown is said. Other answers are
numbers, which change if they differ by more than `NOISE` and by more than 5 %.

Counts are rounded and at least 1; shares and probabilities keep below 1 (twice 0.7 becomes 0.85, half the way to 1).
Each variant is a forked process. Kernels that hold a number are compiled anew.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection

from benchmarks.sensitivity.numbers import Number, numbers_of, vary

Said = str | dict[str, float]
Answer = Callable[[], Said]
FACTORS = (2.0, 0.5)
NOISE = {
    "median [mm]": 0.5, "score [nats]": 0.1, "wrong [%]": 0.5, "not answered [%]": 0.5,
    "ATE [mm]": 1.0, "not covered [%]": 0.5, "T / T_ref": 0.03,
    "alarm after [s]": 1.0, "offset [mm]": 3.0,
}  # fmt: skip
"""Differences that are noise, of a few thousand rays and of a chaotic search; none of a count."""
RELATIVE_NOISE = 0.05
TIME_LIMIT = 120.0
"""[s] of one variant."""
BLOCK = 4
"""Largest number of numbers that are varied together; of more, some cancel each other."""


def in_process(
    answers: Callable[[], list[Said]], numbers: Sequence[Number] = (), factor: float = 1.0
) -> list[Said] | str:
    """Return the answers of a process in which some numbers differ, or what went wrong there."""
    vary((), 1.0)  # reads the sources, once for all processes
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(there, answers, numbers, factor))
    child.start()
    there.close()
    try:
        got = here.recv() if here.poll(TIME_LIMIT) else f"longer than {TIME_LIMIT:.0f} s"
    except EOFError:
        got = "no answer"
    child.kill()
    child.join()
    return got  # type: ignore[no-any-return]


def _answer(
    to: Connection, answers: Callable[[], list[Said]], numbers: Sequence[Number], factor: float
) -> None:
    logging.disable(logging.ERROR)
    try:
        vary(numbers, factor)
        to.send(answers())
    except BaseException as exc:
        to.send(f"{type(exc).__name__}: {exc}".split("\n")[0])


def changes(
    answers: Callable[[], list[Said]], labels: Sequence[str], usual: list[Said], numbers: Sequence[Number]
) -> list[str]:
    """Return what the first factor that changes anything changes, a line each."""
    for factor in FACTORS:
        got = in_process(answers, numbers, factor)
        if isinstance(got, str):
            return [f"x {factor:g}: {got}"]
        triples = zip(labels, got, usual, strict=True)
        if lines := [
            f"x {factor:g}: {one}: {text_of(new)}" for one, new, old in triples if differs(new, old)
        ]:
            return lines
    return []


def differs(new: Said, old: Said) -> bool:
    """Return whether an answer differs from the usual one by more than noise."""
    if isinstance(new, str) or isinstance(old, str):
        return new != old
    return any(
        not abs(new[key] - old[key]) <= max(NOISE.get(key, 0.0), RELATIVE_NOISE * abs(old[key]))
        for key in old
    )


def text_of(said: Said) -> str:
    """Return an answer as text."""
    return said if isinstance(said, str) else ", ".join(f"{k} {v:.3g}" for k, v in said.items())


def sweep(
    name: str, packages: Sequence[str], cases: dict[str, Callable[[], Answer]], only: Sequence[str]
) -> None:
    """Print which numbers of packages change an answer of the cases."""
    numbers = [n for n in numbers_of(*packages) if not only or any(part in n.label for part in only)]
    prepared = [one() for one in cases.values()]
    labels = list(cases)

    def answers() -> list[Said]:
        return [one() for one in prepared]

    answers()  # compiles
    begin = time.perf_counter(), sum(os.times()[2:4])
    usual = in_process(answers)
    if isinstance(usual, str):
        raise SystemExit(f"{name}: {usual}")
    wall, cpu = time.perf_counter() - begin[0], sum(os.times()[2:4]) - begin[1]
    print(f"{name}: {len(numbers)} numbers, {len(labels)} cases, {wall:.0f} s ({cpu:.1f} of CPU) a variant")
    for label, text in zip(labels, usual, strict=True):
        print(f"  {label}: {text_of(text)}")
    moving = 0
    for block in blocks(numbers):
        together = changes(answers, labels, usual, block)
        for number in block if together else ():
            lines = together if len(block) == 1 else changes(answers, labels, usual, [number])
            moving += bool(lines)
            for line in lines:
                print(f"  {number.label} = {number.value}, {line}")
    print(f"{name}: {moving} of {len(numbers)} numbers change an answer")


def blocks(numbers: Sequence[Number]) -> list[list[Number]]:
    """Return the numbers by module, at most `BLOCK` together."""
    found: list[list[Number]] = []
    for number in numbers:
        if found and found[-1][0].module is number.module and len(found[-1]) < BLOCK:
            found[-1].append(number)
        else:
            found.append([number])
    return found
