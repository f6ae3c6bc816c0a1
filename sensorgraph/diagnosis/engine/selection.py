"""Choose hypotheses by evidence: add the best one, refit, and remove those that the others make superfluous.

    E(h | M) = log p(data | M with h) - log p(data | M without h) - price of h.

A hypothesis enters the model M if its evidence E is at least the threshold, and stays as long as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np

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


def select(channel: EvidenceChannel[H], *, threshold: float, most: int) -> list[H]:
    """Return at most `most` hypotheses with enough evidence, in the order in which they entered.

    Parameters
    ----------
    threshold : [nats] Evidence that a hypothesis needs to enter and to stay.
    """
    model: list[H] = []
    while len(model) < most:
        found = channel.best(model)
        if found is None or found[1] < threshold:
            break
        model.append(found[0])
        channel.added(model)
        remove_superfluous(channel, model, threshold=threshold)
    return model


def remove_superfluous(channel: EvidenceChannel[H], model: list[H], *, threshold: float) -> None:
    """Remove the hypotheses with less evidence than the threshold [nats], the weakest first."""
    while model:
        evidence = [channel.evidence(model, one) for one in model]
        weakest = evidence.index(min(evidence))
        if evidence[weakest] >= threshold:
            return
        del model[weakest]
        channel.removed(model)


def occam_factor(n_parameters: int, n_data: int) -> float:
    """Return the complexity penalty [nats] of free parameters in a fit of `n_data` measurements.

        price = ½ k log n

    It is the Occam factor of a Gaussian prior that holds as much information on the k parameters as one of the n measurements
    (Schwarz 1978; Kass and Wasserman 1995, "A reference Bayesian test for nested hypotheses").
    """
    return 0.5 * n_parameters * float(np.log(max(n_data, 1)))
