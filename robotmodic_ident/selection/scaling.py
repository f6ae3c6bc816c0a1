"""Which scale suits the data: widths that bound every column, centres where a variable lies far from 0."""

from __future__ import annotations

import numpy as np

from robotmodic_ident.records import LaggedData
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

MAX_POWER_OFFSET = 1e5
"""A variable is centred when its middle lies MAX_POWER_OFFSET^(1/degree) half-spans from 0: beyond, its powers look alike."""
MAX_OUTPUT_OFFSET = 100.0
"""The output is taken from its middle when that lies so many half-spans from 0: squares of it hold nothing else."""


def scale_for(terms: Terms, rows: LaggedData) -> Scale:
    """Divide every variable by its size; centre it, at a round number, where it lies far from 0."""
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
    """Return a round number in the middle of the output (n, 1), 0 where that is not far from 0."""
    low, high = float(np.nanmin(targets)), float(np.nanmax(targets))
    middle, half = low / 2 + high / 2, high / 2 - low / 2
    return _round(middle, half) if half > 0 and abs(middle) > MAX_OUTPUT_OFFSET * half else 0.0


def _round(middle: float, half: float) -> float:
    """Return a round number within the span."""
    unit = 10.0 ** np.ceil(np.log10(2 * half))
    return float(np.round(middle / unit) * unit)


def _rounded_up(width: float) -> float:
    """Round up to three digits: domains of splines and wavelets stay readable."""
    unit = 10.0 ** (np.floor(np.log10(width)) - 2)
    return float(f"{np.ceil(width / unit * (1.0 - 1e-12)) * unit:.3g}")
