"""Settings of the model `faces`: every tuned number of `models/faces` with unit, meaning and source.

`FacesSettings` has one group per step of the fit, and the modules use its instance `FACES`. Some settings are
constants of compiled code: `planners.kernel` recompiles after a change of their values.

Unless a group states otherwise, the values were set on random offices. The criteria are median error, share of wrong
rays, time and file size, as printed by

    python -m benchmarks.office_graph

Widths and distances suit a laser with a noise of about 1 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class FaceReductionSettings:
    """Data that one pass over a log keeps (`reduction`, `hit_moments`, `sufficient_statistics`).

    The values were set by time and memory: `python -m benchmarks.build_speed`.
    """

    scans_per_block: int = 8192
    """Number of scans in a block."""
    max_collected_rays: int = 3_000_000
    """Expected number of rays collected from a whole log."""
    max_sampled_rays: int = 1_500_000
    """Number of collected rays that are sampled, spread evenly over places and directions."""
    hit_cell: float = 0.02
    """[m] Side of the cells in which hits are pooled."""
    kept_crossings: int = 12
    """Number of crossings kept on each side of an edge."""
    representatives: int = 16
    """Number of crossings that represent all others of a stretch."""


@dataclass(frozen=True, kw_only=True)
class LineLimits:
    """Requirements of a line."""

    min_hits: float
    """Minimum number of hits."""
    gap: float
    """[m] Length without hits that ends a line."""
    min_length: float
    """[m] Minimum length."""


@dataclass(frozen=True, kw_only=True)
class LineSelectionSettings:
    """Forward selection of lines on pooled hits (`forward_selection`)."""

    first_lines: LineLimits = LineLimits(min_hits=12.0, gap=0.10, min_length=0.03)
    """Limits of lines among all hits."""
    later_lines: LineLimits = LineLimits(min_hits=4.0, gap=0.05, min_length=0.02)
    """Limits of lines among unexplained hits; the leg of a chair has few hits."""
    n_angles: int = 240
    """Number of normal angles over the full circle, since faces are one-sided."""
    vote_spread: int = 3
    """Number of neighbouring angle bins on each side that a cell also votes for."""
    offset_bin: float = 0.02
    """[m] Bin size of the offset."""
    first_band_bins: float = 1.5
    """Half width of the initial band of a line, in offset bins."""
    band_sigmas: float = 3.0
    """Half width of the band of a line, in standard deviations of hits across it."""
    min_band_cells: float = 0.6
    """Minimum half width of the band, in cells of pooled hits."""
    neighbourhoods: tuple[int, int] = (2, 4)
    """Cells to each side whose hits determine the normal of a cell; the second is used if the first is unclear."""
    min_neighbourhood_hits: int = 3
    """Minimum number of hits that determine a normal."""
    min_elongation: float = 3.0
    """Minimum ratio of the variances of hits along and across for a clear normal."""
    min_facing: float = 0.02
    """Minimum cosine between a line's normal and the direction to the laser for a cell of the line."""
    max_normal_turn: float = math.radians(40.0)
    """[rad] Maximum angle between the normals of a line and of a cell on it."""
    min_agreement: float = 0.7
    """Minimum cosine between a line's normal and that of its hits for the line to adopt the latter."""
    min_votes_share: float = 0.5
    """Share of `min_hits` that the best bin must hold for the search to continue."""
    refits: int = 4
    """Number of alternating fits of a line and its cells."""
    max_lines: int = 4096
    """Maximum number of lines in one call."""
    max_failures: int = 4000
    """Number of bins without a line after which the search ends."""


@dataclass(frozen=True, kw_only=True)
class FaceMarchSettings:
    """March of a ray through faces in a bucket grid (`ray_march`)."""

    bucket_size: float = 0.8
    """[m] Side of a bucket; 0.3 to 1.2 m perform alike."""
    max_buckets: int = 1 << 24
    """Maximum number of buckets of 8 bytes each: 11 km²."""
    end_margin: float = 0.02
    """[m] Margin beyond its ends within which a face is still listed, so that a blurred end is visible."""
    min_visibility: float = 0.003
    """Visibility below which a stretch is ignored."""
    max_candidates: int = 96
    """Maximum number of faces listed for one ray."""
    back_side_margin: float = 0.01
    """[m] Distance from the ends of a face beyond which a ray that meets its back came through solid matter."""
    min_back_visibility: float = 0.5
    """Minimum visibility of such a face."""


