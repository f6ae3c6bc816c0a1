"""Settings of faces fitted to cones: every tuned number of `models/cones` with unit and meaning.

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
    max_readings: int = 100_000
    """Maximum number of readings used by the fit; of more readings, every n-th is used."""
    first_sigma: float = 0.01
    """[m] Initial range noise."""
    max_sigma: float = 0.05
    """[m] Upper limit of the estimated range noise."""
    n_angles: int = 720
    """Number of normal angles over the full circle in the Hough transform."""
    offset_bin: float = 0.02
    """[m] Bin size of the offset in the Hough transform."""
    bin: float = 0.04
    """[m] Bin size along a line, for counting readings that end there and that pass."""
    min_hits: int = 12
    """Minimum number of readings of a stretch."""
    max_failures: int = 40
    """Number of successive peaks without a new stretch after which a search ends."""
    max_stretches: int = 600
    """Maximum number of stretches."""
    rounds: int = 3
    """Rounds of searching among unexplained readings and refining all stretches."""
    first_band: float = 0.06
    """[m] Initial half width of the band about a peak's line whose readings are used for the fit."""
    fit_sigmas: float = 4.0
    """Residual in standard deviations up to which a stretch explains a reading."""
    pass_margin: float = 0.01
    """[m] Distance, in addition to `fit_sigmas`, by which a reading must be longer to pass a stretch."""
    min_hit_ratio: float = 0.25
    """Minimum ratio of readings that end in a bin to readings that pass it, for the bin to be occupied."""
    max_gap: float = 0.6
    """[m] Maximum gap without readings or passes along a line that a stretch bridges."""
    turn_prior: float = 0.1
    """[rad] Prior standard deviation of a line's turn in one step; it keeps short stretches from rotating freely."""
    shift_prior: float = 0.05
    """[m] Prior standard deviation of a line's shift and of an end's shift."""
    end_search: float = 0.16
    """[m] Half width of the search for an end, halved until `end_step`."""
    end_step: float = 0.004
    """[m] Final step of the search for an end."""
    min_gain: float = 30.0
    """[nats] Minimum gain in log likelihood of a stretch."""
    end_blur: float = 0.004
    """[m] Standard error of an end."""
    edge_blur: float = 0.01
    """[rad] Standard error of the edge of a cone."""
    min_cosine: float = 0.05
    """Cosine of the incidence at the edge of a cone below which a line is invisible."""
    max_candidates: int = 16
    """Maximum number of stretches considered in one cone."""


CONES = ConeSettings()
"""The settings that the modules use."""


def measures_cones(sensor: RangeSensor) -> bool:
    """Return whether a sensor measures the nearest surface in cones that are too wide for the model of thin rays."""
    return bool(sensor.cones.max(initial=0.0) > CONES.narrow)
