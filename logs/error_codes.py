"""Recognise the error codes that drivers write into ranges; they are invalid readings, not surfaces.

* Hokuyo (SCIP 2.0): values of 1 to 19 mm state why there is no range, for example strong light or a weak echo.
* SICK LMS 2xx (8189 to 8191, in mm or cm): overflow, dazzling, invalid. The codes 8183 and 8187 (no echo in reach)
  are missing returns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.no_return import CODE_SEARCH
from logs.types import ROUNDING, Floats

SHORTEST_RANGE = 0.02
"""[m] SCIP 2.0: smaller values are error codes, in whole millimetres. No laser scanner measures so close."""
LARGE_CODES = (8.189, 8.190, 8.191, 81.89, 81.90, 81.91)
"""[m] error codes of SICK LMS 2xx, with ranges in mm and in cm."""


def blank_error_codes(parts: Sequence[Floats], range_min: float, range_max: float) -> list[str]:
    """Replace the error codes in readings of a laser by nan, in place; return notes with the counts.

    Small codes are below `range_min` if that is stated. Large codes are above `range_max`; a frequent one is how the
    driver writes a missing return, and is left for `no_return`.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m]
    range_min, range_max : limits [m] as stated by the driver; 0 and inf if unknown
    """
    limit = min(SHORTEST_RANGE, range_min) if range_min > 0 else SHORTEST_RANGE
    total = sum(part.size for part in parts)
    counts: dict[float, int] = {}
    for part in parts:
        step = np.rint(part * 1000) / 1000
        small = (part > 0) & (part < limit) & (np.abs(part - step) < ROUNDING)
        _count(counts, step[small])
        part[small] = np.nan
    small_codes = sorted(counts)
    large = [code for code in LARGE_CODES if range_max < code - CODE_SEARCH.known_tolerance]
    found = {code: [np.abs(part - code) < CODE_SEARCH.known_tolerance for part in parts] for code in large}
    for code, masks in found.items():
        n = sum(int(mask.sum()) for mask in masks)
        if 0 < n <= max(CODE_SEARCH.frequent * total, CODE_SEARCH.min_count):
            counts[code] = n
            for part, mask in zip(parts, masks, strict=True):
                part[mask] = np.nan
    notes = []
    if small_codes:
        low, high = 1000 * small_codes[0], 1000 * small_codes[-1]
        span = f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
        n = sum(counts[code] for code in small_codes)
        notes.append(f"{n} ranges of {span} are error codes of the laser, invalid readings: nan")
    rare = [code for code in large if code in counts]
    if rare:
        shown = ", ".join(f"{code:g}" for code in rare)
        n = sum(counts[code] for code in rare)
        notes.append(f"{n} ranges of {shown} m are error codes of the laser, invalid readings: nan")
    return notes


def _count(counts: dict[float, int], values: Floats) -> None:
    for value, n in zip(*np.unique(values, return_counts=True), strict=True):
        counts[float(value)] = counts.get(float(value), 0) + int(n)
