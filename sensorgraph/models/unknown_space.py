"""What a ray measures in space that no training ray has crossed.

Obstacles stop a ray at a constant rate λ there, so z ~ λ exp(-λ z). The rate is not known: its prior is exponential, with
a mean of 1 / s, which gives

    p(z) = s / (s + z)²,        P(z > R) = s / (s + R).

s is the median of this distribution. It is taken from the space that is known: the median of what the graph predicts at
poses all over it. A share p0 of the rays returns nothing at all, as it does there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.run import RangeSensor
from sensorgraph.models.likelihood import MIN_DENSITY
from sensorgraph.types import Floats

N_POSES, N_RAYS = 200, 16
"""Numbers of poses in known space, and of rays at each, whose predictions are taken."""


@dataclass(frozen=True, kw_only=True)
class UnknownSpace:
    """Distribution of readings where nothing is known."""

    median: float
    """[m] Median range s of the rays that return."""
    p_no_return: float
    """Share p0 of the rays that return nothing, however near the next surface is."""

    @classmethod
    def of(cls, ranges: Floats, p_no_return: Floats, sensor: RangeSensor) -> UnknownSpace:
        """Take median and share from ranges [m] and chances of no return that are predicted in known space."""
        known = np.isfinite(ranges)
        if not known.any():
            return cls(median=sensor.range_max, p_no_return=0.0)
        return cls(
            median=float(np.median(ranges[known])),
            p_no_return=float(np.mean(p_no_return[np.isfinite(p_no_return)])),
        )

    def log_likelihood(self, ranges: Floats, sensor: RangeSensor) -> Floats:
        """Return the log-likelihood of readings [m]: a density [1/m], or the probability of no return or of too close."""
        s, returns = self.median, 1.0 - self.p_no_return
        with np.errstate(invalid="ignore"):
            density = np.where(np.isfinite(ranges), returns * s / (s + np.abs(ranges)) ** 2, 0.0)
        none = self.p_no_return + returns * s / (s + sensor.range_max)
        too_close = returns * sensor.range_min / (s + sensor.range_min)
        found = np.where(np.isposinf(ranges), none, np.where(np.isneginf(ranges), too_close, density))
        return np.asarray(np.log(np.maximum(found, MIN_DENSITY)))
