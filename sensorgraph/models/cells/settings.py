"""Settings of the model `cells`: every tuned number of `models/cells` with its unit, its meaning and what set it.

One frozen dataclass, `CellModelSettings`, with one group per step; `CELLS` is the instance that the modules use. Some are
constants of compiled code: `planners.kernel` compiles anew after a change of any file that names it, as this one.

Unless a group says otherwise, its numbers were set on public logs of real floors, by the error on stretches held out as
printed by

    python -m benchmarks.real_logs LOG [LOG ...] --others

The shipped coefficients of visibility were learned with these numbers, and must be learned again (`--learn`) when
`VisibilityFeatureSettings` or `CellEvidenceSettings` change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class CellEvidenceSettings:
    """Hits and passes of a log in cells (`evidence`, `model.is_key_frame`)."""

    cell_size: float = 0.05
    """[m] side of a cell; 3.5 to 7 cm do nearly as well."""
    max_reach: float = 10.0
    """[m] a longer range counts as nothing seen within reach."""
    min_range: float = 0.1
    """[m] a shorter range is not used."""
    max_ray_spacing: float = math.radians(0.34)
    """[rad] wider gaps between neighbouring rays are filled by virtual ones."""
    surface_step: float = 0.10
    """[m] between the ends of neighbouring rays, within which they met one surface however near it is."""
    surface_slope: float = 4.0
    """The same in widths of the gap between the rays, of surfaces seen at a flat angle."""
    max_surface_step: float = 0.6
    """[m] at most."""
    free_margin: float = 0.15
    """[m] before the nearer of two rays that met different surfaces, up to which the gap between them is free."""
    surface_margin_cells: float = 1.5
    """The same before one surface, in cells."""
    key_frame_distance: float = 0.4
    """[m] a scan counts where the robot has moved so far since the last one: counts are independent looks."""
    key_frame_turn: float = math.radians(20.0)
    """[rad] or has turned so far."""


@dataclass(frozen=True, kw_only=True)
class LocalLineSettings:
    """The line through the hits around a cell (`local_lines`)."""

    radius: int = 2
    """Cells around one whose hits make its line."""
    fallback_radius: int = 1
    """Cells whose hits tell the distance where there is no line."""
    similar_sectors: int = 3
    """Sectors to each side whose hits count as seen from the same side."""
    min_hits: float = 2.5
    """Hits of a line."""
    min_elongation: float = 4.0
    """Variance of hits along a line over that across it."""
    min_length_cells: float = 0.6
    """Standard deviation of hits along a line, in cells."""
    max_offset_cells: float = 1.5
    """Distance of a face without a line from the middle of its cell, in cells."""
    offset_step: float = 0.001
    """[m] in which a line's distance from the middle of its cell is kept, in one byte."""


@dataclass(frozen=True, kw_only=True)
class VisibilityFeatureSettings:
    """How evidence becomes the features of the polynomial of visibility (`visibility`)."""

    neighbour_step: float = 1.2
    """Cells between neighbours along and across a ray: more than 1, so that diagonal ones differ."""
    count_scale: float = 3.0
    """Counts n enter as log(1 + scale n)."""
    box_scale: float = 5.0
    """The same of hits within 5 x 5 cells."""
    interpolated_weight: float = 0.5
    """A hit between two rays counts so much of a hit."""
    other_weight: float = 0.3
    """A hit or pass of another direction counts so much of one of a similar direction."""
    prior_hits: float = 0.05
    """In the log ratio of hits to passes."""
    prior_passes: float = 0.25


@dataclass(frozen=True, kw_only=True)
class VisibilityLearningSettings:
    """Learning the coefficients of visibility (`learning`, `model.learn_visibility`)."""

    min_scans: int = 50
    """Key frames, below which the shipped polynomial is used as it is."""
    n_stretches: int = 50
    """Stretches of a log."""
    folds: int = 5
    """Every so many stretches one is set aside."""
    range_spread: float = 0.03
    """[m] standard deviation of a range about the face that stops it, with the noise of poses."""
    candidate_distance: float = 0.15
    """[m] from the measured range, within which a cell may be the one that stopped the ray."""
    min_at_risk: float = 0.01
    """Chance that a ray came so far, below which a cell is no sample."""
    ridge: float = 2.0
    """Precision with which coefficients are held near the shipped ones."""
    intercept_ridge: float = 1e-6
    """The same of the constant term."""
    newton_steps: int = 4
    """Newton steps; the shipped polynomial is a good start."""
    max_passed_samples: int = 60_000
    """Samples of cells that were passed; the others stand for those left out."""
    min_label: float = 0.01
    """Chance to have stopped a ray, above which a cell is not one that was passed."""
    samples_per_ray: int = 150
    """Room for the cells that one ray is at risk in."""


@dataclass(frozen=True, kw_only=True)
class CellMarchSettings:
    """The march of a ray through cells (`ray_march`)."""

    min_sine: float = 0.17
    """A line seen at a flatter angle than this sine says nothing of the range."""
    min_survival: float = 1e-4
    """A ray with a smaller chance to be still under way is not followed."""
    min_stop: float = 1e-6
    """A smaller chance to stop is no candidate."""
    plain_chance: float = 0.2
    """Chance to stop within a cell, where there is no polynomial of visibility."""
    rates: tuple[float, float] = (2e-3, 200.0)
    """[1/m] least and largest rate of stops: one in 500 m, and one in 5 mm."""
    n_rates: int = 127
    """Codes between them, in steps of 10 %."""


@dataclass(frozen=True, kw_only=True)
class CellAnswerSettings:
    """The spread about a face, the chance of being off, and which rays are answered (`probability_calibration`, `model`)."""

    first_sigma: float = 0.027
    """[m] spread about a face before it is known."""
    tried_sigmas: tuple[float, float] = (0.005, 0.08)
    """[m] least and largest spread tried."""
    n_tried: int = 17
    """Spreads tried."""
    stray_density: float = 1e-3
    """[1/m] density of a return that nothing explains."""
    knots: tuple[float, ...] = (0.0, 0.03, 0.07, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95, 1.0)
    """Said chances of being off between which the correction is a straight line."""
    knot_weight: float = 20.0
    """Returns that each knot's own claim is worth."""
    min_near_chance: float = 0.5
    """Least chance that a return lies within 10 cm of the median, for a ray to be answered."""
    max_unseen_way: float = 0.10
    """[m] of way through cells that no training ray has met, above which a ray is not answered."""


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
"""The settings of the model `cells`."""