@dataclass(frozen=True, kw_only=True)
class FaceExpectationSettings:
    """EM estimate of which face stopped which ray (`visibility`)."""

    first_bin: float = 0.01
    """[m] Bin size along a face for the first estimate of its visibility."""
    first_visibility: float = 0.8
    """Initial visibility within the span of the hits."""
    first_margin_visibility: float = 0.1
    """Initial visibility in the margin around the span."""
    prior_stops: float = 0.02
    """Prior number of stops on a stretch."""
    prior_crossings: float = 0.04
    """Prior number of crossings of a stretch."""
    min_cosine: float = 0.08
    """|n·u| below which a hit does not move its face, since grazing incidence amplifies errors."""
    min_squared_cosine: float = 0.0025
    """Lower limit of (n·u)² in the variance of a return."""
    gate_sigmas: float = 6.0
    """Standard deviations from a face beyond which a return is not from it."""
    fit_sigmas: float = 4.0
    """Standard deviations beyond which a return affects neither line nor noise."""
    min_fit_share: float = 0.01
    """Probability of being from a face below which a return does not move it."""
    reach_margin: float = 0.08
    """[m] Distance behind a return, in addition to `gate_sigmas`, up to which faces may have stopped the ray."""
    first_stray: float = 1e-3
    """[1/m] Initial density of outliers, which no face explains."""
    stray_range: tuple[float, float] = (1e-6, 0.05)
    """[1/m] Limits of the density of outliers."""
    min_hits: float = 2.0
    """Number of hits below which a line is not moved."""
    turn_prior: float = 0.1
    """[rad] Prior standard deviation of a line's turn; it keeps faces with few hits from rotating freely."""
    max_turn: float = 0.2
    """[rad] Maximum turn in one step."""
    min_variance: float = 1e-8
    """[m²] Lower limit of the variance of the range noise: (0.1 mm)²."""
    min_span_visibility: float = 0.05
    """Visibility above which a bin belongs to the span of a line."""


@dataclass(frozen=True, kw_only=True)
class FaceEdgeSettings:
    """Edges of visible stretches, and corners (`change_points`, `corners`)."""

    min_gain: float = 4.0
    """[nats] Complexity penalty of an edge, in addition to half the log of the number of crossings of its face."""
    max_runs: int = 600
    """Maximum number of runs of equal outcome in one stretch."""
    max_stray: float = 0.5
    """Probability of being an outlier above which a return is not used for crossings."""
    level_passes: int = 6
    """EM iterations of the visibility of stretches (`blurred_edges`)."""
    search_rounds: int = 4
    """Number of searches for an edge's position, each on a finer grid."""
    search_half: int = 4
    """Number of positions on each side of the best one in a search."""
    max_step_errors: float = 8.0
    """Maximum width of a stretch that may be the blur of one edge, in standard errors of a crossing."""
    window_errors: float = 4.0
    """Distance from an edge within which a crossing may belong to either side, in standard errors."""
    min_reached: float = 0.2
    """Probability of reaching a crossing below which it is not counted."""
    visibility_factor: float = 5.0
    """Factor on the minimum visibility of the march below which a stretch is set to 0."""
    corner_distance: float = 0.03
    """[m] Distance within which two ends may form a corner."""
    min_length: float = 1e-6
    """[m] Length up to which a stretch between two corners is empty."""
    max_blur: float = 0.03
    """[m] Upper limit of the standard error of an edge's position."""
    max_loss: float = 6.0
    """[nats] Maximum loss of log likelihood for a corner: one or two crossings on the wrong side."""
    outside_visibility: float = 0.1
    """A stretch ends at an edge with less visibility than this on one side, and ..."""
    inside_visibility: float = 0.5
    """... more than this on the other side."""
    min_visibility: float = 0.002
    """Lower limit of probabilities in a log likelihood."""
    min_sine: float = 0.05
    """Minimum sine of the angle between two lines that meet in a corner."""


