"""Sizes of residuals: standard deviations from medians, which outliers hardly change, and root mean squares; the half."""

from __future__ import annotations

import numpy as np

from sensorgraph.types import Floats

MAJORITY = 0.5
"""Above it, a share is most of the whole, and a probability exceeds that of the opposite."""
SIGMA_OF_MAD = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation, 1 / Φ⁻¹(3/4)."""


def robust_sigma(residuals: Floats) -> float:
    """Return the standard deviation of residuals (n,) around 0, from their median absolute value; n > 0."""
    return SIGMA_OF_MAD * float(np.median(np.abs(residuals)))


def rms(values: Floats) -> float:
    """Return the root mean square of values (n,); 0 if there are none."""
    return float(np.sqrt(np.square(values).mean())) if values.size else 0.0
