"""Choose hypotheses by evidence: add the best one, refit, and remove those that the others make superfluous.

    E(h | M) = log p(data | M with h) - log p(data | M without h) - price of h.

A hypothesis enters the model M if its evidence E is at least the threshold, and stays as long as it has what it needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

H = TypeVar("H")


class EvidenceChannel(Protocol[H]):
    """Measurements that hypotheses compete to explain.

    A refit may replace hypotheses in the list by the same ones with other values, or by fewer that explain as much.
    """

    def best(self, model: Sequence[H]) -> tuple[H, float] | None:
        """Return the best further hypothesis and its evidence [nats]; None if no further one is worthwhile."""
        ...

    def added(self, model: list[H]) -> None:
        """Refit after the last hypothesis of the model has entered."""
        ...

    def removed(self, model: list[H]) -> None:
        """Refit after a hypothesis was removed from the model."""
        ...

    def evidence(self, model: Sequence[H], hypothesis: H) -> float:
        """Return the evidence [nats] for a hypothesis of the model in addition to the others."""
        ...

    def needed(self, model: Sequence[H], hypothesis: H) -> float:
        """Return the evidence [nats] that a hypothesis needs to stay in the model."""
        ...


def select(channel: EvidenceChannel[H], *, threshold: float, most: int) -> list[H]:
    """Return at most `most` hypotheses with enough evidence, in the order in which they entered.

    Parameters
    ----------
    threshold : [nats] Evidence that a hypothesis needs to enter.
    """
    model: list[H] = []
    while len(model) < most:
        found = channel.best(model)
        if found is None or found[1] < threshold:
            break
        model.append(found[0])
        channel.added(model)
        remove_superfluous(channel, model)
    return model


def remove_superfluous(channel: EvidenceChannel[H], model: list[H]) -> None:
    """Remove the hypotheses that have less evidence than they need, the weakest first."""
    while model:
        spare = [channel.evidence(model, one) - channel.needed(model, one) for one in model]
        weakest = spare.index(min(spare))
        if spare[weakest] >= 0.0:
            return
        del model[weakest]
        channel.removed(model)
