"""WatchSummary of a watched run: intervals of equal statements, the tracked path, and the next step."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from sensorgraph.types import Floats
from sensorgraph.watching.policy import Level
from sensorgraph.watching.settings import BELIEF_FAULT
from sensorgraph.watching.status import WatchStatus

MOST_POINTS = 4000
"""Number of statements that are kept for the path; older ones are thinned."""


ROWS = ("pose", "place", "robot")
"""The three statements."""


def words_of(status: WatchStatus) -> tuple[str, str, str]:
    """Return a word for each of the three statements; that of the pose is `unknown` outside what the graph knows."""
    is_outside = status.pose.status == "ok" and not status.pose.is_known_place
    return (
        "unknown" if is_outside else status.pose.status,
        "changed" if status.changes else "ok",
        "fault" if status.faults else "ok",
    )


@dataclass(frozen=True, kw_only=True)
class Span:
    """An interval with one statement."""

    first: float
    """[s] since the first statement."""
    last: float
    word: str
    text: str


@dataclass(frozen=True, kw_only=True, eq=False)
class PageData:
    """What the page shows."""

    run_name: str
    graph_name: str
    duration: float
    level: Level
    headline: str
    at_the_end: Sequence[str]
    """The statements of the end, after a line with their time."""
    next_step: str
    last: WatchStatus
    pose_spans: Sequence[Span]
    place_spans: Sequence[Span]
    robot_spans: Sequence[Span]
    path: Floats
    """(n, 3) tracked poses, nan where unknown."""
    path_pieces: Sequence[tuple[int, int, str]]
    """First and end of pieces of the path, and their word."""
    times: Floats
    """(n,) [s] since the first statement, of the poses of the path; `words`, `p_wrong` and `shares` likewise."""
    words: Sequence[str]
    p_wrong: Floats
    shares: Floats
    """Share of the readings that the graph predicts; nan where unknown."""
    walls: Floats
    """(n, 2, 2) [m, map]"""
    notes: Sequence[str]


class WatchSummary:
    """Collects statements in constant memory.

    Parameters
    ----------
    run : File of the run; None: a live robot, of which the next step records a run.
    graph : File of the graph.
    can_update : Whether `build --update` takes the graph.
    """

    def __init__(
        self, run: Path | None = None, graph: Path | None = None, *, can_update: bool = True
    ) -> None:
        self.run, self.graph, self.can_update = run, graph, can_update
        self.spans: dict[str, list[Span]] = {row: [] for row in ROWS}
        self.points: list[tuple[float, str, Floats, float, float]] = []
        self.notes: list[str] = []
        self.first: float | None = None
        self.last: WatchStatus | None = None
        self.level: Level = "ok"
        self.reason = ""
        self.since: float | None = None
        """[s] since the first statement, when the level was first reached; None: the reason is about the whole run."""
        self.n_statements = 0
        self.n_outside = 0
        """Number of statements that the robot is outside what the graph knows."""
        self._every = 1
        self._most = 0.0, 0.0
        """[m, rad] Largest offsets of the believed pose since it was first off."""

    def add(self, status: WatchStatus, level: Level, reason: str) -> None:
        """Add one statement."""
        self.first = status.t if self.first is None else self.first
        t, words = status.t - self.first, words_of(status)
        for row, word, text in zip(
            ROWS, words, (self._pose_text(status), *status.sentences()[1:]), strict=True
        ):
            self._extend(row, t, word, text)
        if self.n_statements % self._every == 0:
            at = np.full(3, np.nan) if status.pose.pose is None else status.pose.pose
            share = np.nan if status.share_predicted is None else status.share_predicted
            self.points.append((t, words[0], at, status.pose.p_wrong, share))
        if len(self.points) > MOST_POINTS:
            self.points, self._every = self.points[::2], 2 * self._every
        self.notes = [*self.notes, *status.notes][-100:]
        self.n_statements += 1
        self.n_outside += words[0] == "unknown"
        self.last = status
        order = ("ok", "warning", "error")
        if order.index(level) > order.index(self.level):
            self.level, self.reason, self.since = level, reason, t

    def conclude(self) -> None:
        """Warn if the graph knew the surroundings at no time, so that nothing was judged; otherwise, state how often not."""
        if self.level != "ok" or self.n_outside == 0:
            return
        self.reason = f"the pose was not judged in {self.n_outside:,} of {self.n_statements:,} statements, outside what the graph knows"
        if self.n_outside == self.n_statements:
            self.level = "warning"
            self.reason = (
                "the robot was never where the graph knows the surroundings: it is another place, or the poses are in another "
                "frame than the graph"
            )

    def result(self) -> str:
        """Return the level of the run, since when, and why: the statement of that time, not of the end."""
        at = "" if self.since is None else f" at {self.since:.0f} s"
        return f"{self.level}{at}{': ' + self.reason if self.reason else ''}"

    def at_the_end(self) -> list[str]:
        """Return the statements of the end, after a line with their time."""
        if self.last is None or self.first is None:
            return []
        return [f"at the end, {self.last.t - self.first:.0f} s:", *self.last.sentences()]

    def _pose_text(self, status: WatchStatus) -> str:
        """Return the sentence on the pose for its interval: while it is off, with the largest offset since it was first off."""
        pose, text = status.pose, status.sentences()[0]
        if pose.status != "off" or not pose.is_known_place:
            self._most = 0.0, 0.0
            return text
        self._most = max(self._most[0], pose.offset[0]), max(self._most[1], pose.offset[1])
        return f"pose off by up to {self._most[0]:.2f} m and {math.degrees(self._most[1]):.0f}°: at last, the robot is at {pose.place()}"

    def _extend(self, row: str, t: float, word: str, text: str) -> None:
        spans = self.spans[row]
        if spans and spans[-1].word == word:
            spans[-1] = Span(first=spans[-1].first, last=t, word=word, text=text)
            return
        if spans:
            spans[-1] = Span(first=spans[-1].first, last=t, word=spans[-1].word, text=spans[-1].text)
        if len(spans) < MOST_POINTS:
            spans.append(Span(first=t, last=t + 1.0, word=word, text=text))

    def next_step(self) -> str:
        """Return what to do next, with a command to paste: update the graph, or a run that settles a doubt."""
        if self.last is None:
            return ""
        told = []
        record = "sensorgraph record --live -o run.mcap && " if self.run is None else ""
        lasting = [change for change in self.last.changes if change.p > 0.9]
        if lasting and self.last.pose.status == "ok":
            told.append(
                f"{len(lasting)} change{'s' * (len(lasting) > 1)} may be for good: {self._build(record)}"
            )
        faults = [fault for fault in self.last.faults if fault.name != BELIEF_FAULT.name]  # of no effect
        if faults:
            told.append(
                f"the next run that settles {faults[0].name} is named by: "
                f"{record}sensorgraph diagnose {self._run()} -o diagnosis"
            )
        return "; ".join(told)

    def _run(self) -> str:
        return shlex.quote("run.mcap" if self.run is None else str(self.run))

    def _build(self, record: str) -> str:
        """Return the command that adds the run to the graph, or why there is none."""
        if not self.can_update:
            return f"build the graph again from its runs and {self._run()}; --update cannot add a run to this graph"
        old = Path("graph.sensorgraph") if self.graph is None else self.graph
        new = old.with_name(f"{old.stem}_updated.sensorgraph")
        return f"{record}sensorgraph build {self._run()} --update {shlex.quote(str(old))} -o {shlex.quote(str(new))}"

    def page(self, run_name: str, graph_name: str, walls: Floats) -> PageData:
        """Return what the page shows."""
        assert self.last is not None and self.first is not None
        times, words, path, p_wrong, shares = zip(*self.points, strict=True)
        edges = [0, *(k for k in range(1, len(words)) if words[k] != words[k - 1]), len(words)]
        pieces = [(a, min(b + 1, len(words)), words[a]) for a, b in pairwise(edges)]
        return PageData(
            run_name=run_name, graph_name=graph_name, duration=self.last.t - self.first, level=self.level,
            headline=self.result() if self.reason else "ok: pose, place and robot as expected",
            at_the_end=self.at_the_end(), next_step=self.next_step(), last=self.last, pose_spans=self.spans["pose"],
            place_spans=self.spans["place"], robot_spans=self.spans["robot"],
            path=np.array(path), path_pieces=pieces, walls=walls,
            times=np.array(times), words=words, p_wrong=np.array(p_wrong), shares=np.array(shares),
            notes=self.notes,
        )  # fmt: skip
