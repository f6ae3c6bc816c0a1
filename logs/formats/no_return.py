"""The code that a laser wrote for "no return", found from the ranges themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.types import Floats

SICK_CODES = (81.83, 81.87, 81.91, 32.767, 8.191, 8.183, 327.67)
"""[m] codes of SICK_CODES scanners (8183 and up in cm or mm) and of a full 15 or 16 bit word; one alone is believed."""


@dataclass(frozen=True, kw_only=True)
class CodeSearch:
    """When a value counts as a code; set on the public CARMEN logs (`pytest tests/test_logs_formats_carmen.py`)."""

    spread: float = 0.101
    """[m] several codes can lie this close together: 51.05 and 51.10, 81.83 to 81.91."""
    empty: float = 1.0
    """[m] below the codes, where real returns are rare."""
    ratio: float = 5.0
    """Codes outnumber the returns in the empty zone by this factor."""
    min_count: int = 5
    """Times that the commonest code is met."""
    min_share: int = 50
    """A value that is this many times as rare as the commonest code is a stray return."""
    known_tolerance: float = 5e-4
    """[m] from a code of `SICK_CODES`."""


CODE_SEARCH = CodeSearch()


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
    near = levels > top - CODE_SEARCH.spread
    below = counts[(levels > top - CODE_SEARCH.spread - CODE_SEARCH.empty) & ~near].sum()
    # a stray return next to the codes is no code: it does not repeat
    codes = levels[near & (counts >= max(2, counts[near].max() // CODE_SEARCH.min_share))]
    known = np.abs(np.array(SICK_CODES) - top).min() < CODE_SEARCH.known_tolerance
    if known and below == 0 and len(levels) > 1:
        return float(codes.min(initial=top))
    if (
        counts[near].max() >= CODE_SEARCH.min_count
        and counts[near].sum() > CODE_SEARCH.ratio * below
        and len(levels) > near.sum()
    ):
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
