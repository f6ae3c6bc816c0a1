"""Clocks: offsets, other epochs, drift, resets, missing stamps; log times and the order of the messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import EPOCH, Draft, Item
from benchmarks.fuzz.structure.start import Start, named, of

Choice = Callable[[Item], bool]
WHEELS = ("/odom", "/tf")


def _scans(item: Item) -> bool:
    return item.topic == "/scan"


def _wheels(item: Item) -> bool:
    return item.topic in WHEELS


def _stamps(draft: Draft, chosen: Choice, change: Callable[[float], float]) -> None:
    for item in draft.items:
        if chosen(item):
            item.stamp = change(item.stamp)


def offset(start: Start, draft: Draft) -> None:
    """The stamps of one computer are off by more than any latency."""
    by = float(start.rng.choice([-1, 1])) * start.pick((0.3, 2.0, 111.7, 3600.0, 1e7))
    chosen: Choice = start.pick((_scans, _wheels, lambda item: item.topic == "/odom"))
    _stamps(draft, chosen, lambda t: t + by)
    draft.said = "ahead of|behind|clock|stamps"


@of(reference=0.0)
def late_stamps(start: Start, draft: Draft) -> None:
    """The scans carry the time of their arrival."""
    by = float(start.rng.uniform(0.02, 0.12))
    for item in draft.scans:
        item.stamp += by
        item.log = max(item.log, item.stamp + 0.002)


def since_boot(start: Start, draft: Draft) -> None:
    chosen: Choice = start.pick((_scans, _wheels, lambda item: True))
    _stamps(draft, chosen, lambda t: t - EPOCH + 1234.5)


def simulated_time(start: Start, draft: Draft) -> None:
    """Stamps and log times from 0, as with /use_sim_time."""
    logs = start.chance()
    for item in draft.items:
        item.stamp -= EPOCH
        item.log -= EPOCH * logs


def far_future(start: Start, draft: Draft) -> None:
    by = start.pick((4.5e8, -1.69e9, 2.4e9))
    for item in draft.items:
        item.stamp, item.log = item.stamp + by, item.log + by


def drift(start: Start, draft: Draft) -> None:
    rate = 1 + float(start.rng.choice([-1, 1])) * start.pick((2e-4, 2e-3, 2e-2))
    _stamps(draft, start.pick((_scans, _wheels)), lambda t: t * rate)


def another_rate(start: Start, draft: Draft) -> None:
    rate = start.pick((0.5, 2.0, 10.0))
    _stamps(draft, start.pick((_scans, _wheels)), lambda t: t * rate)
    draft.said = "times as fast|rate|rescaled|clock"


def reset(start: Start, draft: Draft) -> None:
    at, by = float(start.rng.uniform(6, 16)), start.pick((-1e9, -50.0, 40.0, 3600.0))
    _stamps(draft, start.pick((_scans, _wheels)), lambda t: t + by * (t > at))
    draft.said = "reset|clock|go back"


def reset_of_all(start: Start, draft: Draft) -> None:
    """The clock of the computer is set while it records: stamps and log times."""
    at, by = float(start.rng.uniform(6, 16)), start.pick((-20.0, -3600.0, 30.0, 7200.0))
    for item in draft.items:
        late = item.log > at
        item.stamp, item.log = item.stamp + by * (item.stamp > at), item.log + by * late
    draft.container = start.pick(("bag", "db3", "mcap"))


def zero_stamps(start: Start, draft: Draft) -> None:
    chosen: Choice = start.pick(
        (_scans, lambda item: item.topic == "/odom", lambda item: item.topic != "/tf_static")
    )
    share = start.pick((1.0, 1.0, 0.1))
    whole = draft.rng.random(len(draft.items)) < share
    for item, zero in zip(draft.items, whole, strict=True):
        if zero and chosen(item):
            item.stamp = -EPOCH
    draft.said = "stamp 0|header stamps"


def one_wrong_stamp(start: Start, draft: Draft) -> None:
    for item in draft.rng.choice(np.array(draft.scans, dtype=object), 3, replace=False):
        item.stamp += start.pick((-100.0, 100.0, -EPOCH))


def log_offset(start: Start, draft: Draft) -> None:
    """Recorded over a network, or played back later: log times are off, stamps are right."""
    by = start.pick((0.5, 30.0, 86400.0, -7200.0, 3e7))
    for item in draft.items:
        item.log += by


def log_rate(start: Start, draft: Draft) -> None:
    """Played back at another speed while it was recorded."""
    rate = start.pick((0.1, 0.5, 3.0))
    for item in draft.items:
        item.log = 100.0 + item.log * rate


def equal_log_times(start: Start, draft: Draft) -> None:
    for item in draft.items:
        item.log = 0.0
    draft.container = start.pick(("bag", "db3", "mcap"))


def log_bursts(start: Start, draft: Draft) -> None:
    period = start.pick((0.5, 2.0))
    for item in draft.items:
        item.log = np.ceil(item.log / period) * period


def log_jitter(start: Start, draft: Draft) -> None:
    for item in draft.items:
        item.log += float(draft.rng.exponential(start.pick((0.02, 0.3))))
        item.arrival = item.log


def out_of_order(start: Start, draft: Draft) -> None:
    """The file is not in the order of the stamps."""
    for item in draft.items:
        if start.chance(0.1):
            item.log = item.arrival = item.log + 0.35


def repeated(start: Start, draft: Draft) -> None:
    chosen: Choice = start.pick((_scans, _wheels, lambda item: True))
    share = start.pick((1.0, 0.2))
    again = [replace(item, log=item.log + start.pick((0.0, 0.003))) for item in draft.items
             if chosen(item) and start.rng.random() < share]  # fmt: skip
    draft.add(*again)
    draft.said = "twice|duplicates|copies"


def repeated_stamps(start: Start, draft: Draft) -> None:
    """Stamps in whole tenths or hundredths of a second."""
    step = start.pick((0.01, 0.1))
    _stamps(draft, start.pick((_scans, _wheels)), lambda t: np.floor(t / step + 1e-6) * step)


def whole_seconds(start: Start, draft: Draft) -> None:
    _stamps(draft, _scans, np.floor)


def jittered_stamps(start: Start, draft: Draft) -> None:
    """The stamps of the scans scatter by some milliseconds."""
    width = start.pick((0.002, 0.01))
    _stamps(draft, _scans, lambda t: t + width * float(draft.rng.normal()))


def only_log_times(start: Start, draft: Draft) -> None:
    """No stamp of the robot is set."""
    for item in draft.items:
        item.stamp = -EPOCH


CLOCKS = named(
    offset, late_stamps, since_boot, simulated_time, far_future, drift, another_rate, reset, reset_of_all,
    zero_stamps, one_wrong_stamp, log_offset, log_rate, equal_log_times, log_bursts, log_jitter,
    out_of_order, repeated, repeated_stamps, whole_seconds, jittered_stamps, only_log_times,
)  # fmt: skip
