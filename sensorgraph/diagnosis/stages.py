"""The stages of a diagnosis: a bar and the CPU time of each."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from sensorgraph.types import Progress, ProgressBars, no_progress

STAGES = {
    "intake": "laying scans on the arena",
    "odometry and drive": "",
    "explain": "",
    "criticise": "looking for what is left",
    "prove": "measuring the gap",
    "observable": "asking what the run could show",
    "next run": "planning the next run",
}
"""Name, as timing.json has it -> what its bar says; empty: it opens bars of its own."""


class StageClock:
    """CPU time per stage, and a bar for each."""

    def __init__(self, progress: ProgressBars) -> None:
        self.seconds: dict[str, float] = {}
        self.progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Say what is done now, and book its time when it has ended."""
        begin, label = time.process_time(), STAGES[name]
        with (self.progress if label else no_progress)(
            label, "replicates" if name == "criticise" else ""
        ) as tick:
            tick(0, 1)
            yield tick
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - begin
