"""Settings of the model `faces`: every tuned number of `models/faces` with its unit, its meaning and what set it.

One frozen dataclass, `FacesSettings`, with one group per step of the fit; `FACES` is the instance that the modules use.
Some are constants of compiled code: `planners.kernel` compiles anew after a change of any file that names it, as this one.

Unless a group says otherwise, its numbers were set on random offices, by median error, share of wrong rays, seconds and
bytes as printed by

    python -m benchmarks.office_graph

Widths and distances are those of a laser with a noise of about 1 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class FaceReductionSettings:
    """What one pass over a log keeps (`reduction`, `hit_moments`, `sufficient_statistics`).

    Time and memory decide: `python -m benchmarks.build_speed`.
    """

    scans_per_block: int = 8192
    """Scans of a block."""
    max_collected_rays: int = 3_000_000
    """Rays taken of a whole log, in the mean, ..."""
    max_sampled_rays: int = 1_500_000
    """... of which the sample holds so many, spread evenly over places and directions."""
    hit_cell: float = 0.02
    """[m] side of the cells in which hits are pooled."""
    kept_crossings: int = 12
    """Crossings kept on each side of an edge."""
    stand_ins: int = 16
    """Crossings that stand for all others of a stretch."""


@dataclass(frozen=True, kw_only=True)
class LineLimits:
    """What makes a line of its own."""

    least_hits: float
    gap: float
    """[m] a longer stretch without hits ends a line."""
    min_length: float
    """[m]"""


@dataclass(frozen=True, kw_only=True)
class LineSelectionSettings:
    """Forward selection of lines on pooled hits (`forward_selection`)."""

    first_lines: LineLimits = LineLimits(least_hits=12.0, gap=0.10, min_length=0.03)
    """Of lines among all hits."""
    later_lines: LineLimits = LineLimits(least_hits=4.0, gap=0.05, min_length=0.02)
    """Of lines among hits that no face explains: a chair's leg has few."""
    n_angles: int = 240
    """Normals over the full turn: faces have one side."""
    vote_spread: int = 3
    """Angle bins beside its own that a cell votes for."""
    offset_bin: float = 0.02
    """[m]"""
    first_band_bins: float = 1.5
    """Half width of the band in which a line's cells are first looked for, in offset bins."""
    band_sigmas: float = 3.0
    """Half width of the band of a line, in standard deviations of hits across it."""
    min_band_cells: float = 0.6
    """Least half width of the band, in cells of pooled hits."""
    neighbourhoods: tuple[int, int] = (2, 4)
    """Cells to each side whose hits tell a cell's normal; the second where the first is unclear."""
    min_neighbourhood_hits: int = 3
    """Hits that tell a normal."""
    min_elongation: float = 3.0
    """Variance of hits along over across, from which a normal is clear."""
    min_facing: float = 0.02
    """Cosine between a line's normal and the way back to the laser, below which a cell is not of that line."""
    max_normal_turn: float = math.radians(40.0)
    """[rad] between a line's normal and that of a cell on it."""
    min_agreement: float = 0.7
    """Cosine between a line's normal and that of its own hits, below which the line is not turned to these."""
    min_votes_share: float = 0.5
    """Of `least_hits` that the best bin must hold for the search to go on."""
    refits: int = 4
    """Times that a line and its cells are fitted in turn."""
    max_lines: int = 4096
    """In one call."""
    max_failures: int = 4000
    """Bins without a line, after which the search ends."""


@dataclass(frozen=True, kw_only=True)
class FaceMarchSettings:
    """The march of a ray through faces in a bucket grid (`ray_march`)."""

    bucket_size: float = 0.8
    """[m] uncritical: 0.3 to 1.2 are alike."""
    max_buckets: int = 1 << 24
    """Buckets of the grid, which takes 8 bytes for each: 11 km² of buckets."""
    end_margin: float = 0.02
    """[m] beyond its ends a face is still offered, so that a blurred end can be seen."""
    min_visibility: float = 0.003
    """Visibility below which a stretch is not there."""
    max_candidates: int = 96
    """Faces listed for one ray."""
    back_side_margin: float = 0.01
    """[m] off its ends a ray that meets a face's back has come through what is solid."""
    min_back_visibility: float = 0.5
    """Of such a face."""


@dataclass(frozen=True, kw_only=True)
class FaceExpectationSettings:
    """The EM of which face stopped which ray (`visibility`)."""

    first_bin: float = 0.01
    """[m] bins along a face, in which its visibility is first estimated."""
    first_visibility: float = 0.8
    """Within the span of its hits."""
    first_margin_visibility: float = 0.1
    """On the margin beside it."""
    prior_stops: float = 0.02
    """Stops that a stretch is taken to have had before any ray came."""
    prior_crossings: float = 0.04
    """Crossings, alike."""
    min_cosine: float = 0.08
    """|n·u| below which a hit does not move its face: its range is all leverage."""
    min_squared_cosine: float = 0.0025
    """(n·u)² that a variance is divided by, at least."""
    gate_sigmas: float = 6.0
    """Standard deviations off a face, beyond which a return does not come from it."""
    fit_sigmas: float = 4.0
    """Beyond which it moves neither its line nor the noise."""
    min_fit_share: float = 0.01
    """Chance to come from a face, below which a return does not move it."""
    reach_margin: float = 0.08
    """[m] behind a return, besides `gate_sigmas`, up to which faces may have stopped it."""
    first_stray: float = 1e-3
    """[1/m] density of returns that no face explains, before it is known."""
    stray_range: tuple[float, float] = (1e-6, 0.05)
    """[1/m] least and largest."""
    min_hits: float = 2.0
    """Hits below which a line is not moved."""
    turn_prior: float = 0.1
    """[rad] standard deviation a priori of a line's turn: keeps faces of few hits from spinning."""
    max_turn: float = 0.2
    """[rad] in one step."""
    min_variance: float = 1e-8
    """[m²] of the range noise: a tenth of a millimetre."""
    min_span_visibility: float = 0.05
    """Visibility from which a bin counts to the span of a line."""


