"""Notice ranges in millimetres or centimetres by their median; the unit itself is not certain, so nothing is converted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.types import Floats

MAX_METRES = 60.0
"""[m] A larger median range is that of another unit: indoors and between houses, most surfaces are nearer."""
MAX_CENTIMETRES = 1000.0
"""A larger median, of 10 m in centimetres, is probably one in millimetres."""
BEYOND = "the median reading "
"""Begin of the note on readings beyond range_max, which `beyond_text` writes."""


def unit_text(median: float) -> str:
    """Return what is wrong with ranges of this median, and what to do; empty if they may be in metres."""
    if not median > MAX_METRES:
        return ""
    is_mm = median > MAX_CENTIMETRES
    unit, factor = ("millimetres", "1000") if is_mm else ("centimetres or millimetres", "100 or 1000")
    return f"looks like {unit}, expected metres (divide the ranges by {factor} where they are logged)"


def beyond_text(parts: Sequence[Floats], range_max: float) -> str:
    """Return a note on readings (n_scans, n_rays) of which most are far above range_max [m]; empty if they are not.

    A single frequent value is a code of missing returns and no unit.
    """
    readings = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in parts])
    low, median, high = np.quantile(readings, [0.25, 0.5, 0.75]) if len(readings) else np.zeros(3)
    text = unit_text(float(median)) if median > range_max and low < high else ""
    return f"{BEYOND}{median:.0f} is beyond range_max {range_max:g} m and {text}" if text else ""
