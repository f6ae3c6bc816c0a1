"""Choose a scale for the data: widths that bound every column, and centres for variables far from 0."""

from __future__ import annotations

import numpy as np

from robotmodic_ident.records import LaggedData
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

MAX_POWER_OFFSET = 1e5
"""A variable is centred if its middle is more than MAX_POWER_OFFSET^(1/degree) half-spans from 0.

Farther from 0, its powers are nearly collinear."""
MAX_OUTPUT_OFFSET = 100.0
"""The middle of the output is subtracted if it is more than this number of half-spans from 0.

Otherwise, the offset would dominate the sum of squares."""


def scale_for(terms: Terms, rows: LaggedData) -> Scale:
    """Return the scale that divides every variable by its magnitude, and centres it at a round number if far from 0."""
    names, centres, widths = [], [], []
    for variable in terms.variables:
        signals = {f.signal for term in terms for f in term if f.variable == variable and f.is_scaled}
        if not signals:
            continue
        low = min(float(rows.columns[name].min()) for name in signals)
        high = max(float(rows.columns[name].max()) for name in signals)
        middle, half = (low + high) / 2, (high - low) / 2
        centre = 0.0
        degree = max(sum(f.degree for f in term if f.variable == variable) for term in terms)
        if half > 0 and abs(middle) > MAX_POWER_OFFSET ** (1 / degree) * half:
            centre = _round(middle, half)
        width = max(abs(low - centre), abs(high - centre))
        names.append(variable)
        centres.append(centre)
        widths.append(_rounded_up(width) if width > 0 else 1.0)
    return Scale(tuple(names), tuple(centres), tuple(widths))


def middle_of(targets: Floats) -> float:
    """Return a round number near the middle of the output (n, 1); 0 if the middle is not far from 0."""
    low, high = float(np.nanmin(targets)), float(np.nanmax(targets))
    middle, half = low / 2 + high / 2, high / 2 - low / 2
    return _round(middle, half) if half > 0 and abs(middle) > MAX_OUTPUT_OFFSET * half else 0.0


def _round(middle: float, half: float) -> float:
    """Round the middle to a multiple of a power of ten that is at least the span."""
    unit = 10.0 ** np.ceil(np.log10(2 * half))
    return float(np.round(middle / unit) * unit)


def _rounded_up(width: float) -> float:
    """Round up to three digits, which keeps the domains of splines and wavelets readable."""
    unit = 10.0 ** (np.floor(np.log10(width)) - 2)
    return float(f"{np.ceil(width / unit * (1.0 - 1e-12)) * unit:.3g}")
