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
        start: float | None = None

        def tick(done: int, total: int) -> None:
            nonlocal start
            start = time.monotonic() if start is None else start
            rate = done / max(time.monotonic() - start, 1e-9)
            bar.update(task, completed=done, total=total, rate=f"{rate:,.0f} {unit}/s".replace(" /", "/"))

        yield tick


def _plain(label: str, unit: str) -> Progress:
    start: float | None = None
    last_line = 0.0

    def tick(done: int, total: int) -> None:
        nonlocal start, last_line
        now = time.monotonic()
        if start is None:
            start = last_line = now
        if now - last_line < PLAIN_EVERY or done <= 0:
            return
        last_line = now
        rate = done / (now - start)
        left = (total - done) / rate
        counted = f"{done:,} of {total:,} {unit}".rstrip()
        sys.stderr.write(f"{label}: {counted}, {rate:,.0f}/s, {left:.0f} s left\n")
        sys.stderr.flush()

    return tick
