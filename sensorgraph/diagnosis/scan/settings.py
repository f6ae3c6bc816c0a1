"""Settings of the scan channel: every tuned number of `diagnosis/scan` with its unit, its meaning and its origin.

`ScanSettings` has one group per stage; the modules use its instance `SCAN`. All numbers are in this
one table.

Unless a group states otherwise, its numbers were tuned on the development cases of the hidden-effects
benchmark:

    python -m benchmarks.hidden_effects generate --world own --suite SUITE --n N -o DIR
    python -m benchmarks.hidden_effects answer DIR

SUITE is singles, none, pairs, triples or foreign. Numbers of the site baseline were tuned on parts of public
logs with `python -m benchmarks.planted_effects`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sensorgraph.world.robot import Tolerances


@dataclass(frozen=True, kw_only=True)
class NoiseBounds:
    """Limits of the estimated beam noise and of the tolerance scales; a commissioning run narrows them."""

    core: tuple[float, float] = (0.75, 1.15)
    """Scale of the sensor's nominal standard deviation."""
    tail: tuple[float, float] = (0.005, 0.2)
    """Share of returns with the wide standard deviation."""
    loss: tuple[float, float] = (1e-4, 0.002)
    """Probability that an expected return is missing."""
    stray: tuple[float, float] = (1e-4, 0.002)
    """Share of outliers, which are uniform over the range."""
    max_scale: float = 3.5
    """Maximum scale of the tolerances of poses and map, if the data contradict the specified ones."""


@dataclass(frozen=True, kw_only=True)
class IntakeSettings:
    """Conditions for accepting a run, and limits of the part that is used."""

    min_scans: int = 50
    """Minimum number of scans with a pose."""
    min_rays: int = 3
    """Minimum number of rays per scan, and between two knots of a profile of errors."""
    max_readings: int = 100_000
    """Maximum number of readings used. Beyond it, map and poses limit the accuracy, not the noise."""
    min_sigma: float = 5e-4
    """[m] Minimum standard deviation of a return."""
    velocity_window: float = 0.2
    """[s] Half-width of the window in which a line is fitted to the reference for its velocity."""
    max_bearing_mismatch: float = 0.02
    """[rad] Maximum difference between the run's bearings and those of robot.yaml."""
    range_max_slack: tuple[float, float] = (1.02, 0.05)
    """Factor, and [m], by which a reading may exceed range_max."""
    max_share_beyond_range: float = 0.01
    """Maximum share of readings beyond range_max with this slack."""
    located_pose: tuple[float, float] = (0.03, 0.015)
    """[m, rad] Possible error of poses that were located with the same scans. A bias, a wall or a part of the
    map shifts them by up to its own size, which is 1.5 to several times the material size."""
    located_freedom: float = 3.0
    """Tolerance of located poses, in multiples of `located_pose`. An effect shifts all poses alike, but a
    tolerance of single scans penalises the shift in each of them."""
    min_tolerances: Tolerances = field(
        default_factory=lambda: Tolerances(
            map=2e-4, mount_xy=1e-4, mount_yaw=2e-5, pose_xy=2e-4, pose_yaw=1e-4, stamp=1e-4
        )
    )
    """[m, m, rad, m, rad, s] Minimum tolerances: no setup is perfect, and 0 has no logarithm."""


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings:
    """Conditions under which the arena fits the run, and the search for a better alignment (`map_alignment`)."""

    wall_distance: float = 0.15
    """[m] Maximum distance between a wall and a ray that ends at it; half the maximum median error of a scan in the
    right orientation."""
    matching_error: float = 0.05
    """Share of the range by which a reading of the predicted length may be off, in addition to this distance."""
    poor_share: float = 0.45
    """Share of returns at walls below which a better alignment is searched for, and of readings with the predicted
    length below which the run belongs to another place."""
    good_share: float = 0.8
    """Share of returns at walls below which another scale of the map is searched for."""
    min_gain: float = 0.25
    """Minimum increase of the share of returns at walls in another alignment; half of it for a coarse one that is refined."""
    min_scale_gain: float = 0.05
    """Minimum increase of this share at another scale, over another alignment."""
    cell: float = 0.1
    """[m] Cell size of the raster of walls."""
    max_cells: int = 600
    """Maximum number of cells of the raster along its longer side."""
    coarse_cell: float = 1.0
    """[m] Cell size above which the raster is useless. The share is then computed from the walls, and the map
    must be shrunk."""
    n_points: int = 3000
    """Number of ray ends that are compared with the walls."""
    n_turns: int = 90
    """Number of headings that are tried."""
    n_refined: int = 12
    """Number of best coarse headings or scales that are refined: four headings in a square room, and the neighbours of each."""
    scale_range: tuple[float, float] = (0.5, 2.0)
    """Range of map scales that are tried."""
    n_scales: int = 47
    """Number of these scales, 3 % apart."""
    far_range: tuple[float, float] = (1 / 30, 1.2)
    """Scales outside `scale_range` that are tried, relative to the scale at which the map is as wide as the
    observed area. Below the first of `scale_range`, only units of length are tried, for a run that observed a small part of the map."""


