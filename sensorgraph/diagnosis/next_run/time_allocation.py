"""Allocate the time of a run among motions, so that together they bring the most evidence.

    maximise  sum over questions of log(1 + nats)   subject to   sum of time = duration, time >= 0

The evidence nats of a question is the minimum, over the refitted values, of functions that are linear in time
(`forecast`). It is therefore concave in time, and so is the sum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.next_run.forecast import EvidenceForecast, EvidenceQuadratic
from sensorgraph.types import Floats

N_ALLOCATION_STEPS = 24
"""Number of steps of the Frank-Wolfe method."""


def allocate_time(
    forecasts: Sequence[EvidenceForecast],
    per_second: Sequence[EvidenceQuadratic],
    duration: float,
    allowed: slice,
) -> Floats:
    """Allocate the time of a run (n,) [s] among the `allowed` motions, by the Frank-Wolfe method.

        time <- (1 - size) time + size duration e_best,   size = 2 / (step + 3)

    e_best is the motion with the steepest gain (Frank and Wolfe, Naval Research Logistics Quarterly 3, 1956).
    The logarithm in the objective gives each question a share of the time.

    Parameters
    ----------
    per_second : Evidence of one second of each motion, for each question.
    duration : [s] Of the run.
    """
    out = np.zeros(len(per_second[0].squares))
    time = out[allowed]  # a view
    some = [quadratics[allowed] for quadratics in per_second]
    time[:] = duration / len(time)
    totals = [quadratics.mean() * duration for quadratics in some]
    for step in range(N_ALLOCATION_STEPS):
        slope = np.zeros(len(time))
        for forecast, quadratics, total in zip(forecasts, some, totals, strict=True):
            x = forecast.refitted(total)
            slope += quadratics.at(x) / (1.0 + max(float(total.at(x)), 0.0))
        size = 2.0 / (step + 3.0)
        best = int(slope.argmax())
        time *= 1 - size
        time[best] += size * duration
        totals = [
            total * (1 - size) + quadratics[best] * (size * duration)
            for total, quadratics in zip(totals, some, strict=True)
        ]
    return out
