"""Clocks: offsets, other epochs, drift, resets, missing stamps; log times and the order of the messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import EPOCH, Draft
from benchmarks.fuzz.structure.start import (
    ALL,
    ODOM,
    SCANS,
    WHEELS,
    Kind,
    Span,
    Start,
    is_on,
    kind,
    named,
    of,
    stamps,
    times,
)

SIGNS = (-1.0, 1.0)
UNORDERED = ("bag", "db3", "mcap")
"""Containers whose files need no order of the log times."""


@of(reference=0.0)
def late_stamps(start: Start, draft: Draft) -> None:
    """The scans carry the time of their arrival."""
    by = start.between(0.02, 0.12)
    for item in draft.scans:
        item.stamp += by
        item.log = max(item.log, item.stamp + 0.002)


@of(said="stamp 0|header stamps")
def zero_stamps(start: Start, draft: Draft) -> None:
    topics = start.pick((SCANS, ODOM, ("/scan", "/odom", "/tf", "/pose", "/cmd_vel")))
    share = start.pick((1.0, 1.0, 0.1))
    for item, zero in zip(draft.items, draft.rng.random(len(draft.items)) < share, strict=True):
        if zero and item.topic in topics:
            item.stamp = -EPOCH


def one_wrong_stamp(start: Start, draft: Draft) -> None:
    for item in draft.rng.choice(np.array(draft.scans, dtype=object), 3, replace=False):
        item.stamp += start.pick((-100.0, 100.0, -EPOCH))


def log_jitter(start: Start, draft: Draft) -> None:
    for item in draft.items:
        item.log += float(draft.rng.exponential(start.pick((0.02, 0.3))))
        item.arrival = item.log


def out_of_order(start: Start, draft: Draft) -> None:
    """The file is not in the order of the stamps."""
    for item in draft.items:
        if start.chance(0.1):
            item.log = item.arrival = item.log + 0.35


@of(said="twice|duplicates|copies")
def repeated(start: Start, draft: Draft) -> None:
    topics, share = start.pick((SCANS, WHEELS, ALL)), start.pick((1.0, 0.2))
    again = [replace(item, log=item.log + start.pick((0.0, 0.003))) for item in draft.items
             if is_on(topics, item.topic) and start.rng.random() < share]  # fmt: skip
    draft.add(*again)


def jittered_stamps(start: Start, draft: Draft) -> None:
    """The stamps of the scans scatter by some milliseconds."""
    width = start.pick((0.002, 0.01))
    for item in draft.scans:
        item.stamp += width * float(draft.rng.normal())


# fmt: off
CLOCKS: dict[str, Kind] = {
    # the stamps of one computer are off by more than any latency
    "offset": kind(stamps((SCANS, WHEELS, ODOM), lambda t, sign, by: t + sign * by, SIGNS, (0.3, 2.0, 111.7, 3600.0, 1e7)),
                   said="ahead of|behind|clock|stamps"),
    "since_boot": kind(stamps((SCANS, WHEELS, ALL), lambda t: t - EPOCH + 1234.5)),
    # from 0, as with /use_sim_time
    "simulated_time": kind(times(lambda t, log, both: (t - EPOCH, log - EPOCH * both), 0.5)),
    "far_future": kind(times(lambda t, log, by: (t + by, log + by), (4.5e8, -1.69e9, 2.4e9))),
    "drift": kind(stamps((SCANS, WHEELS), lambda t, sign, rate: t * (1 + sign * rate), SIGNS, (2e-4, 2e-3, 2e-2))),
    "another_rate": kind(stamps((SCANS, WHEELS), lambda t, rate: t * rate, (0.5, 2.0, 10.0)),
                         said="times as fast|rate|rescaled|clock"),
    "reset": kind(stamps((SCANS, WHEELS), lambda t, at, by: t + by * (t > at), Span(6, 16), (-1e9, -50.0, 40.0, 3600.0)),
                  said="reset|clock|go back"),
    # the clock of the computer is set while it records
    "reset_of_all": kind(times(lambda t, log, at, by: (t + by * (t > at), log + by * (log > at)),
                               Span(6, 16), (-20.0, -3600.0, 30.0, 7200.0)), containers=UNORDERED),
    # recorded over a network, or played back later, or at another speed
    "log_offset": kind(times(lambda t, log, by: (t, log + by), (0.5, 30.0, 86400.0, -7200.0, 3e7))),
    "log_rate": kind(times(lambda t, log, rate: (t, 100.0 + log * rate), (0.1, 0.5, 3.0))),
    "equal_log_times": kind(times(lambda t, log: (t, 0.0)), containers=UNORDERED),
    "log_bursts": kind(times(lambda t, log, period: (t, np.ceil(log / period) * period), (0.5, 2.0))),
    "repeated_stamps": kind(stamps((SCANS, WHEELS), lambda t, step: np.floor(t / step + 1e-6) * step, (0.01, 0.1))),
    "whole_seconds": kind(stamps((SCANS,), np.floor)),
    "only_log_times": kind(times(lambda t, log: (-EPOCH, log))),
    **named(late_stamps, zero_stamps, one_wrong_stamp, log_jitter, out_of_order, repeated, jittered_stamps),
}
# fmt: on
