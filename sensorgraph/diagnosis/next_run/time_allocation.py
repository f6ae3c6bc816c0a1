"""How much of the time of a run each motion gets, so that together they bring the most evidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.next_run.forecast import EvidenceForecast, EvidenceQuadratic
from sensorgraph.diagnosis.next_run.settings import NEXT_RUN
from sensorgraph.types import Bools, Floats


def allocate_time(
    forecasts: Sequence[EvidenceForecast],
    per_second: Sequence[list[EvidenceQuadratic]],
    duration: float,
    allowed: Bools,
) -> Floats:
    """Allocate the time of a run (n,) [s] among the `allowed` motions (n,), or among all if none is.

    Maximises the sum over questions of log(half_weight_nats + nats) by Frank and Wolfe's method (Naval Research
    Logistics Quarterly 3, 1956), so that no question is forgotten for another.

    Parameters
    ----------
    per_second : the evidence of one second of each motion, for each question
    duration : [s] of the run
    """
    n = len(allowed)
    some = np.flatnonzero(allowed) if allowed.any() else np.arange(n)
    stacks = [_StackedQuadratics([quadratics[i] for i in some]) for quadratics in per_second]
    time = np.full(len(some), duration / len(some))
    totals = [stack.mean() * duration for stack in stacks]
    for step in range(NEXT_RUN.forecast.n_allocation_steps):
        slope = np.zeros(len(some))
        for forecast, stack, total in zip(forecasts, stacks, totals, strict=True):
            x = forecast.refitted(total)
            slope += stack.at(x) / (NEXT_RUN.forecast.half_weight_nats + max(total.at(x), 0.0))
        size = 2.0 / (step + 3.0)  # of Frank and Wolfe
        best = int(slope.argmax())
        time *= 1 - size
        time[best] += size * duration
        totals = [
            total * (1 - size) + quadratics[some[best]] * (size * duration)
            for total, quadratics in zip(totals, per_second, strict=True)
        ]
    out = np.zeros(n)
    out[some] = time
    return out


class _StackedQuadratics:
    """The quadratics of n motions as arrays with n as the first axis."""

    def __init__(self, quadratics: Sequence[EvidenceQuadratic]) -> None:
        self.matrix = np.stack([q.matrix for q in quadratics])
        self.right = np.stack([q.right for q in quadratics])
        self.squares = np.array([q.squares for q in quadratics])
        self.constant = np.array([q.constant for q in quadratics])

    def mean(self) -> EvidenceQuadratic:
        """Return the mean of the motions."""
        return EvidenceQuadratic(
            matrix=self.matrix.mean(axis=0),
            right=self.right.mean(axis=0),
            squares=float(self.squares.mean()),
            constant=float(self.constant.mean()),
        )

    def at(self, x: Floats) -> Floats:
        """Return the nats per second (n,) at refitted values x (k,)."""
        return np.asarray(self.constant + 0.5 * (self.squares - 2 * self.right @ x + (self.matrix @ x) @ x))
