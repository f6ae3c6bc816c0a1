"""Intensities of the returns of a laser: how strongly a surface reflects, in the unit of the driver."""

from __future__ import annotations

import numpy as np

from logs.run import Run
from logs.types import Floats


def is_varied(intensities: Floats) -> bool:
    """Return whether intensities carry information: simulators and some drivers send a constant."""
    finite = intensities[np.isfinite(intensities)]
    return finite.size > 0 and bool(finite.min() < finite.max())


def intensity_line(run: Run) -> str:
    """Return a line with the range of the recorded intensities of the returns."""
    values = run.intensities[np.isfinite(run.ranges) & np.isfinite(run.intensities)]
    if not len(values):
        return "intensities: none of the returns"
    low, middle, high = np.percentile(values, [0, 50, 100])
    share = len(values) / max(int(np.isfinite(run.ranges).sum()), 1)
    part = "" if share == 1 else f" of {100 * share:.1f} % of the returns"
    return f"intensities{part} from {low:g} to {high:g} (median {middle:g}), in the unit of the driver"
