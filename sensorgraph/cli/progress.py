"""Show progress on stderr: a bar with rate and remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sensorgraph.types import Progress

PLAIN_EVERY = 5.0  # [s] between plain lines


@contextmanager
def progress(label: str, unit: str = "") -> Iterator[Progress]:
    """Yield `tick(done, total)`, which shows the progress of the work.

    The rate is measured from the first tick, so that preparation such as compiling does not affect the remaining time. A count
    that falls begins another pass with its own rate.
    """
    with progress_with_status(label, unit) as (tick, _):
        yield tick


@contextmanager
def progress_with_status(label: str, unit: str = "") -> Iterator[tuple[Progress, Callable[[str], None]]]:
    """Yield `tick(done, total)` and `set_status(text)`, which appends the current step to the label."""
    with (_bar if sys.stderr.isatty() else _plain)(label, unit) as (tick, set_status):
        yield tick, set_status


@contextmanager
def _bar(label: str, unit: str) -> Iterator[tuple[Progress, Callable[[str], None]]]:
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
        start, last = (0.0, 0), sys.maxsize

        def tick(done: int, total: int) -> None:
            nonlocal start, last
            start, last = (time.monotonic(), done) if done < last else start, done  # a pass begins
            rate = (done - start[1]) / max(time.monotonic() - start[0], 1e-9)
            bar.update(
                task, completed=done, total=total, rate=f"{rate_text(rate)} {unit}/s".replace(" /", "/")
            )

        yield tick, lambda text: bar.update(task, description=f"{label}, {text}")


def rate_text(rate: float) -> str:
    """Format a rate; rates below 10 have two significant digits."""
    return f"{rate:,.0f}" if rate >= 10 else f"{rate:.2g}"


def reset_silence() -> None:
    """Restart the timer of plain lines at the start of a command."""
    PlainLines.last = time.monotonic()


class PlainLines:
    """Time of the last plain line, shared by all stages."""

    last = time.monotonic()

    @classmethod
    def are_due(cls) -> bool:
        return time.monotonic() - cls.last >= PLAIN_EVERY

    @classmethod
    def write(cls, text: str) -> None:
        cls.last = time.monotonic()
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


class _PlainStage:
    """A stage that prints its progress every few seconds, also during a single long call."""

    def __init__(self, label: str, unit: str) -> None:
        self.title, self.label, self.unit, self.opened = label, label, unit, time.monotonic()
        self.first: tuple[float, int] | None = None
        self.done, self.total = 0, 0

    def tick(self, done: int, total: int) -> None:
        if self.first is None or done < self.done:  # a pass begins
            self.first = time.monotonic(), done
        self.done, self.total = done, total
        if PlainLines.are_due():
            PlainLines.write(self.line())

    def set_status(self, text: str) -> None:
        self.label = f"{self.title}, {text}"

    def line(self) -> str:
        now = time.monotonic()
        if self.first is None or self.total <= 1:  # no count, so no remaining time
            return f"{self.label}: {now - self.opened:.0f} s so far"
        since, first = self.first
        is_share = self.unit == "%"
        whole = "" if is_share else f"of {self.total:,} "
        counted = f"{self.label}: {self.done:,} {whole}{self.unit}".rstrip()
        if self.done <= first:
            return counted
        rate = (self.done - first) / max(now - since, 1e-9)
        pace = "" if is_share else f"{rate_text(rate)}/s, "
        return f"{counted}, {pace}{(self.total - self.done) / rate:.0f} s left"

    def watch(self, ended: Event) -> None:
        """Print a line whenever one is due, until the stage has ended."""
        while not ended.wait(PLAIN_EVERY / 5):
            if PlainLines.are_due():
                PlainLines.write(self.line())


@contextmanager
def _plain(label: str, unit: str) -> Iterator[tuple[Progress, Callable[[str], None]]]:
    stage, ended = _PlainStage(label, unit), Event()
    Thread(target=stage.watch, args=(ended,), daemon=True).start()
    try:
        yield stage.tick, stage.set_status
    finally:
        ended.set()


@contextmanager
def reading_bar() -> Iterator[Progress]:
    """Yield a tick for `logs.read` that shows percent, because formats count bytes, lines or messages."""
    with progress("reading", "%") as tick:
        yield lambda done, total: tick(100 * done // max(total, 1), 100)
