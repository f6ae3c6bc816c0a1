"""Notice limits that most readings contradict, and ranges in millimetres or centimetres.

The unit itself is not certain, so that no range is converted.
"""

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


MOST_BELOW = 0.5
"""Share of the readings below range_min above which this limit is wrong, as a laser is not always that near to surfaces ..."""
LONGEST_BLIND = 1.0
"""[m] ... unless the limit is shorter, as a sonar may look at its cover; no laser or sonar is blind for longer."""


def lower_limit(parts: Sequence[Floats], range_min: float, range_max: float) -> tuple[float, str]:
    """Return range_min [m] as it is used, and a note; 0 without a limit, or if most readings are below it.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m] of readings
    """
    if not 0 <= range_min < range_max:
        return 0.0, f"range_min {range_min:g} is invalid, 0 was used"
    readings = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in parts])
    below = float((readings < range_min).mean()) if len(readings) else 0.0
    if below > MOST_BELOW and range_min > LONGEST_BLIND:
        return 0.0, f"{100 * below:.0f} % of the readings are below range_min {range_min:g} m: 0 was used"
    return range_min, ""


def median_text(ranges: Floats) -> str:
    """Return what is wrong with the median of ranges (n_scans, n_rays), as a sentence; empty if they may be in metres."""
    finite = ranges[np.isfinite(ranges)]
    median = float(np.median(finite)) if len(finite) else 0.0
    text = unit_text(median)
    return f"the median range is {median:.0f}, which {text}" if text else ""


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
    text = unit_text(float(median)) if low > range_max and low < high else ""
    return f"{BEYOND}{median:.0f} is beyond range_max {range_max:g} m and {text}" if text else ""
