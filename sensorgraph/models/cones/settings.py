"""Settings of faces fitted to cones, with unit and meaning; the modules hold the constants of the algorithms.

The modules use the instance `CONES`. The values were set on rings of 16 sonars in the shipped square and office, by
median error and share of wrong readings as printed by

    sensorgraph evaluate GRAPH RUN
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from logs.run import RangeSensor


@dataclass(frozen=True, kw_only=True)
class ConeSettings:
    """Fit of faces to readings of cones, and prediction of cones."""

    narrow: float = math.radians(5.0)
    """[rad] Opening angle up to which a cone counts as a thin ray: at 45° incidence the range is 4 % shorter."""
    max_sigma: float = 0.05
    """[m] Upper limit of the estimated range noise."""
    min_hits: int = 12
    """Minimum number of readings of a stretch."""
    max_gap: float = 0.6
    """[m] Maximum gap without readings or passes along a line that a stretch bridges."""
    min_gain: float = 30.0
    """[nats] Minimum gain in log likelihood of a stretch."""
    shift_prior: float = 0.05
    """[m] Prior standard deviation of a line's shift and of an end's shift."""
    edge_blur: float = 0.01
    """[rad] Standard error of the edge of a cone."""


CONES = ConeSettings()
"""The settings that the modules use."""


def measures_cones(sensor: RangeSensor) -> bool:
    """Return whether a sensor measures the nearest surface in cones that are too wide for the model of thin rays."""
    return bool(sensor.cones.max(initial=0.0) > CONES.narrow)
