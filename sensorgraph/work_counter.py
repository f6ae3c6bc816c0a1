"""Progress of work in parts: how much of it is done, in percent."""

from __future__ import annotations

from sensorgraph.types import Progress


class WorkCounter:
    """Tell a progress bar in percent how much of the work is done; parts of it take different times."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.done = progress, max(total, 1), 0
        self.add(0)

    def add(self, amount: int) -> None:
        """Report that so much more of the total is done."""
        self.done += amount
        self._show(self.done)

    def part(self, amount: int) -> Progress:
        """Return the progress of a part of the total; `add` its amount when it is done."""
        return lambda done, total: self._show(self.done + amount * done // max(total, 1))

    def _show(self, done: int) -> None:
        if self.progress is not None:
            self.progress(min(100 * done // self.total, 100), 100)
