"""Expected gains in the bare model: a candidate that still has its gain is not a remainder of an accepted effect."""

from __future__ import annotations

from collections.abc import Sequence

from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment


class FirstGains:
    """Expected gains [nats] of each start of an effect in the bare model, as long as they are still expected.

    An effect may have several starts. For example, a ray that a part of the robot hides has a separate gain; next to it, a
    sector appears hidden until an obstacle is in the model.
    """

    def __init__(self) -> None:
        self._gains: dict[str, list[float]] = {}
        self.latest: dict[str, Candidate] = {}
        """Name of each effect -> the start with the largest gain that was expected last."""

    def note(self, candidates: Sequence[Candidate]) -> None:
        """Store the best start of each effect."""
        self.latest = {}
        for c in sorted(candidates, key=lambda c: -c.gain):
            self.latest.setdefault(c.amendment.name, c)

    def compare(self, candidates: Sequence[Candidate], *, is_first: bool) -> None:
        """Store the gains expected in the bare model; later, drop those that are no longer expected of any start."""
        for key in {name_at_place(c.amendment) for c in candidates}:
            now = [c.gain for c in candidates if name_at_place(c.amendment) == key]
            noted = self._gains.get(key, [])
            self._gains[key] = [*noted, *now] if is_first else [g for g in noted if _is_among(g, now)]

    def has(self, candidate: Candidate) -> bool:
        """Return whether the same gain was expected of a start of this effect, also at the last comparison."""
        return _is_among(candidate.gain, self._gains.get(name_at_place(candidate.amendment), []))

    def still_has(self, amendment: Amendment) -> bool:
        """Return whether any of the first gains of an effect is still expected."""
        return bool(self._gains.get(name_at_place(amendment)))


def name_at_place(amendment: Amendment) -> str:
    """Return the name of an effect with its place: `glass@hall/edge_2`."""
    return f"{amendment.name}@{amendment.place}"


def _is_among(gain: float, gains: Sequence[float]) -> bool:
    ratio = SCAN.selection.same_gain
    return any(ratio * other < gain < other / ratio for other in gains)
