"""What a log is before its odd thing, and how it is made odd: changes with the values that they draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any, NamedTuple

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
SPINNING, TURNING = LASERS[:3], LASERS[:2]
"""Those that spin, and those that see all around."""
SCANS, ODOM, WHEELS, ALL = ("/scan",), ("/odom",), ("/odom", "/tf"), ()
"""Topics of some messages; none: all messages."""


class Span(NamedTuple):
    """Two numbers, between which one is drawn."""

    low: float
    high: float


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

    def between(self, low: float, high: float) -> float:
        """Draw a number between two."""
        return float(self.rng.uniform(low, high))

    def drawn(self, draws: tuple[Any, ...]) -> list[Any]:
        """Draw a value of each: a number of a span, a yes or no of a share, or one of some values."""
        kinds = {Span: lambda one: self.between(*one), float: self.chance}
        return [kinds.get(type(one), self.pick)(one) for one in draws]

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
        if self.chance():  # the number of each scan, by which it is recognised in what was read
            for item in draft.scans:
                item.content["intensities"] = item.scan + np.linspace(0.25, 0.75, len(item.content["ranges"]))
        return draft


Kind = Callable[[Start], Draft]
"""Makes an odd log."""
Change = Callable[[Start, Draft], None]
"""Makes a log odd."""


def kind(
    *changes: Change, said: str = "", usable: bool = True, gauges: tuple[str, ...] = (), lacks: tuple[str, ...] = (),
    adds: tuple[str, ...] = (), containers: tuple[str, ...] = (), **options: Any,
) -> Kind:  # fmt: skip
    """Return a kind by what changes a log without anything odd.

    Parameters
    ----------
    said, usable, gauges : as in `Draft`
    lacks, adds : roles that the reader need not find, and that it must find as well
    containers : one of these is used
    options : of `Start.draft`
    """

    def make(start: Start) -> Draft:
        draft = start.draft(**options)
        for change in changes:
            change(start, draft)
        draft.said, draft.usable = draft.said or said, draft.usable and usable
        draft.gauges |= {*gauges}
        draft.expects = (draft.expects | {*adds}) - {*lacks}
        draft.container = start.pick(containers) if containers else draft.container
        return draft

    return make


def of(**facts: Any) -> Callable[[Change], Change]:
    """State what `kind` is told about a change."""

    def mark(change: Change) -> Change:
        change.facts = facts  # type: ignore[attr-defined]
        return change

    return mark


def named(*kinds: Kind | Change) -> dict[str, Kind]:
    """Return kinds by the names of their functions; a change is given a log without anything odd."""
    makers: Any = kinds
    return {
        one.__name__: kind(one, **getattr(one, "facts", {})) if len(signature(one).parameters) == 2 else one
        for one in makers
    }


def is_on(topics: tuple[str, ...], topic: str) -> bool:
    return not topics or topic in topics


def stamps(choices: tuple[tuple[str, ...], ...], new: Callable[..., float], *draws: Any) -> Change:
    """Change the stamps of the messages of one choice of topics: (stamp, *drawn) -> stamp [s]."""

    def change(start: Start, draft: Draft) -> None:
        values, topics = start.drawn(draws), start.pick(choices)
        for item in draft.items:
            item.stamp = new(item.stamp, *values) if is_on(topics, item.topic) else item.stamp

    return change


def times(new: Callable[..., tuple[float, float]], *draws: Any) -> Change:
    """Change stamp and log time of all messages: (stamp, log time, *drawn) -> both [s]."""

    def change(start: Start, draft: Draft) -> None:
        values = start.drawn(draws)
        for item in draft.items:
            item.stamp, item.log = new(item.stamp, item.log, *values)

    return change


def readings(new: Callable[..., dict[str, Any]], *draws: Any) -> Change:
    """Change fields of the scans: (content, *drawn) -> changed fields."""

    def change(start: Start, draft: Draft) -> None:
        values = start.drawn(draws)
        for reading in draft.readings:
            reading |= new(reading, *values)

    return change


def contents(topics: tuple[str, ...], new: Callable[..., dict[str, Any]], *draws: Any) -> Change:
    """Change fields of the messages of some topics: (content, *drawn) -> changed fields."""

    def change(start: Start, draft: Draft) -> None:
        values = start.drawn(draws)
        for item in draft.items:
            item.content = item.content | new(item.content, *values) if item.topic in topics else item.content

    return change


def kept(wanted: Callable[..., bool], *draws: Any) -> Change:
    """Drop the other messages: (message, *drawn) -> whether it is wanted."""

    def change(start: Start, draft: Draft) -> None:
        values = start.drawn(draws)
        draft.keep(lambda item: wanted(item, *values))

    return change