@dataclass(frozen=True, kw_only=True)
class NuisanceSettings:
    """Errors that a careful setup may hide, in addition to the tolerances of robot.yaml."""

    max_tolerances: float = 2.5
    """Bound of a nuisance parameter, in tolerances; a larger error must be an effect."""
    hidden_share: float = 0.25
    """Standard deviation of a hidden bias, scale or drift of the ranges, relative to the materiality of the effect."""
    min_cosine: float = 0.12
    """Cosine of the incidence below which a ray carries little information (83 degrees)."""
    grazing_sigma: tuple[float, float] = (0.004, 0.003)
    """[m], and share of the range: additional standard deviation of a grazing ray, divided by the cosine of
    its incidence."""
    max_corners: int = 200
    """Number of corners of a map above which none of them may shift; in an occupancy-grid map, those that most rays meet. Errors
    of the others count as noise, because a building has thousands of corners, and time grows with the square of their number."""
    stretched_scale: float = 1.3
    """Scale of the tolerances above which they count as widened."""


@dataclass(frozen=True, kw_only=True)
class LikelihoodSettings:
    """Beam mixture of one reading (`likelihood`)."""

    tail_width: float = 3.0
    """Standard deviation of the tail, in multiples of the core's."""
    unexplained: float = 1e-5
    """Probability of a reading that no component explains."""
    lost_at_edge: float = 0.02
    """Probability that a beam which passes an edge does not return."""
    min_resolution: float = 1e-4
    """[m] Resolution of a reading if robot.yaml specifies none."""
    min_edge_chance: float = 0.002
    """Probability of reading the other side of an edge, below which a ray counts as clear of the edge."""
    min_edge_step: float = 2.0
    """Minimum range difference between the two sides of an edge, in standard deviations of the sensor."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Convergence of a fit, and detection of jumps to another surface (`fit`, `gauss_newton`)."""

    min_gain: float = 0.1
    """[nats] Gain of an expectation-maximisation round, or of another cast, below which it is the last."""
    max_strides: int = 16
    """Maximum number of rounds of a search with growing steps, which started far from the optimum."""
    casts: int = 4
    """Maximum number of casts of a fit, each at the effects, walls and poses of the previous one."""
    max_rounds: int = 30
    """Maximum number of expectation-maximisation rounds at the same cast; a fit ends earlier, when J no longer rises."""
    rounds: int = 6
    """Number of rounds for the pose of a held-out scan, and for the noise at a step of a searched parameter."""
    settled_step: float = 0.2
    """Step below which a fit has converged, in standard errors; of a search, relative to its first step."""
    profile_tolerance: float = 0.02
    """Relative step at which the search for a share or a width ends."""
    pose_steps: tuple[float, float, float] = (5e-4, 5e-4, 3e-4)
    """[m, m, rad] Steps of the difference quotients by the pose."""
    max_prior_share: float = 0.6
    """Remaining share of a corner's prior variance below which the data determine it."""


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """Evidence that an effect requires, and the search for effects (`model_selection`, `score_test`)."""

    threshold: float = 12.0
    """[nats] Evidence that a name requires, after the complexity penalty."""
    max_effects: int = 5
    """Maximum number of effects in a model."""
    max_candidates: int = 10
    """Maximum number of candidates fitted on a part of the scans."""
    max_finalists: int = 3
    """Maximum number of candidates whose rough parameters are searched, and that are fitted on all scans."""
    finalist_share: float = 0.5
    """Share of the best gain below which they are not."""
    gain_margin: float = 20.0
    """[nats] Slack on gains that were found on a part of the scans."""
    n_scans: int = 130
    """Number of scans on which all candidates are fitted."""
    n_readings: int = 50_000
    """Maximum number of readings of these scans: lasers of many rays need fewer scans."""
    n_cast_scans: int = 40
    """Number of scans on which values that effects request are cast, and effects for their consequence."""
    same_gain: float = 0.8
    """Minimum ratio of the smaller to the larger of a candidate's expected gains, in the bare model and now.
    Above it, the gain is unchanged, and the candidate is not a remainder of other effects."""


