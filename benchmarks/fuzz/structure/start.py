"""What a log is before its odd thing: a robot with a common laser, drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import numpy as np

from benchmarks.fuzz.structure import drives
from benchmarks.fuzz.structure.draft import Draft, Laser, add_reference, base_draft
from benchmarks.fuzz.structure.writers import PLAIN

LASERS = (
    Laser(sweep=1, first=-180, n=360),
    Laser(sweep=1, first=-180, n=180, stride=2),
    Laser(sweep=1, first=-120, n=241),
    Laser(sweep=0, first=-135, n=271),
    Laser(sweep=0, first=-90, n=181),
)
"""A spinning laser, a coarse one, one of 240°, and two that measure all rays at once."""


@dataclass
class Start:
    """Draws of one log."""

    rng: np.random.Generator

    def chance(self, share: float = 0.5) -> bool:
        """Draw a yes or no."""
        return bool(self.rng.random() < share)

    def pick(self, values: Any) -> Any:
        """Draw one of some values."""
        return values[int(self.rng.integers(len(values)))]

    def draft(
        self, laser: Laser | None = None, *, drive: str = "", spins: bool | None = None, reference: float = 0.3,
        **changes: Any,
    ) -> Draft:  # fmt: skip
        """Return a log without anything odd.

        Parameters
        ----------
        laser : The laser; None: one of `LASERS`.
        spins : Whether the laser must be one that spins.
        reference : Probability of a reference pose in the log.
        changes : Changed fields of the laser.
        """
        suitable = [one for one in LASERS if spins is None or (one.sweep != 0) == spins]
        laser = replace(laser or self.pick(suitable), **changes)
        draft = base_draft(drives.load(drive or self.pick(drives.ROOMS)), self.rng, laser)
        draft.container = self.pick(PLAIN)
        if self.chance(reference):
            add_reference(draft)
            draft.expects.add("pose")
        if self.chance():
            number_scans(draft)
        return draft


def number_scans(draft: Draft) -> None:
    """Write the number of each scan into its intensities, by which a scan is recognised in what was read."""
    for item in draft.scans:
        item.content["intensities"] = item.scan + np.linspace(0.25, 0.75, len(item.content["ranges"]))


Kind = Callable[[Start], Draft]
Change = Callable[[Start, Draft], None]
"""Makes a log odd."""


def of(**options: Any) -> Callable[[Change], Change]:
    """State options of `Start.draft` for the log that a change is given."""

    def mark(change: Change) -> Change:
        change.options = options  # type: ignore[attr-defined]
        return change

    return mark


def named(*kinds: Kind | Change) -> dict[str, Kind]:
    """Return kinds by the names of their functions; a change is given a log without anything odd."""

    def kind(change: Any) -> Kind:
        def make(start: Start) -> Draft:
            draft = start.draft(**getattr(change, "options", {}))
            change(start, draft)
            return draft

        return make if len(signature(change).parameters) == 2 else change

    return {one.__name__: kind(one) for one in kinds}
