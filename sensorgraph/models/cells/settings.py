"""Settings of the model `cells`: every tuned number of `models/cells` with unit, meaning and source.

`CellModelSettings` has one group per step, and the modules use its instance `CELLS`. Some settings are constants of
compiled code: `planners.kernel` recompiles after a change of their values.

Unless a group states otherwise, the values were set on public logs of real floors. The criterion is the error on
held-out stretches, as printed by

    python -m benchmarks.real_logs LOG [LOG ...] --others

The shipped coefficients of visibility were learned with these values. They must be learned again (`--learn`) after a
change of `VisibilityFeatureSettings` or `CellEvidenceSettings`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class CellEvidenceSettings:
    """Hits and passes of a log in cells (`evidence`, `model.is_key_frame`)."""

    cell_size: float = 0.05
    """[m] Side of a cell; 3.5 to 7 cm give similar errors."""
    max_reach: float = 10.0
    """[m] Longer ranges count as no return within reach."""
    min_range: float = 0.1
    """[m] Shorter ranges are not used."""
    max_ray_spacing: float = math.radians(0.34)
    """[rad] Gaps between neighbouring rays that are wider are filled with virtual rays."""
    surface_step: float = 0.10
    """[m] Distance between end points of neighbouring rays below which they met one surface, at any range."""
    surface_slope: float = 4.0
    """The same limit in widths of the gap between the rays, for surfaces at grazing incidence."""
    max_surface_step: float = 0.6
    """[m] Upper bound of both limits."""
    free_margin: float = 0.15
    """[m] The gap between rays that met different surfaces is free up to this distance before the shorter ray's end."""
    surface_margin_cells: float = 1.5
    """The gap between rays that met one surface is free up to this distance before the surface, in cells."""
    key_frame_distance: float = 0.4
    """[m] Minimum motion between key frames; only key frames are counted, so that counts are independent."""
    key_frame_turn: float = math.radians(20.0)
    """[rad] Minimum turn between key frames; one of both limits suffices."""


@dataclass(frozen=True, kw_only=True)
class LocalLineSettings:
    """The line through the hits around a cell (`local_lines`)."""

    radius: int = 2
    """Neighbourhood whose hits determine the line of a cell, in cells."""
    fallback_radius: int = 1
    """Neighbourhood whose hits determine the distance where there is no line, in cells."""
    similar_sectors: int = 3
    """Number of sectors to each side whose hits are from the same side of a surface."""
    min_hits: float = 2.5
    """Minimum number of hits of a line."""
    min_elongation: float = 4.0
    """Minimum ratio of the variances of hits along and across a line."""
    min_length_cells: float = 0.6
    """Minimum standard deviation of hits along a line, in cells."""
    max_offset_cells: float = 1.5
    """Maximum distance of a face without a line from the centre of its cell, in cells."""
    offset_step: float = 0.001
    """[m] Resolution of the stored distance of a line from the centre of its cell (one byte)."""


@dataclass(frozen=True, kw_only=True)
class VisibilityFeatureSettings:
    """Features of the visibility polynomial (`visibility`)."""

    neighbour_step: float = 1.2
    """Distance between neighbours along and across a ray, in cells; above 1 so that diagonal neighbours differ."""
    count_scale: float = 3.0
    """Scale of counts n in log(1 + scale n)."""
    box_scale: float = 5.0
    """The same scale for hits within 5 x 5 cells."""
    interpolated_weight: float = 0.5
    """Weight of an interpolated hit relative to a hit."""
    other_weight: float = 0.3
    """Weight of a hit or pass in another direction relative to one in a similar direction."""
    prior_hits: float = 0.05
    """Prior numbers of hits and passes in the log ratio of both."""
    prior_passes: float = 0.25