@dataclass(frozen=True, kw_only=True)
class GoodnessOfFitSettings:
    """Limits of residuals that a model leaves unexplained (`goodness_of_fit`, `unnamed`, `deviations`)."""

    cell: float = 0.5
    """[m] Cell size of the raster of places."""
    clip: float = 4.0
    """Standard deviations at which a residual is clipped, and from range_max within which a return is not due."""
    min_rays: int = 40
    """Minimum number of rays in a bin, and of scans for an estimate of the dispersion. Half as many scored rays are needed in each of
    these scans, and readings that an absorbing effect, or the absence of an object, explains."""
    min_blocks: int = 5
    """Minimum number of blocks in a bin, of scans away from their poses, of scans that show a change of a map, and of corners that
    determine the scale of its tolerance; fewer are single faults."""
    max_listed: int = 24
    """Maximum number of deviations that are listed before effects are named."""
    min_z: float = 4.5
    """z below which a deviation is neither listed nor tested."""
    min_range_error: float = 0.003
    """[m] Minimum error of readings, or of their noise, that matters."""
    min_error_of_sigma: float = 0.2
    """The same in standard deviations of a reading; the larger limit counts."""
    min_share: float = 0.002
    """Minimum share of readings with such an error, and of wrong or missing readings, that matters."""
    n_replicates: int = 12
    """Number of replicates simulated from the model."""
    replicate_factor: float = 1.25
    """Minimum ratio of a deviation to the largest z of the replicates."""
    n_slow_replicates: int = 4
    """Number of replicates in which scans away from their poses are searched for, and of those that give the
    noise floor of the gap."""
    min_ratio_of_scans: float = 2.0
    """Minimum ratio of their gain to that of a replicate. The reference error within a sweep is known to a
    third of its size, and gains grow with its square."""
    min_share_of_gain: float = 0.003
    """Share of the model's gain below which a misfit is attributed to a correct but coarse model; also the maximum unexplained
    misfit of a named effect, relative to its evidence."""
    max_dispersion: float = 1.45
    """Maximum ratio of the variance between scans to the variance within; correct models have 0.85 to 1.15."""
    max_tolerance_scale: float = 3.2
    """Multiple of the nominal tolerances above which the setup differs from its description."""
    max_tolerance_scale_beside_effects: float = 2.0
    """The same with effects in the model, which explain a part of the difference."""
    outline_distance: float = 0.1
    """[m] Distance from mapped walls above which an obstacle is separate from them."""
    failed_law_share: float = 0.1
    """Share of an effect's evidence that counts as unexplained if its readings contradict its properties; maximum unexplained
    misfit of a named effect, relative to its evidence, if only the building differs: an effect of the sensor shows everywhere."""
    clearly_better: float = 1.0
    """[nats] Minimum gain of a reading that one model explains and another does not."""


