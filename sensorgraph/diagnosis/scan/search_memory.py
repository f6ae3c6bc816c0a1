"""What the forward selection remembers of earlier rounds, so that it fits few candidates twice: lazy greedy search.

The gain of an effect rarely grows as other effects enter the model, because they explain readings that it would explain.
The gain of an earlier round therefore bounds the present one, and a candidate whose bound is far below the best gain of a
round is not fitted (Minoux 1978, Accelerated greedy algorithms for maximizing submodular set functions). The bound is not
certain. It is void where the score test expects more than it did at that fit. It is used only next to a candidate that
surely enters the model, so a search ends with a round that fits every candidate.

A candidate whose expected gain is the same as in the bare model is not a remainder of an accepted effect (`FirstGains`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

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


@dataclass(frozen=True)
class EarlierFit:
    """The gain [nats] that the best start of an effect had, and the largest that was expected of its starts."""

    gain: float = -math.inf
    expected: float = -math.inf


@dataclass(eq=False)
class SearchMemory:
    """Candidates of the rounds so far."""

    struck: set[tuple[str, str]] = field(default_factory=set)
    """Effects and places that were removed from the model."""
    first: FirstGains = field(default_factory=FirstGains)
    """Gains expected in the bare model."""
    is_lazy: bool = False
    """Whether the present round may pass candidates by."""
    has_passed: bool = False
    """Whether it has passed any by."""
    at_specified: list[Candidate] | None = None
    """Candidates of the last search with the specified tolerances."""
    _fits: dict[str, EarlierFit] = field(default_factory=dict)
    _this_round: dict[str, EarlierFit] = field(default_factory=dict)

    def begin(self) -> None:
        """Begin a round."""
        self._fits |= self._this_round
        self._this_round = {}
        self.has_passed = False

    def repeat_in_full(self) -> bool:
        """Let the next round fit every candidate, and return whether this round did not."""
        self.is_lazy = False
        return self.has_passed

    def note(self, candidate: Candidate, gain: float) -> None:
        """Store the gain [nats] of a fit in this round; of several starts of an effect at a place, the largest counts."""
        key = name_at_place(candidate.amendment)
        known = self._this_round.get(key, EarlierFit())
        self._this_round[key] = EarlierFit(
            gain=max(known.gain, gain), expected=max(known.expected, candidate.gain)
        )

    def bound(self, candidate: Candidate) -> float:
        """Return the gain [nats] that a candidate had at its last fit; inf without a fit, or if more is expected now."""
        known = self._fits.get(name_at_place(candidate.amendment))
        if known is None or candidate.gain > known.expected / SCAN.selection.same_gain:
            return math.inf
        return known.gain

    def most_promising_first(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Return the candidates in the order in which they are fitted."""
        return sorted(candidates, key=lambda c: -self.bound(c)) if self.is_lazy else list(candidates)

    def specified(self, model: Sequence[Amendment]) -> list[Candidate]:
        """Return the candidates of the last search with the specified tolerances, without those in the model."""
        present = {name_at_place(a) for a in model}
        return [
            c
            for c in self.at_specified or ()
            if name_at_place(c.amendment) not in present
            and (c.amendment.name, c.amendment.place) not in self.struck
        ]
