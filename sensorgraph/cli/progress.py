"""Progress of long work: a bar with rate and time left on a terminal, plain lines elsewhere, on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sensorgraph.types import Progress

PLAIN_EVERY = 5.0  # [s] between plain lines


@contextmanager
def progress(label: str, unit: str = "") -> Iterator[Progress]:
    """Yield `tick(done, total)`, which draws how far the work is; nothing is drawn for work under 0.5 s.

    The clock of the rate starts with the first tick: what is prepared before it says nothing of the time left.
    """
    if sys.stderr.isatty():
        with _bar(label, unit) as tick:
            yield tick
    else:
        yield _plain(label, unit)


@contextmanager
def _bar(label: str, unit: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(bar_width=32),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=None, rate="")
        start: tuple[float, int] | None = None

        def tick(done: int, total: int) -> None:
            nonlocal start
            start = (time.monotonic(), done) if start is None else start
            rate = (done - start[1]) / max(time.monotonic() - start[0], 1e-9)
            bar.update(task, completed=done, total=total, rate=f"{rate:,.0f} {unit}/s".replace(" /", "/"))

        yield tick


def start_silence() -> None:
    """Count from now on how long nothing was said: a command begins."""
    _PlainLines.last = time.monotonic()


class _PlainLines:
    """When the last plain line was written, whatever stage it was of."""

    last = time.monotonic()

    @classmethod
    def write(cls, text: str) -> None:
        cls.last = time.monotonic()
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


def _plain(label: str, unit: str) -> Progress:
    start: tuple[float, int] | None = None

    def tick(done: int, total: int) -> None:
        nonlocal start
        now = time.monotonic()
        start = (now, done) if start is None else start
        if now - _PlainLines.last < PLAIN_EVERY:
            return
        since, first = start
        counted = f"{done:,} of {total:,} {unit}".rstrip()
        if done <= first:
            _PlainLines.write(f"{label}: {counted}")
            return
        rate = (done - first) / max(now - since, 1e-9)
        _PlainLines.write(f"{label}: {counted}, {rate:,.0f}/s, {(total - done) / rate:.0f} s left")

    return tick