@dataclass(frozen=True, kw_only=True)
class SiteSettings:
    """Baseline of a site: apparent effects in known-good runs (`commissioning`, `worth`)."""

    n_parts: int = 8
    """Number of parts for the jackknife: of a run in time, and of its rays by bearing."""
    confidence: float = 0.999
    """Confidence level of the t and F quantiles."""
    disagreement: float = 0.05
    """Probability of as many agreeing parts of the path by chance, below which the parts agree on an effect
    of the sensor."""
    min_windows: int = 4
    """Minimum number of windows for a spread."""
    prior_windows: float = 3.0
    """Weight of the prior variation of a careful setup, in windows."""
    prior_share: float = 1 / 3
    """Prior variation of a careful setup, relative to the materiality."""
    clutter_factor: float = 1.4
    """Ratio of the evidence that a name requires to the largest evidence from clutter in good runs."""
    clutter_factor_of_one: float = 3.0
    """The same if there is only one good run, which does not show the spread of clutter. Also the ratio of a misfit to that of the
    good runs above which it may be reported as unknown."""
    min_wall: float = 0.3
    """[m] Median length of walls below which a map is too fragmented for effects of whole walls and edges."""
    wide_noise: NoiseBounds = field(
        default_factory=lambda: NoiseBounds(
            core=(0.3, 4.0), tail=(0.005, 0.6), loss=(1e-4, 0.3), stray=(1e-4, 0.5), max_scale=1.0
        )
    )
    """Bounds of the noise in a run that is known to be good."""
    sector: float = float(np.radians(20.0))
    """[rad] Width of a sector of rays that meet the same objects."""
    inner_share: float = 0.7
    """Share of a disc's radius within which a ray is aimed at it, whatever the pose error."""
    min_stopped_share: float = 0.95
    """Minimum share of the rays aimed at an object in free space that it stops."""
    max_beside_share: float = 0.1
    """Maximum number of rays that end next to it at the same distance, relative to the rays that it stops."""
    min_stopped_rays: int = 30
    """Minimum number of rays that it stops."""
    min_stopped_scans: int = 10
    """Minimum number of scans with such rays."""
    pose_factors: tuple[float, ...] = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5)
    """Factors on the pose tolerances that are tried."""
    windows: tuple[int, ...] = (1, 2, 4)
    """Numbers of windows into which the run is divided: the whole run, halves and quarters."""


@dataclass(frozen=True, kw_only=True)
class NamingSettings:
    """Conditions for naming an effect of the accepted model (`diagnosis/scan/naming.py`).

    A named effect is reported as the cause of a difference.
    """

    min_material_probability: float = 0.65
    """Minimum probability that the size of a named effect is material."""
    min_wall_pixels: float = 20.0
    """Minimum length of a wall that is tested for a move, in cells of the map; a shorter one moves with its
    neighbours."""
    rival_margin: float = 3.0
    """[nats] Evidence difference between an effect and its rival below which neither is named."""


@dataclass(frozen=True, kw_only=True)
class ScanSettings:
    """All tuned numbers of the scan channel, by stage."""

    block: float = 1.0
    """[s] Length of a block of scans with correlated errors; such a block is also held out together."""
    held_out_every: int = 8
    """One in this many blocks is excluded from every fit and choice (`held_out_gap`)."""
    intake: IntakeSettings = field(default_factory=IntakeSettings)
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    nuisance: NuisanceSettings = field(default_factory=NuisanceSettings)
    noise: NoiseBounds = field(default_factory=NoiseBounds)
    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    goodness_of_fit: GoodnessOfFitSettings = field(default_factory=GoodnessOfFitSettings)
    site: SiteSettings = field(default_factory=SiteSettings)
    naming: NamingSettings = field(default_factory=NamingSettings)


SCAN = ScanSettings()
"""Settings in use."""
