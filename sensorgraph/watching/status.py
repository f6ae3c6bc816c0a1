"""The three statements about pose, place and robot at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sensorgraph.robust import MAJORITY
from sensorgraph.watching.evidence import FaultDoubt
from sensorgraph.watching.place_changes import MovedThing, PlaceChange
from sensorgraph.watching.pose import PoseStatement

SHOWN = 0.01
"""Probability above which a hypothesis is listed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WatchStatus:
    """What is known at one time."""

    t: float
    """[s] since the start of the run."""
    pose: PoseStatement
    changes: Sequence[PlaceChange]
    """What came and what is gone in the place."""
    moved: Sequence[MovedThing] = ()
    """Pairs of these that are one thing."""
    share_predicted: float | None
    """Share of the recent readings that the graph predicts."""
    doubts: Sequence[FaultDoubt]
    """Hypotheses about laser and wheels, the most probable first."""
    notes: Sequence[str] = ()
    """Faults of the input since the last status, one line each."""

    def __repr__(self) -> str:
        """Summarise the time and the three sentences."""
        return "\n  ".join([f"WatchStatus at {self.t:.1f} s", *self.sentences()])

    @property
    def faults(self) -> list[FaultDoubt]:
        """The named faults of laser and wheels."""
        return [doubt for doubt in self.doubts if doubt.p > MAJORITY]

    @property
    def n_changes(self) -> int:
        """Number of changes of the place; a thing that moved is one."""
        return len(self.changes) - len(self.moved)

    def sentences(self) -> tuple[str, str, str]:
        """Return one sentence each on pose, place and robot."""
        return f"pose {self.pose.sentence()}", f"place {self._place()}", f"robot {self._robot()}"

    def _place(self) -> str:
        share = (
            ""
            if self.share_predicted is None
            else f"{100 * self.share_predicted:.0f} % as the graph predicts"
        )
        paired = [change for thing in self.moved for change in (thing.gone, thing.new)]
        alone = [change for change in self.changes if not any(change is one for one in paired)]
        new, gone = ([change for change in alone if change.kind == kind] for kind in ("new", "gone"))
        told = [
            f"{len(some)} {word} (the largest {max(some, key=lambda one: float(one.size.max())).size.max():.1f} m at "
            f"{tuple(round(float(v), 1) for v in max(some, key=lambda one: float(one.size.max())).centre)} m)"
            for some, word in ((new, "new"), (gone, "gone"))
            if some
        ]
        if self.moved:
            most = max(self.moved, key=lambda one: one.distance)
            n, at = len(self.moved), tuple(round(float(v), 1) for v in most.new.centre)
            told.append(f"{n} moved ({'the furthest ' * (n > 1)}by {most.distance:.2f} m to {at} m)")
        return "; ".join([part for part in (share, *told) if part]) or "not seen yet"

    def _robot(self) -> str:
        return "; ".join(doubt.sentence() for doubt in self.faults) or "ok"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as `watch --json` writes it."""
        share = self.share_predicted
        return {
            "t": round(self.t, 3),
            "pose": self.pose.to_dict(),
            "place": {
                "share_predicted": None if share is None else round(share, 4),
                "new": [change.to_dict() for change in self.changes if change.kind == "new"],
                "gone": [change.to_dict() for change in self.changes if change.kind == "gone"],
                "moved": [thing.to_dict() for thing in self.moved],
            },
            "robot": [doubt.to_dict() for doubt in self.doubts if doubt.p > SHOWN],
            "notes": list(self.notes),
        }
