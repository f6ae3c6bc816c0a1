"""Standard deviations from medians, which outliers hardly change."""

from __future__ import annotations

import numpy as np

from sensorgraph.types import Floats

SIGMA_OF_MAD = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation, 1 / Φ⁻¹(3/4)."""


def robust_sigma(residuals: Floats) -> float:
    """Return the standard deviation of residuals (n,) around 0, from their median absolute value; n > 0."""
    return SIGMA_OF_MAD * float(np.median(np.abs(residuals)))
