"""The times of the messages of one signal, and two faults that all its stamps share.

A stamp is a number of seconds and one of nanoseconds. Drivers that write microseconds or milliseconds into the second number
compress each second into its first part, so that the stamps jump at the end of every second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.sensor import usual_step
from logs.transforms import Stamps
from logs.types import Floats

SECOND = 1_000_000_000
"""[ns]"""
PARTS = ((1_000_000, "milliseconds"), (1_000, "microseconds"))
"""Units of the part of a stamp below a second [ns], and their names."""
MIN_MESSAGES = 10
"""Number of messages below which their stamps are no evidence of a unit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """The times of the messages of one signal, in the order of the log."""

    name: str
    stamps: Stamps
    """(n,) [ns] header stamps; 0: absent."""
    logged: Stamps
    """(n,) [ns] log times."""
    has_header: bool = True
    is_correction: bool = False
    """Whether it is the transform between map and odometry, which localizers post-date."""


def in_nanoseconds(signals: Sequence[Signal]) -> tuple[list[Signal], list[str]]:
    """Return the signals with stamps in nanoseconds, and notes; the log times tell whether another unit is right.

    Parts of seconds that are all below a millisecond are microseconds if this brings the stamps closer to the log times. They
    are nanoseconds where messages come at each full second.
    """
    out, notes = [], []
    for signal in signals:
        there = signal.stamps != 0
        whole, parts = np.divmod(signal.stamps, SECOND)
        usable = signal.has_header and there.sum() >= MIN_MESSAGES and np.ptp(parts[there]) > 0
        for unit, name in PARTS if usable else ():
            if parts[there].max() * unit >= SECOND:
                continue
            stamps = np.where(there, whole * SECOND + parts * unit, 0)
            offsets = ((signal.logged - at)[there] for at in (signal.stamps, stamps))
            before, after = (half_range(one - one[0]) for one in offsets)  # differences fit into floats
            if after < before / 2:
                signal = replace(signal, stamps=stamps)
                notes.append(
                    f"{signal.name}: the stamps have {name} in place of nanoseconds, by the log times: converted"
                )
            break
        out.append(signal)
    return out, notes


def half_range(values: Floats | Stamps) -> float:
    """Return half the range of the central 90 % of values (n,), as a scatter that outliers hardly change."""
    return float(np.ptp(np.quantile(values, [0.05, 0.95]))) / 2


def forward(signals: Sequence[Signal], least: float) -> tuple[list[Signal], list[str]]:
    """Return the signals with log times and stamps that do not restart, if the clock of the whole log was set back.

    The parts are joined without a gap. The fastest signal determines the step, so that all signals keep their order.

    Parameters
    ----------
    least : [s] Shortest step back that is a clock that was set back.
    """
    fastest = max((s for s in signals if len(s.logged) > 1), key=lambda s: len(s.logged), default=None)
    if fastest is None:
        return list(signals), []
    steps = np.diff(fastest.logged)
    back = np.flatnonzero(steps < -least * 1e9)
    if len(back) == 0:
        return list(signals), []
    period = int(usual_step(fastest.logged))
    jumps = period - steps[back]  # (n_back,) [ns]
    out = []
    for signal in signals:
        own = np.flatnonzero(np.diff(signal.logged) < -least * 1e9)[: len(jumps)]
        added = np.zeros(len(signal.logged), dtype=np.int64)
        for at, jump in zip(own, jumps, strict=False):
            added[at + 1 :] += jump
        has_stepped = np.diff(signal.stamps, prepend=signal.stamps[:1])[own + 1] < 0
        moved = signal.stamps + (added if has_stepped.all() else 0)
        out.append(
            replace(signal, logged=signal.logged + added, stamps=np.where(signal.stamps == 0, 0, moved))
        )
    times = "once" if len(back) == 1 else f"{len(back)} times"
    return out, [
        f"the log times go back {times}, by {-steps[back].min() / 1e9:,.1f} s: the clock was set back, or the file holds "
        "several recordings: the parts were joined in the order of the file"
    ]
