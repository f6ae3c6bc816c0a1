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
    if not allowed.any():
        allowed = np.ones(n, dtype=np.bool_)
    stacks = [_StackedQuadratics(quadratics) for quadratics in per_second]
    time: Floats = np.where(allowed, duration / allowed.sum(), 0.0)
    for step in range(NEXT_RUN.forecast.n_allocation_steps):
        slope = np.zeros(n)
        for forecast, stack in zip(forecasts, stacks, strict=True):
            total = stack.total(time)
            x = forecast.refitted(total)
            slope += stack.at(x) / (NEXT_RUN.forecast.half_weight_nats + max(total.at(x), 0.0))
        size = 2.0 / (step + 3.0)  # of Frank and Wolfe
        time *= 1 - size
        time[int(np.where(allowed, slope, -np.inf).argmax())] += size * duration
    return time


class _StackedQuadratics:
    """The quadratics of n motions as arrays with n as the first axis."""

    def __init__(self, quadratics: Sequence[EvidenceQuadratic]) -> None:
        self.matrix = np.stack([q.matrix for q in quadratics])
        self.right = np.stack([q.right for q in quadratics])
        self.squares = np.array([q.squares for q in quadratics])
        self.constant = np.array([q.constant for q in quadratics])

    def total(self, time: Floats) -> EvidenceQuadratic:
        """Return the evidence of a drive that gives each motion this time (n,) [s]."""
        return EvidenceQuadratic(
            matrix=np.tensordot(time, self.matrix, 1),
            right=time @ self.right,
            squares=float(time @ self.squares),
            constant=float(time @ self.constant),
        )

    def at(self, x: Floats) -> Floats:
        """Return the nats per second (n,) at refitted values x (k,)."""
        return np.asarray(self.constant + 0.5 * (self.squares - 2 * self.right @ x + (self.matrix @ x) @ x))
