"""Probability of a named effect, and its strongest rival."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.result import Rival
from sensorgraph.effects import Effect


def probability(evidence: float, alternatives: Iterable[float]) -> float:
    """Return the probability of an effect, against its alternatives and no effect.

        p = exp(evidence / temperature) / sum over candidates of exp(evidence_i / temperature)

    The evidence [nats] of no effect is 0.
    """
    values = np.array([evidence, *alternatives, 0.0]) / EVIDENCE.temperature
    share = np.exp(values - values.max())
    share /= share.sum()
    return float(share[0])


def strongest_rival(effect: Effect, alternatives: Mapping[Effect, float]) -> Rival | None:
    """Return the alternative with the largest evidence [nats]; None if it would not be named instead."""
    best = max(alternatives, key=lambda other: alternatives[other], default=None)
    if best is None or alternatives[best] < EVIDENCE.threshold:
        return None
    advice = effect.rivals.get(best.name) or best.rivals.get(effect.name) or effect.varies
    return Rival(name=best.name, instead_of=effect.name, evidence_nats=alternatives[best], separates=advice)