@dataclass(frozen=True, kw_only=True)
class FaceSplitSettings:
    """Splitting of faces with bent hits (`splits`)."""

    min_gain: float = 9.0
    """[nats] Complexity penalty of a second line, in addition to the log of the number of hits."""
    min_hits: int = 4
    """Minimum number of hits of a line."""
    slope_prior: float = 0.3
    """[m/m] Prior standard deviation of the slope of hits along a face; also of a line's turn in an edge's error."""
    min_length: float = 1e-6
    """[m] Minimum length of a piece."""


@dataclass(frozen=True, kw_only=True)
class FaceFitSettings:
    """Rounds of the fit (`fit`)."""

    draft_rays: int = 300_000
    """Maximum number of rays in the first rounds."""
    stratum_cell: float = 0.5
    """[m] Side of the cells from which samples take up to the same number of rays in each sector."""
    stratum_sector: float = math.radians(15.0)
    """[rad] Width of these sectors of direction."""
    final_rays: int = 1_500_000
    """Maximum number of rays in the final fit of edges and visibility."""
    rounds: int = 3
    """Rounds of splitting and of selecting among unexplained hits."""
    first_passes: int = 3
    """EM iterations after the first selection."""
    round_passes: int = 4
    """EM iterations in each round."""
    first_sigma: float = 0.01
    """[m] Initial range noise."""
    wide_ratio: float = 1.5
    """Ratio of the observed to the assumed spread across faces above which the first selection is repeated."""
    max_selections: int = 3
    """Maximum number of first selections."""
    min_face_gain: float = 8.0
    """[nats] Minimum gain in log likelihood of a face."""
    redundancy_passes: int = 2
    """EM iterations of the visibility of faces without redundant ones."""


@dataclass(frozen=True, kw_only=True)
class FacePredictionSettings:
    """Answers of a prediction (`prediction`, `observed_space`, `model`)."""

    observed_cell: float = 0.10
    """[m] Side of the cells of observed space."""
    max_observed_cells: int = 1 << 26
    """Maximum number of cells; a larger grid is coarsened."""
    support_margin: float = 0.10
    """[m] Distance before the predicted range from which a ray needs no support, since the surface was observed."""
    max_p_off: float = 0.05
    """Maximum probability of being off for a ray to be answered."""
    max_stray: float = 2e-3
    """[1/m] Density of outliers above which cells predict: 1e-4 in rooms without clutter, 7e-3 on logs of real floors.

    The value lies between the two: `python -m benchmarks.office_graph` and `python -m benchmarks.real_logs LOG`.
    """
    min_survival: float = 0.001
    """Survival probability below which a ray is not followed further."""
    min_share: float = 1e-4
    """Probability of a stop below which a face is not a candidate."""
    edge_sigmas: float = 4.0
    """Distance from an edge within which it is blurred, in standard errors."""
    shown_poses: int = 4096
    """Number of poses for the shares of poses in printed equations; each is known to 0.5 % or better."""
    shown_share: float = 0.01
    """Share of poses below which a face or a stretch of it is printed only on request."""
    min_edge_variance: float = 1e-8
    """[m²] Lower limit of the variance of an edge's position."""


@dataclass(frozen=True, kw_only=True)
class FaceUpdateSettings:
    """Update of a graph with further runs (`update`)."""

    explained_within: float = 0.03
    """[m] Distance to a visible stretch below which a stored hit is explained."""
    em_passes: int = 3
    """EM iterations on the new rays."""
    pass_distance: float = 0.1
    """[m] Distance on both sides of a new face at which old rays must have crossed to count as passes."""


@dataclass(frozen=True, kw_only=True)
class FacesSettings:
    """All tuned numbers of the model `faces`."""

    reduction: FaceReductionSettings = field(default_factory=FaceReductionSettings)
    selection: LineSelectionSettings = field(default_factory=LineSelectionSettings)
    march: FaceMarchSettings = field(default_factory=FaceMarchSettings)
    expectation: FaceExpectationSettings = field(default_factory=FaceExpectationSettings)
    edges: FaceEdgeSettings = field(default_factory=FaceEdgeSettings)
    splits: FaceSplitSettings = field(default_factory=FaceSplitSettings)
    fit: FaceFitSettings = field(default_factory=FaceFitSettings)
    prediction: FacePredictionSettings = field(default_factory=FacePredictionSettings)
    update: FaceUpdateSettings = field(default_factory=FaceUpdateSettings)


FACES = FacesSettings()
"""The settings that the modules use."""
