"""What the forward selection remembers of earlier rounds, so that it fits few candidates twice: lazy greedy search.

The gain of an effect rarely grows as other effects enter the model, because they explain readings that it would explain.
The gain of an earlier round therefore bounds the present one, and a candidate whose bound is far below the best gain of a
round is not fitted (Minoux 1978, Accelerated greedy algorithms for maximizing submodular set functions). The bound is not
certain. It is void where the score test expects more than it did at that fit. It is used only next to a candidate that
surely enters the model, so a search ends with a round that fits every candidate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from sensorgraph.diagnosis.scan.first_gains import FirstGains, name_at_place
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment


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