@dataclass(frozen=True, kw_only=True)
class FaceEdgeSettings:
    """Edges of visible stretches, and corners (`change_points`, `corners`)."""

    min_gain: float = 4.0
    """[nats] that an edge must be worth, beside half the log of the crossings of its face."""
    max_runs: int = 600
    """Runs of equal outcome that one stretch may hold."""
    max_stray: float = 0.5
    """Chance that a return comes from no face, above which its ray tells of no crossing."""
    level_passes: int = 6
    """Of EM on the visibility of stretches, next to whose edges a crossing may belong to either (`blurred_edges`)."""
    search_rounds: int = 4
    """In which an edge's place is sought, each on a finer grid than the last."""
    search_half: int = 4
    """Places on each side of the best one in a round."""
    max_step_errors: float = 8.0
    """Standard errors of a crossing's place, up to which a stretch may be the blur of one edge."""
    window_errors: float = 4.0
    """Standard errors from an edge, within which crossings may belong to either side."""
    min_reached: float = 0.2
    """Chance that a ray came as far as a crossing, below which that is not counted."""
    visibility_factor: float = 5.0
    """Times the march's least visibility, below which a stretch counts as not there."""
    corner_distance: float = 0.03
    """[m] within which two ends may be one corner."""
    max_blur: float = 0.03
    """[m] standard error of an edge's place, at most."""
    max_loss: float = 6.0
    """[nats] that moving an end to a corner may cost: a crossing or two on the wrong side."""
    outside_visibility: float = 0.1
    """Below it on one side of an edge, and above `inside_visibility` on the other, a stretch ends there."""
    inside_visibility: float = 0.5
    min_visibility: float = 0.002
    """Least chance that a loss is reckoned with, on either side."""
    min_sine: float = 0.05
    """Of the angle between two lines that meet in a corner."""


@dataclass(frozen=True, kw_only=True)
class FaceSplitSettings:
    """Faces whose hits bend become two (`splits`)."""

    min_gain: float = 9.0
    """[nats] that two lines must be worth over one, beside the log of the hits."""
    min_hits: int = 4
    """Hits of a line."""
    slope_prior: float = 0.3
    """[1] standard deviation a priori of the slope of hits along a face; also of a line's turn in an edge's error."""
    min_length: float = 1e-6
    """[m] a shorter piece is dropped."""


@dataclass(frozen=True, kw_only=True)
class FaceFitSettings:
    """The rounds of `fit`."""

    draft_rays: int = 300_000
    """Rays that lines and bins are fitted to in the first rounds."""
    stratum_cell: float = 0.5
    """[m] side of the cells from which samples and drafts take as many rays each, as far as there are any, ..."""
    stratum_sector: float = math.radians(15.0)
    """[rad] ... in each direction."""
    final_rays: int = 1_500_000
    """Rays that edges and visibility are taken from in the end."""
    rounds: int = 3
    """Of splitting and of selecting among what no face explains."""
    first_passes: int = 3
    """Of EM after the first selection."""
    round_passes: int = 4
    """Of EM in each round."""
    first_sigma: float = 0.01
    """[m] range noise to begin with."""
    wide_ratio: float = 1.5
    """Times the assumed spread across faces that hits must have for the first selection to be done again."""
    max_selections: int = 3
    """First selections, at most."""
    min_face_gain: float = 8.0
    """[nats] that a face must be worth to stay."""


@dataclass(frozen=True, kw_only=True)
class FacePredictionSettings:
    """What a prediction answers (`prediction`, `sampling`, `observed_space`, `model`)."""

    observed_cell: float = 0.10
    """[m] side of the cells of observed space."""
    max_observed_cells: int = 1 << 26
    """Cells of that grid; a larger one is made coarser."""
    support_margin: float = 0.10
    """[m] before the predicted range a ray needs no support any more: the surface itself was seen."""
    max_p_off: float = 0.05
    """Chance of being off above which a ray is not answered."""
    max_stray: float = 2e-3
    """[1/m] returns that no face explains, above which cells predict; 1e-4 in clean rooms, 7e-3 on logs of real floors.

    Set between the two: `python -m benchmarks.office_graph` and `python -m benchmarks.real_logs LOG`.
    """
    min_survival: float = 0.001
    """Chance to be still under way, below which a ray is not followed."""
    min_share: float = 1e-4
    """Chance to stop, below which a face is no candidate."""
    edge_sigmas: float = 4.0
    """Standard errors of an edge's place within which it is blurred."""
    min_edge_variance: float = 1e-8
    """[m²] of an edge's place."""


@dataclass(frozen=True, kw_only=True)
class FaceUpdateSettings:
    """A graph that takes in further runs (`update`)."""

    explained_within: float = 0.03
    """[m] of a visible stretch, a remembered hit is explained by it."""
    em_passes: int = 3
    """Of EM on the new rays."""
    pass_distance: float = 0.1
    """[m] behind a new face, that old rays must have crossed to count as having gone through it."""


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
"""The settings of the model `faces`."""
