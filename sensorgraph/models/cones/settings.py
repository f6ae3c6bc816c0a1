"""Settings of faces that are fitted to cones: every tuned number of `models/cones` with its unit and its meaning.

One frozen dataclass; `CONES` is the instance that the modules use. They were set on rings of 16 sonars in the shipped square
and office, by median error and share of wrong readings as printed by

    sensorgraph evaluate GRAPH RUN
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from logs.run import RangeSensor


@dataclass(frozen=True, kw_only=True)
class ConeSettings:
    """How faces are found in readings of cones, and how cones are predicted."""

    narrow: float = math.radians(5.0)
    """[rad] a cone up to this is a thin ray: met at 45°, its nearest surface is 4 % nearer than the ray's."""
    max_readings: int = 100_000
    """Readings that faces are fitted to; of more, every n-th."""
    first_sigma: float = 0.01
    """[m] range noise to begin with."""
    max_sigma: float = 0.05
    """[m] range noise that is looked for, at most."""
    n_angles: int = 720
    """Normals over the full turn that a reading may vote for."""
    offset_bin: float = 0.02
    """[m] bins of the offset of a line."""
    bin: float = 0.04
    """[m] bins along a line, in which readings that end there and that passed are counted."""
    min_hits: int = 12
    """Readings that make a stretch."""
    max_failures: int = 40
    """Peaks without a new stretch, after which a search ends."""
    max_stretches: int = 600
    """In all."""
    rounds: int = 3
    """Of searching among what no stretch explains, and of refining all."""
    first_band: float = 0.06
    """[m] half width of the band about a peak's line, in which its readings are first looked for."""
    fit_sigmas: float = 4.0
    """Standard deviations within which a reading is explained, and moves a line."""
    pass_margin: float = 0.01
    """[m] besides `fit_sigmas`, by which a reading must be longer to have passed."""
    max_pass_share: float = 0.25
    """Readings that ended in a bin, over those that passed it, below which nothing stands there: 1 in 4."""
    max_gap: float = 0.6
    """[m] along a line, that neither a reading nor a pass tells of, across which a stretch goes on."""
    turn_prior: float = 0.1
    """[rad] standard deviation a priori of a line's turn in one step: keeps short stretches from spinning."""
    shift_prior: float = 0.05
    """[m] of its shift, and of an end's."""
    end_search: float = 0.16
    """[m] about an end, in which it is looked for; halved until `end_step`."""
    end_step: float = 0.004
    """[m]"""
    min_gain: float = 30.0
    """[nats] that a stretch must be worth to stay."""
    end_blur: float = 0.004
    """[m] standard error of an end."""
    edge_blur: float = 0.01
    """[rad] by which the edge of a cone is not sharp."""
    min_cosine: float = 0.05
    """Of the incidence at the edge of a cone, below which a line is out of sight."""
    max_candidates: int = 16
    """Stretches in one cone, of which one may stop it."""


CONES = ConeSettings()
"""The settings of faces that are fitted to cones."""


def measures_cones(sensor: RangeSensor) -> bool:
    """Tell whether a sensor measures the nearest surface in cones too wide to be taken for thin rays."""
    return bool(sensor.cones.max(initial=0.0) > CONES.narrow)
