"""Means with their intervals, and the time that work takes, as the tables of the benchmarks state them."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from scipy.stats import t as student

from planners.types import Floats


def half_interval(values: Floats) -> Floats:
    """Return half the 95 % interval of the mean over the first axis, by Student's t; nan for fewer than two values."""
    n = len(values)
    if n < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(student.ppf(0.975, n - 1) * values.std(axis=0, ddof=1) / np.sqrt(n))


def processor_time() -> float:
    """Return the processor time [s] of this process and of those that it has ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


@contextmanager
def cpu() -> Iterator[list[float]]:
    """Measure the processor time [s] that a block takes, with that of the processes that it ends."""
    took = [processor_time()]
    yield took
    took[0] = processor_time() - took[0]


def fastest(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.process_time
) -> float:
    """Return the seconds of the fastest of several repeats."""
    times = []
    for _ in range(repeats):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)
