"""Count the progress of work in parts, in percent."""

from __future__ import annotations

from sensorgraph.types import Progress


class WorkCounter:
    """Report the progress of work in percent to a progress bar, for parts of different duration."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.done = progress, max(total, 1), 0
        self.add(0)

    def add(self, amount: int) -> None:
        """Report that a further `amount` of the total is done."""
        self.done += amount
        self._show(self.done)

    def part(self, amount: int) -> Progress:
        """Return the progress function of a part of the total; call `add` with its amount when it is done."""
        return lambda done, total: self._show(self.done + amount * done // max(total, 1))

    def _show(self, done: int) -> None:
        if self.progress is not None:
            self.progress(min(100 * done // self.total, 100), 100)
