"""Allocate the time of a run among motions, so that together they bring the most evidence.

    maximise  sum over questions of log(half_weight_nats + nats)   subject to   sum of time = duration, time >= 0

The evidence nats of a question is the minimum, over the refitted values, of functions that are linear in time
(`forecast`). It is therefore concave in time, and so is the sum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.next_run.forecast import EvidenceForecast
from sensorgraph.diagnosis.next_run.settings import NEXT_RUN
from sensorgraph.types import Bools, Floats


def allocate_time(forecasts: Sequence[EvidenceForecast], duration: float, allowed: Bools) -> Floats:
    """Allocate the time of a run (n,) [s] among the `allowed` motions (n,), by the Frank-Wolfe method.

        time <- (1 - size) time + size duration e_best,   size = 2 / (step + 3)

    e_best is the motion with the steepest gain (Frank and Wolfe, Naval Research Logistics Quarterly 3, 1956).
    The logarithm in the objective gives each question a share of the time.

    Parameters
    ----------
    forecasts : Expected evidence of all motions, for each question.
    duration : [s] Of the run.
    """
    time: Floats = np.where(allowed, duration / allowed.sum(), 0.0)
    for step in range(NEXT_RUN.forecast.n_allocation_steps):
        slope = np.where(allowed, 0.0, -np.inf)
        for forecast in forecasts:
            total = forecast.per_second.total(time)
            x = forecast.refitted(total)
            nats = max(float(total.at(x)), 0.0)
            slope += forecast.per_second.at(x) / (NEXT_RUN.forecast.half_weight_nats + nats)
        size = 2.0 / (step + 3.0)
        time *= 1 - size
        time[int(slope.argmax())] += size * duration
    return time
