"""Gains that were expected of effects before the model had any: what still stands mends no rim of what was found since."""

from __future__ import annotations

from collections.abc import Sequence

from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment


class FirstGains:
    """What each start of an effect was to gain [nats] in the bare model, as long as as much is expected of one.

    An effect may begin at several starts: a ray that a part of the robot hides has a gain of its own beside a sector that seems
    hidden until an obstacle is in the model.
    """

    def __init__(self) -> None:
        self._gains: dict[str, list[float]] = {}

    def compare(self, candidates: Sequence[Candidate], *, is_first: bool) -> None:
        """Note what is expected in the bare model; later, forget what is no longer expected of any start."""
        for key in {name_at_place(c.amendment) for c in candidates}:
            now = [c.gain for c in candidates if name_at_place(c.amendment) == key]
            noted = self._gains.get(key, [])
            self._gains[key] = [*noted, *now] if is_first else [g for g in noted if _is_among(g, now)]

    def has(self, candidate: Candidate) -> bool:
        """Tell whether as much was expected of one start of this effect, and still was when last compared."""
        return _is_among(candidate.gain, self._gains.get(name_at_place(candidate.amendment), []))

    def still_has(self, amendment: Amendment) -> bool:
        """Tell whether anything of what was expected of an effect is still."""
        return bool(self._gains.get(name_at_place(amendment)))


def name_at_place(amendment: Amendment) -> str:
    """Return what an effect is called with where it sits: `glass@hall/edge_2`."""
    return f"{amendment.name}@{amendment.place}"


def _is_among(gain: float, gains: Sequence[float]) -> bool:
    ratio = SCAN.selection.same_gain
    return any(ratio * other < gain < other / ratio for other in gains)
