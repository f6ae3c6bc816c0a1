"""How a log is made odd: a kind is a row of changes of its messages, each with the values that it draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.fuzz.structure import drives
from benchmarks.fuzz.structure.draft import Draft, Item, Laser, add_reference, base_draft, logged
from benchmarks.fuzz.structure.drives import Floats
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
SCANS, ODOM, WHEELS, STATIC, ALL = ("/scan",), ("/odom",), ("/odom", "/tf"), ("/tf_static",), ()
"""Topics of some messages; none: all messages."""


class Span(NamedTuple):
    """Two numbers, between which one is drawn."""

    low: float
    high: float


RNG = object()
"""Instead of a value: the random numbers, for a change that differs from message to message."""


@dataclass
class Start:
    """Draws of one log."""

    rng: np.random.Generator

    def draw(self, what: Any) -> Any:
        """Draw a number of a span, a yes or no of a share, or one of several values; a single value is itself."""
        if isinstance(what, Span):
            return float(self.rng.uniform(*what))
        if isinstance(what, float):
            return bool(self.rng.random() < what)
        if isinstance(what, tuple):
            return what[int(self.rng.integers(len(what)))]
        return self.rng if what is RNG else what

    def draft(
        self, laser: Any = None, *, drive: Any = drives.ROOMS, spins: Any = None, reference: float = 0.3,
        **changes: Any,
    ) -> Draft:  # fmt: skip
        """Return a log without anything odd.

        Parameters
        ----------
        laser : The laser, several of which one is drawn, or what draws one; None: one of `LASERS`.
        spins : Whether the laser must be one that spins.
        reference : Probability of a reference pose in the log.
        changes : Changed fields of the laser.
        """
        fields = {name: self.draw(what) for name, what in changes.items()}
        wanted = self.draw(spins)
        suitable = tuple(one for one in LASERS if wanted is None or (one.sweep != 0) == wanted)
        one = laser(self) if callable(laser) else self.draw(laser or suitable)
        draft = base_draft(drives.load(self.draw(drive)), self.rng, replace(one, **fields))
        draft.container = self.draw(PLAIN)
        if self.draw(float(reference)):
            add_reference(draft)
            draft.expects.add("pose")
        if self.draw(0.5):  # the number of each scan, by which it is recognised in what was read
            for item in draft.scans:
                item.content["intensities"] = item.scan + np.linspace(0.25, 0.75, len(item.content["ranges"]))
        return draft


Kind = Callable[[Start], Draft]
"""Makes an odd log."""
Change = Callable[[Start, Draft], None]
"""Makes a log odd."""


def kind(
    *changes: Change, said: str = "", usable: Any = True, gauges: tuple[str, ...] = (), lacks: Any = (),
    adds: tuple[str, ...] = (), containers: tuple[str, ...] = (), words: tuple[str, ...] = (),
    empty: tuple[tuple[str, str], ...] = (), **options: Any,
) -> Kind:  # fmt: skip
    """Return a kind by what changes a log without anything odd.

    Parameters
    ----------
    said, gauges, empty : as in `Draft`
    usable, lacks, adds : as in `Draft`; roles that the reader need not find; those that it must find as well. The first two
        may depend on the log.
    containers : one of these is used
    words : further words for both commands
    options : of `Start.draft`
    """

    def make(start: Start) -> Draft:
        draft = start.draft(**options)
        for change in changes:
            change(start, draft)
        draft.said, draft.usable = said, usable(draft) if callable(usable) else usable
        draft.gauges |= {*gauges}
        draft.expects = (draft.expects | {*adds}) - {*(lacks(draft) if callable(lacks) else lacks)}
        draft.container = start.draw(containers or draft.container)
        draft.options, draft.empty = [*draft.options, *words], [*draft.empty, *empty]
        return draft

    return make


def call(change: Callable[..., object], *draws: Any, **named: Any) -> Change:
    """Change a log: (log, *drawn)."""

    def make(start: Start, draft: Draft) -> None:
        values = [start.draw(what) for what in draws]
        change(draft, *values, **{name: start.draw(what) for name, what in named.items()})

    return make


def sometimes(*changes: Change, share: float = 0.5) -> Change:
    """Make changes with a probability."""

    def make(start: Start, draft: Draft) -> None:
        for change in changes if start.draw(share) else ():
            change(start, draft)

    return make


def either(*changes: Change) -> Change:
    """Make one of some changes."""
    return lambda start, draft: start.draw(changes)(start, draft)


def is_on(topics: tuple[str, ...], topic: str) -> bool:
    """Tell whether a topic is one of some."""
    return not topics or topic in topics


def changed(topics: tuple[str, ...], new: Callable[..., dict[str, Any]], *draws: Any) -> Change:
    """Change messages of some topics: (message, *drawn) -> changed fields; those of `content` are added to it."""

    def change(start: Start, draft: Draft) -> None:
        values = [start.draw(what) for what in draws]
        for item in draft.items:
            if is_on(topics, item.topic):
                _set(item, new(item, *values))

    return change


def _set(item: Item, facts: dict[str, Any]) -> None:
    for name, value in facts.items():
        setattr(item, name, item.content | value if name == "content" else value)


def stamps(choices: tuple[tuple[str, ...], ...], new: Callable[..., float], *draws: Any) -> Change:
    """Change the stamps of the messages of one choice of topics: (stamp, *drawn) -> stamp [s]."""

    def change(start: Start, draft: Draft) -> None:
        values = [start.draw(what) for what in draws]
        changed(start.draw(choices), lambda m: {"stamp": new(m.stamp, *values)})(start, draft)

    return change


def times(new: Callable[..., tuple[float, float]], *draws: Any) -> Change:
    """Change stamp and log time of all messages: (stamp, log time, *drawn) -> both [s]."""
    return changed(
        ALL, lambda m, *values: dict(zip(("stamp", "log"), new(m.stamp, m.log, *values), strict=True)), *draws
    )


def contents(topics: tuple[str, ...], new: Callable[..., dict[str, Any]], *draws: Any) -> Change:
    """Change fields of the messages of some topics: (content, *drawn) -> changed fields."""
    return changed(topics, lambda m, *values: {"content": new(m.content, *values)}, *draws)


def readings(new: Callable[..., dict[str, Any]], *draws: Any) -> Change:
    """Change fields of the scans: (content, *drawn) -> changed fields."""
    return contents(SCANS, new, *draws)


def again(topics: tuple[str, ...], new: Callable[..., dict[str, Any] | None], *draws: Any) -> Change:
    """Add messages of some topics once more: (message, *drawn) -> changed fields; None: not this one."""

    def change(start: Start, draft: Draft) -> None:
        values = [start.draw(what) for what in draws]
        for item in [item for item in draft.items if is_on(topics, item.topic)]:
            facts = new(item, *values)
            if facts is not None:
                copy = replace(item, arrival=np.nan)
                _set(copy, facts)
                draft.add(replace(copy, arrival=np.nan if "log" in facts else item.arrival))

    return change


def publish(
    topic: str, kind: str, rows: Callable[..., Iterable[tuple[float, Any]]], *draws: Any, frame: str = "map"
) -> Change:
    """Add a topic: (log, *drawn) -> time [s] and content of each message."""

    def change(start: Start, draft: Draft) -> None:
        for t, content in rows(draft, *[start.draw(what) for what in draws]):
            draft.add(Item(topic, kind, t, logged(t, draft.rng), frame, content))

    return change


def transforms(
    parent: str, child: str, rows: Callable[..., Iterable[tuple[float, Floats]]], *draws: Any
) -> Change:
    """Add a transform in /tf: (log, *drawn) -> time [s] and value at each."""

    def contents(draft: Draft, *values: Any) -> list[tuple[float, Any]]:
        return [(t, {"transforms": [(parent, child, value)]}) for t, value in rows(draft, *values)]

    return publish("/tf", "TFMessage", contents, *draws, frame="")


def static(*edges: tuple[str, str, Floats]) -> Change:
    """Add static transforms."""
    return call(lambda draft: draft.add_static(*edges))


def kept(wanted: Callable[..., bool], *draws: Any) -> Change:
    """Drop the other messages: (message, *drawn) -> whether it is wanted."""
    return call(lambda draft, *values: draft.keep(lambda item: wanted(item, *values)), *draws)


def dropped(*topics: str) -> Change:
    """Drop topics."""
    return kept(lambda m: m.topic not in topics)


def gap(topics: tuple[str, ...], at: Span, *widths: float) -> Change:
    """Drop the messages of some seconds."""
    return kept(
        lambda m, first, width: not is_on(topics, m.topic) or m.topic in STATIC or not first < m.stamp < first + width,
        at, widths,
    )  # fmt: skip


def renamed(topic: str, *names: str) -> Change:
    """Rename a topic."""
    return changed((topic,), lambda m, name: {"topic": name}, names)


def frames(new: Callable[..., str], *draws: Any) -> Change:
    """Rename frames everywhere: (name, *drawn) -> name."""
    return call(lambda draft, *values: draft.frames(lambda name: new(name, *values)), *draws)


def edges(new: Callable[..., list[tuple[str, str, Floats]]], *draws: Any, child: str = "") -> Change:
    """Replace transforms, or those of one child: (parent, child, value, *drawn) -> others."""
    return call(lambda draft, *values: draft.edges(lambda *edge: new(*edge, *values), child=child), *draws)


def odometry(new: Callable[..., Floats], *draws: Any) -> Change:
    """Let the odometry and its transform state other poses: (poses (n, 3), times (n,), *drawn) -> poses."""
    return call(
        lambda draft, *values: draft.state(new(draft.drive.odometry.copy(), draft.drive.odom_times, *values)),
        *draws,
    )
