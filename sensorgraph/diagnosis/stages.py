"""The stages of a diagnosis: a bar and the CPU time of each."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from sensorgraph.types import Progress, ProgressBars, no_progress

STAGES = {
    "intake": "aligning scans with the arena",
    "odometry and drive": "",
    "explain": "",
    "criticise": "testing for unexplained structure",
    "prove": "measuring the gap",
    "observable": "testing what the run could show",
    "next run": "planning the next run",
}
"""Name, as in timing.json -> label of its progress bar; empty: the stage opens bars itself."""


class StageClock:
    """CPU time and progress bar of each stage."""

    def __init__(self, progress: ProgressBars) -> None:
        self.seconds: dict[str, float] = {}
        self.progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Show a progress bar during a stage, and add its CPU time afterwards."""
        begin, label = time.process_time(), STAGES[name]
        with (self.progress if label else no_progress)(
            label, "replicates" if name == "criticise" else ""
        ) as tick:
            tick(0, 1)
            yield tick
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - begin
