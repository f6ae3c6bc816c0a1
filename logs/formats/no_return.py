"""What number a laser wrote when it saw nothing: told from the ranges themselves."""

from __future__ import annotations

import numpy as np

from logs.types import Floats

SICK = (81.83, 81.87, 81.91, 32.767, 8.191, 8.183, 327.67)
"""[m] codes of SICK scanners (8183 and up in cm or mm) and of a full 15 or 16 bit word; one alone is believed."""
SPREAD = 0.101  # [m] several codes can lie this close together: 51.05 and 51.10, 81.83 to 81.91
EMPTY = 1.0  # [m] below the codes in which real returns are rare
RATIO = 5.0  # codes outnumber returns in the zone below by this much
FEW = 5


def find_code(ranges: Floats, range_max: float | None = None) -> float | None:
    """Return the smallest range [m] that means "nothing seen", or None where no number does.

    It is the largest value (or a few next to it), repeated exactly, with hardly anything below.
    """
    values = ranges[np.isfinite(ranges)]
    if range_max is not None and (values >= range_max).any():
        return range_max
    if len(values) == 0:
        return None
    levels, counts = np.unique(values, return_counts=True)
    top = levels[-1]
    near = levels > top - SPREAD
    below = counts[(levels > top - SPREAD - EMPTY) & ~near].sum()
    # a stray return next to the codes is no code: it does not repeat
    codes = levels[near & (counts >= max(2, counts[near].max() // 50))]
    known = np.abs(np.array(SICK) - top).min() < 5e-4
    if known and below == 0 and len(levels) > 1:
        return float(codes.min(initial=top))
    if counts[near].max() >= FEW and counts[near].sum() > RATIO * below and len(levels) > near.sum():
        return float(codes.min(initial=top))
    return None


def mask(ranges: Floats, code: float | None) -> list[str]:
    """Turn codes into +inf and 0 or less into nan, in place; say how many."""
    notes = []
    if code is not None:
        above = np.isfinite(ranges) & (ranges >= code)
        notes.append(f"{code:g} m and above means nothing seen: {int(above.sum())} rays are +inf")
    broken = ranges <= 0
    broken &= np.isfinite(ranges)
    if code is not None:
        ranges[above] = np.inf
    if broken.any():
        ranges[broken] = np.nan
        notes.append(f"{int(broken.sum())} ranges are 0 or less, which tells nothing: nan")
    return notes