@dataclass(frozen=True, kw_only=True)
class VisibilityLearningSettings:
    """Learning of the visibility coefficients (`learning`, `set_aside.learn_visibility`)."""

    min_set_aside: int = 50
    """Number of key frames to set aside; a short log sets aside several folds in turn to reach it."""
    n_stretches: int = 50
    """Number of stretches that a log is divided into; a stretch has one key frame or more."""
    folds: int = 5
    """One stretch of this number is set aside."""
    range_spread: float = 0.03
    """[m] Standard deviation of a range about the face that stops the ray, including the noise of poses."""
    candidate_distance: float = 0.15
    """[m] Distance from the measured range within which a cell may have stopped the ray."""
    min_at_risk: float = 0.01
    """Probability of reaching a cell below which the cell is not a sample."""
    ridge: float = 2.0
    """Precision of the prior around the shipped coefficients."""
    intercept_ridge: float = 1e-6
    """Precision of the prior of the constant term."""
    newton_steps: int = 4
    """Number of Newton steps, starting from the shipped polynomial."""
    max_passed_samples: int = 60_000
    """Maximum number of samples of passed cells, of all folds; they are weighted to represent all of them."""
    min_label: float = 0.01
    """Probability of a stop above which a cell does not count as passed."""
    samples_per_ray: int = 150
    """Capacity of the sample arrays, in cells per ray."""


@dataclass(frozen=True, kw_only=True)
class CellMarchSettings:
    """March of a ray through cells (`ray_march`)."""

    min_sine: float = 0.17
    """Sine of the angle between ray and line below which the line does not determine the range."""
    min_survival: float = 1e-4
    """Survival probability below which a ray is not followed further."""
    max_merged: float = 1e-3
    """Probability of a stop below which neighbouring cells are one candidate; in free space, some 0.5 m."""
    default_probability: float = 0.2
    """Probability of a stop within a cell if there is no visibility polynomial."""
    rates: tuple[float, float] = (2e-3, 200.0)
    """[1/m] Smallest and largest rate of stops: one in 500 m, and one in 5 mm."""
    n_rates: int = 127
    """Number of codes of the rate, in steps of 10 %."""


@dataclass(frozen=True, kw_only=True)
class CellAnswerSettings:
    """Spread about a face, probability of being off, and answered rays (`probability_calibration`, `model`)."""

    first_sigma: float = 0.027
    """[m] Initial spread about a face."""
    min_spread: float = 0.005
    """[m] Smallest spread about a face, and of the place of a line."""
    em_steps: int = 6
    """Number of EM steps of the spread; later ones change it by less than 2 %."""
    n_incidences: int = 8
    """Number of classes of the angle of incidence."""
    first_tails: tuple[float, float, float] = (0.2, 0.7, 1.7)
    """Initial share of wide errors, and factors of the standard deviation of narrow and wide ones."""
    tail_steps: int = 12
    """Number of EM steps of the tails."""
    outlier_density: float = 1e-3
    """[1/m] Density of outliers: returns that no face explains."""
    knots: tuple[float, ...] = (0.0, 0.03, 0.07, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95, 1.0)
    """Predicted probabilities of being off between which the correction is linear."""
    knot_weight: float = 20.0
    """Weight of the prediction at each knot, in returns."""
    min_near_probability: float = 0.5
    """Minimum probability of a return within 10 cm of the median for a ray to be answered."""
    max_unseen_length: float = 0.10
    """[m] Maximum length in cells that no training ray crossed for a ray to be answered."""


@dataclass(frozen=True, kw_only=True)
class CellModelSettings:
    """All tuned numbers of the model `cells`."""

    evidence: CellEvidenceSettings = field(default_factory=CellEvidenceSettings)
    lines: LocalLineSettings = field(default_factory=LocalLineSettings)
    features: VisibilityFeatureSettings = field(default_factory=VisibilityFeatureSettings)
    learning: VisibilityLearningSettings = field(default_factory=VisibilityLearningSettings)
    march: CellMarchSettings = field(default_factory=CellMarchSettings)
    answers: CellAnswerSettings = field(default_factory=CellAnswerSettings)


CELLS = CellModelSettings()
"""The settings that the modules use."""
