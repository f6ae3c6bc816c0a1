"""Settings of the scan channel: every tuned number of `diagnosis/scan` with its unit, its meaning and what set it.

One frozen dataclass, `ScanSettings`, with one group per stage; `SCAN` is the instance that the modules use. One piece
is clearer than many, since it is the only table of these numbers.

Unless a group says otherwise, its numbers were set on the development cases of the hidden-effects benchmark:

    python -m benchmarks.hidden_effects.generate --suite SUITE --seeds dev --n N -o DIR
    python -m benchmarks.hidden_effects.run DIR

with SUITE one of singles, none, pairs, triples and foreign. Numbers of the site baseline were set on stretches of
public logs with `python -m benchmarks.planted_effects`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sensorgraph.world.robot import Tolerances


@dataclass(frozen=True, kw_only=True)
class NoiseBounds:
    """Limits of the estimated beam noise and of the scale of the tolerances; a commissioning run narrows them."""

    core: tuple[float, float] = (0.75, 1.15)
    """Scale of the sensor's nominal standard deviation."""
    tail: tuple[float, float] = (0.005, 0.2)
    """Share of returns with the wide standard deviation."""
    loss: tuple[float, float] = (1e-4, 0.002)
    """Chance that a ray which should return does not."""
    stray: tuple[float, float] = (1e-4, 0.002)
    """Share of readings from anywhere."""
    min_pose_scale: float = 1.0
    """Least scale of the tolerances of the reference poses."""
    max_scale: float = 3.5
    """Largest scale of the tolerances of poses and map, where the data say that they are too tight."""


@dataclass(frozen=True, kw_only=True)
class IntakeSettings:
    """Which runs are accepted, and how much of a run is used."""

    min_scans: int = 50
    """Scans with a pose."""
    min_rays: int = 3
    """Rays per scan."""
    max_readings: int = 100_000
    """Readings used; beyond this the map and the poses, not the noise, limit what can be told."""
    min_sigma: float = 5e-4
    """[m] least standard deviation of a return."""
    velocity_window: float = 0.2
    """[s] on either side, over which the reference is fitted for its velocity."""
    max_bearing_mismatch: float = 0.02
    """[rad] between the run's bearings and those of robot.yaml."""
    range_max_slack: tuple[float, float] = (1.02, 0.05)
    """Factor and [m] by which a reading may exceed range_max."""
    max_share_beyond_range: float = 0.01
    """Share of readings that may exceed even that."""
    located_pose: tuple[float, float] = (0.03, 0.015)
    """[m, rad] by which poses that were found from these very scans may be off: a bias, a wall or a stretch of the map has pulled
    them by up to its own size, from one and a half to several times what is material."""
    located_freedom: float = 3.0
    """Times that, their tolerance: what pulls them pulls all of them alike, and a tolerance of single scans would count it in each."""
    min_tolerances: Tolerances = field(
        default_factory=lambda: Tolerances(
            map=2e-4, mount_xy=1e-4, mount_yaw=2e-5, pose_xy=2e-4, pose_yaw=1e-4, stamp=1e-4
        )
    )
    """[m, m, rad, m, rad, s] least tolerances: no set-up is perfect, and a zero has no logarithm."""


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings:
    """When the arena fits the run, and the search for a better place (`map_alignment`)."""

    wall_distance: float = 0.15
    """[m] from a wall within which a ray ends at it."""
    min_share: float = 0.3
    """Share of returns at walls, below which no name would mean anything."""
    poor_share: float = 0.45
    """Share of returns at walls, below which a better place is looked for."""
    good_share: float = 0.8
    """Share of returns at walls, below which another scale of the map is looked for."""
    min_matching: float = 0.45
    """Share of readings as long as the arena makes them, below which the run is of another place."""
    partly_matching: float = 0.65
    """The same share, below which only few effects are named."""
    matching_error: tuple[float, float] = (0.15, 0.05)
    """[m] and share of the range by which a reading may differ and still count as matching."""
    matching_scans: int = 100
    """Scans that are cast for that share."""
    min_gain: float = 0.25
    """Share of returns by which another place must be better."""
    min_scale_gain: float = 0.05
    """Share of returns by which another scale must be better than another place."""
    cell: float = 0.1
    """[m] of the raster of walls."""
    max_cells: int = 600
    """Cells of the raster along its longer side."""
    coarse_cell: float = 1.0
    """[m] of the raster, from which on it tells nothing: the share is taken from the walls, and the map must be shrunk."""
    n_points: int = 3000
    """Ends of rays that are laid over the walls."""
    min_points: int = 100
    """Ends of rays below which the question is not asked."""
    n_turns: int = 90
    """Headings that are tried."""
    refined_turns: int = 12
    """Best coarse headings that are refined: in a square room four, and the neighbours of each."""
    scale_range: tuple[float, float] = (0.5, 2.0)
    """Scales of the map that are tried."""
    n_scales: int = 47
    """Count of them, 3 % apart."""
    far_range: tuple[float, float] = (0.5, 1.2)
    """Scales beyond `scale_range` that are tried, of that at which the map is as wide as what the run has seen."""
    unit_range: tuple[float, float] = (1 / 30, 1.2)
    """The same of scales that another unit of length makes, for a run that has seen a small part of the map."""
    search_slack: float = 0.1
    """Share of returns by which a coarse match may fall short of what is asked, and still be refined."""
    refined_scales: int = 3
    """Best coarse scales that are refined."""
    scale_reach: tuple[float, float] = (0.95, 1.05)
    """Of a coarse scale, within which it is refined: all points on one spot of a wall would be a perfect fit."""
    scale_step: float = 0.015
    """First step of a scale."""
    turn_step: float = float(np.radians(2.0))
    """[rad] first step of a turn."""
    shift_step: float = 0.1
    """[m] first step of a shift."""
    min_shift_step: float = 1e-3
    """[m] at which the refinement ends."""
    max_orientation_error: float = 0.3
    """[m] median error of a scan that is turned or mirrored the right way."""
    second_run_share: float = 0.6
    """Of the first run's share of returns at walls, below which a second run is of another place."""


@dataclass(frozen=True, kw_only=True)
class NuisanceSettings:
    """What a careful set-up may hide, beyond the tolerances of robot.yaml."""

    max_tolerances: float = 2.5
    """Tolerances at which a nuisance is bounded; a larger error must be an effect."""
    bias: float = 0.0012
    """[m] standard deviation of a hidden range bias."""
    scale: float = 0.0005
    """Standard deviation of a hidden range scale."""
    drift: float = 0.0015
    """[m] standard deviation of a hidden drift over the run."""
    steady_stamp_share: float = 0.43
    """Of a stamp's tolerance, the part that is the same all through a run (latency)."""
    skew_stamp_share: float = 0.7
    """Of a stamp's tolerance, the part that may be a skew of the sweep."""
    min_cosine: float = 0.12
    """Cosine of the incidence below which a ray tells little (83 degrees)."""
    grazing_sigma: tuple[float, float] = (0.004, 0.003)
    """[m] and share of the range: extra standard deviation of a grazing ray, over the cosine of its incidence."""
    max_grazing_sigma: float = 1.0
    """[m] at most."""
    max_bent_sigma: float = 0.5
    """[m] largest extra standard deviation of a ray that a surface has bent."""
    max_corners: int = 400
    """Corners of a map beyond which none of them may shift; ..."""
    max_pixel_corners: int = 200
    """... of a map of pixels, those that most rays meet may, as many: errors of the others are noise. A building has thousands,
    and time grows with their square."""
    max_pose_error: float = 3.5
    """Mahalanobis length that the estimated pose error of a scan may have."""
    stretched_scale: float = 1.3
    """Scale of the tolerances above which they count as stretched."""


@dataclass(frozen=True, kw_only=True)
class LikelihoodSettings:
    """The beam mixture of one reading (`likelihood`, `beam_mixture`)."""

    tail_width: float = 3.0
    """Standard deviation of the tail over that of the core."""
    unexplained: float = 1e-5
    """Chance of a reading that nothing explains."""
    lost_at_edge: float = 0.02
    """Chance that a beam which passes an edge does not come back."""
    min_resolution: float = 1e-4
    """[m] resolution of a reading where robot.yaml gives none."""
    min_edge_chance: float = 0.002
    """Chance of reading the other side of an edge, below which a ray counts as clear of it."""
    min_edge_step: float = 2.0
    """Standard deviations of the sensor by which the two sides of an edge must differ."""
    stray_responsibility: float = 0.5
    """Responsibility of the stray component above which a reading counts as stray."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """When the iterations of a fit end, and what counts as a jump to another surface (`fit`, `gauss_newton`)."""

    min_round_gain: float = 0.05
    """[nats] of a round of expectation and maximisation, below which it is the last."""
    end_of_search: float = 0.2
    """Of the first step of a searched parameter, below which its search ends."""
    max_strides: int = 16
    """Rounds of a search at most, whose steps have grown in between: it began far off."""
    min_cast_gain: float = 0.3
    """[nats] of another cast, below which it is the last."""
    map_casts: int = 4
    """Casts at most of a map of pixels without effects, whose walls are laid on the readings."""
    pose_casts: int = 3
    """Casts at most of a fit that others are compared with, each at the poses of the one before, where the reference is wide."""
    pose_rounds: int = 5
    """Rounds of the fit at each of them, as the likely poses are found first."""
    settled_step: float = 0.2
    """Standard errors below which a step is too small for another cast."""
    profile_tolerance: float = 0.02
    """Relative step at which the search for a share or a width ends."""
    max_profile_casts: int = 9
    """Casts of that search."""
    noise_rounds: int = 3
    """Rounds of the noise where it is estimated again at a step of a searched parameter."""
    pose_steps: tuple[float, float, float] = (5e-4, 5e-4, 3e-4)
    """[m, m, rad] of the difference quotients by the pose."""
    max_pose_slope: float = 60.0
    """[1, 1, m/rad] a larger quotient by the pose is a jump to another surface."""
    min_known_corners: int = 6
    """Corners that the data must tell of before the map's tolerance is scaled."""
    max_prior_share: float = 0.6
    """Share of a corner's prior variance that is left, below which the data tell of it."""


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """Evidence that an effect takes, and the search for effects (`model_selection`, `score_test`)."""

    threshold: float = 12.0
    """[nats] of evidence that a name takes, beyond the price of its parameters."""
    price: float = 4.0
    """[nats] per parameter."""
    n_obstacle_places: int = 6
    """Places among which an obstacle counts as chosen, for the price of the choice."""
    min_refit_gain: float = 120.0
    """[nats] by which the fit without a candidate must have become better, for all candidates to be tried again."""
    max_effects: int = 5
    """Effects in one model."""
    max_effects_if_partly_matching: int = 3
    """The same where the arena matches the run only in part: many names would not mend that."""
    max_candidates: int = 10
    """Candidates fitted on a part of the scans."""
    max_searched: int = 5
    """Candidates whose searched parameters are searched."""
    max_finalists: int = 3
    """Candidates fitted on all scans."""
    finalist_share: float = 0.5
    """Of the best gain; candidates farther behind are not fitted on all scans."""
    gain_margin: float = 20.0
    """[nats] of slack on gains that were found on a part of the scans."""
    n_scans: int = 130
    """Scans on which all candidates are fitted."""
    min_expected_gain: float = 3.5
    """[nats] expected of a smooth effect that is worth a fit; bounds on the nuisances hide a part of it."""
    searched_share: float = 0.2
    """Of the best gain; searched parameters of candidates farther behind are not searched."""
    same_gain: float = 0.8
    """Of the gain expected of a candidate before any other effect was in the model, and of that now: from this share on it is
    as much, and no part of what the other effects leave."""
    hopeless_gain: float = -50.0
    """[nats] below which a candidate is not compared."""
    absorber_share: float = 0.5
    """Of the gain of an absorber, that makes it yield to an effect that is none."""
    material_margin: float = 6.0
    """[nats] by which a material effect may gain less than one below its materiality, and still come first."""
    end_blur: float = 2.0
    """Standard deviations of where a ray meets its wall, within which it may miss the end of a part."""


@dataclass(frozen=True, kw_only=True)
class SweepSettings:
    """Values that effects ask to be cast (`propose`); what proposals take is in `sensorgraph.effects.proposals`."""

    n_scans: int = 60
    """Scans on which values are cast."""
    n_scans_of_large_map: int = 20
    """The same where the map has too many corners to be fitted."""
    max_core: float = 1.1
    """Scale of the noise above which it has taken along what is looked for, so that nominal noise is used."""
    max_tail: float = 0.1
    """The same of the share of the tail."""
    max_candidates: int = 2
    """Best groups that are proposed."""


@dataclass(frozen=True, kw_only=True)
class StandardErrorSettings:
    """Half-widths of searched parameters (`standard_errors`)."""

    block: float = 1.0
    """[s] of scans that share their errors."""
    fall: float = 0.5
    """[nats] by which the log-likelihood falls over one standard error."""
    fall_window: tuple[float, float] = (0.15, 1.5)
    """[nats] falls from which the half-width follows by a parabola."""
    broad_fall_window: tuple[float, float] = (1.0, 12.0)
    """[nats] the same for effects on single readings, whose likelihood is jagged in the small."""
    max_casts: int = 7
    """Casts per side."""
    first_step: float = 0.1
    """Of the search's first step."""
    max_step: float = 20.0
    """Times the search's first step; beyond, a parameter is not known."""
    obstacle_step: float = 0.02
    """[m] first step along which an obstacle is moved."""


@dataclass(frozen=True, kw_only=True)
class ObservabilitySettings:
    """What a run should have shown (`observability`); what single effects take stands with them."""

    size: float = 3.0
    """Materialities: an effect of this size should show."""
    max_correlation: float = 0.98
    """Of projected columns, above which effects are the same to a run."""


@dataclass(frozen=True, kw_only=True)
class GoodnessOfFitSettings:
    """When a model leaves something unexplained (`goodness_of_fit`, `deviations`)."""

    block: float = 1.0
    """[s] of scans that share their errors."""
    cell: float = 0.5
    """[m] of the raster of places."""
    clip: float = 4.0
    """Standard deviations at which a residual is cut."""
    max_scatter: float = 4.0
    """Times sensor.sigma that a laser may scatter, where that explains more than effects do."""
    bent_reference: float = 2.0
    """Tolerances of the reference by which it must be bent, to be bent though the scans fit the arena with its poses."""
    max_common_spread: float = 0.15
    """Excess of the mean square that all bins may share: the level of the noise, which names no place."""
    min_rays: int = 40
    """Rays in a bin."""
    min_blocks: int = 5
    """Blocks in a bin."""
    listed_z: float = 3.5
    """z above which a bin is listed as a deviation."""
    replicate_z: float = 2.5
    """The same in replicates."""
    max_listed: int = 24
    """Deviations listed before any naming."""
    min_z: Mapping[str, float] = field(
        default_factory=lambda: {"bias": 4.5, "spread": 6.0, "outliers": 6.0, "misses": 6.0}
    )
    """By kind of deviation: z below which nothing is suspect."""
    min_size: Mapping[str, float] = field(
        default_factory=lambda: {"bias": 0.2, "spread": 0.15, "outliers": 0.004, "misses": 0.005}
    )
    """By kind: standard deviations, ratio, share, share below which a deviation does not matter."""
    min_scatter: Mapping[str, float] = field(
        default_factory=lambda: {"bias": 1.0, "spread": 1.6, "outliers": 0.04, "misses": 0.04}
    )
    """By kind: least scatter of one ray's score."""
    min_range_error: float = 0.003
    """[m] by which readings, or their noise, must be off for a user to mind; and `min_size["bias"]` of sigma."""
    min_affected_share: float = 0.002
    """Of all readings, that must be off by so much."""
    min_wrong_share: float = 0.002
    """Of all readings, that must be strays or missing for a user to mind."""
    n_replicates: int = 12
    """Replicates drawn from the model."""
    replicate_factor: float = 1.25
    """Times the largest z of the replicates that a deviation must exceed."""
    replicate_sigmas: float = 4.0
    """Standard deviations of the replicates' z, above their mean, that it must exceed too."""
    min_share_of_gain: float = 0.003
    """Of the model's gain; a smaller misfit is the coarseness of a right model."""
    max_dispersion: float = 1.45
    """Variance ratio between scans and within; right models have 0.85 to 1.15."""
    min_absence_gain: float = 100.0
    """[nats] that the absence of something for one stretch of the run must explain."""
    min_absence_rays: int = 20
    """Rays that must ask for it."""
    max_tolerance_scale: float = 3.2
    """Times the nominal tolerances beyond which the set-up is not the one described."""
    max_tolerance_scale_beside_effects: float = 2.0
    """The same where effects stand in the model: they have taken a part of it."""
    widened_max_scale: float = 1.3
    """Largest further scale of the tolerances, once they have been widened."""
    outline_distance: float = 0.1
    """[m] from mapped walls, beyond which an obstacle is no part of them."""
    min_absorbed_rays: int = 20
    """Readings that an absorbing effect must have taken before its law is tested."""
    failed_law_share: float = 0.1
    """Of an effect's evidence, that counts as unexplained where its own law fails."""
    neighbour_distance: float = 0.3
    """[m] between the ranges of neighbouring rays within which they meet the same thing."""
    min_clustered_share: float = 0.5
    """Share of short readings with a neighbour, below which they are no people, where two rays meet a leg."""
    leg_width: float = 0.13
    """[m] of what a laser sees of somebody at least: a leg below the knee."""
    range_bin: float = 0.06
    """[m] of a histogram of short readings."""
    max_bin_share: float = 0.4
    """Share of short readings in one bin, above which they are no people."""
    min_bin_seconds: int = 5
    """Seconds of the run in which readings must lie in that bin: somebody who passes is at one range for less."""
    min_wrap: float = 1.0
    """[m] that short readings lack, from where ranges may have begun anew."""
    min_wrapped_share: float = 0.8
    """Of short readings, that must lack the same."""
    max_repeated_share: float = 0.5
    """Share of short readings that repeat the scan before, above which they are no people."""
    max_person_width: float = 1.0
    """[m]"""
    max_wide_share: float = 0.3
    """Share of short readings of wider things, above which they are no people."""
    walking_speed: float = 2.0
    """[m/s]"""
    walking_slack: float = 0.15
    """[m] by which the middle of what is seen of a person moves besides."""
    min_followed: int = 30
    """Things that the next scan must look at."""
    min_found_share: float = 0.7
    """Of these that it must show, if they are people."""
    lost_by_chance: float = 1e-4
    """Chance of finding people again so seldom, below which they are none."""
    max_drawn_along: float = 2.0
    """Standard errors by which short readings may stay with the robot rather than in the room."""
    n_light_directions: int = 36
    """Directions of the room in which rays may be lost by light."""
    min_light_share: float = 0.3
    """Of rays to other walls, that must be lost in the directions in which a part of a wall seems to swallow them."""
    one_place: float = 1.5
    """[m] about the middle of short readings, within which they lie at one place."""
    min_place_share: float = 0.8
    """Of short readings, that must lie there; and of all returns, that must lie elsewhere."""
    never_elsewhere: float = 0.95
    """Of short readings, that lie there: then half as wide a thing fills the place."""
    min_place_times: int = 3
    """Times of the run, with pauses, at which something must be there: somebody who passes comes once or twice."""
    max_light_share: float = 0.15
    """Of the rays to that part, that may be lost in a direction from which no light comes."""
    clearly_better: float = 1.0
    """[nats] by which a model must make a reading likelier than another to explain it."""
    standing_time: float = 3.0
    """[s] after and before a short reading that are left out: a person walks some 3 m meanwhile."""
    standing_window: float = 20.0
    """[s] after and before it, within which what stands is still there."""
    standing_reach: float = 0.05
    """[m] beside the end of a short reading, within which another ray comes there."""
    standing_ray_share: float = 0.25
    """Of the rays that come there, that must end there: thin legs stop one in three."""
    standing_places: int = 200
    """Ends of short readings that are looked at."""
    min_standing_rays: int = 5
    """That must come to such a place, later or before."""
    min_standing_places: int = 20
    """That are looked at so often."""
    max_standing_share: float = 0.5
    """Share of these places at which something stands, above which the short readings are no people."""
    max_uniform_distance: tuple[float, float] = (0.15, 2.2)
    """Distance of the ranges of strays from uniform: at least this, and this over the root of their count."""
    max_clustered_strays: tuple[float, float] = (0.35, 3.0)
    """Share of strays with a neighbour: this, and so many times the share of strays of all readings."""
    min_rays_of_scan: int = 10
    """Scored rays, beyond which a scan counts for the dispersion."""
    min_scans: int = 30
    """Scans below which the dispersion is not estimated."""
    range_max_margin: float = 4.0
    """Standard deviations below range_max, from where a ray is due to return."""


@dataclass(frozen=True, kw_only=True)
class ConstancySettings:
    """When a number of the sensor is said to have changed during the run (`constancy`)."""

    n_parts: int = 16
    """Parts of the run, in time, between which it may change."""
    min_scans: int = 4
    """Scans of a part, below which the run is too short to tell."""
    max_refitted: int = 2
    """Numbers that are fitted with two values: those that gain most to first order."""
    rounds: int = 8
    """Of these fits."""
    trimmed_share: float = 0.15
    """Of the run, at its begin and its end, within which no change is looked for (Andrews 1993, section 4)."""
    confidence: float = 0.99
    """Of the quantile over all times and numbers that the scatter of the parts is judged by."""
    min_share: float = 0.5
    """Of the value over the whole run, that a change must reach; and of the larger value, below which the other is none."""
    max_wander: float = 2.7
    """Standard deviations by which a reference that wanders may differ in the mean between two parts of a run: of an
    autoregression of first order, 99 % stay within at the worst of all times and whatever its memory (largest of T / 12 to T)."""
    at_bound: float = 0.999
    """Of the bound of a nuisance, from where it does not give way."""


@dataclass(frozen=True, kw_only=True)
class ProfileSettings:
    """Errors that depend on bearing or range (`error_profiles`)."""

    n_knots: int = 12
    """Bearings, or ranges, between which errors are interpolated."""
    min_rays: int = 3
    """Per knot, below which a sensor is not asked."""
    rounds: int = 8
    """Of the fit."""
    min_first_order_share: float = 0.1
    """Of what all effects gain, that a profile must gain to first order to be fitted in their stead."""
    max_uneven_share: float = 0.1
    """Of the square of the errors, that may be left of a wider field of view, for it to be called that."""


@dataclass(frozen=True, kw_only=True)
class OddScanSettings:
    """Two kinds of scan in place of one (`odd_scans`)."""

    delays: tuple[float, ...] = (-0.15, -0.05, -0.015, 0.015, 0.05, 0.15)
    """[s] from the common delay, at which that of the second kind begins."""
    wider: tuple[float, ...] = (10.0, 30.0, 100.0)
    """Times that the reference of the second kind is worse than its tolerance."""
    offsets: tuple[float, ...] = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
    """[m] standard deviations of an offset of each scan."""
    n_replicates: int = 4
    """Replicates drawn from the model; scans must differ more than in each of them."""
    replicate_factor: float = 2.0
    """Times the gain of a replicate that scans which differ must bring: by how much a reference's error varies within a sweep
    is known to a third of it, and gains go with the square."""
    min_roughness: float = 1.2
    """Ratio of von Neumann from which on offsets belong to single scans, and not to the place."""
    max_changes_share: float = 0.3
    """Of the changes from late scans to others that chance makes, below which the two delays have stretches of the run: a
    delay that grows makes one or two, scans that are late one by one all of them."""
    clear_lead: float = 2.0
    """Times as likely as late or wrong poses (in nats), that offsets must be."""
    left_share: float = 0.5
    """Of what wrong poses explained without two delays, that may be left to them for two delays to be told."""
    first_share: float = 0.2
    """Of the scans, that the second kind begins with."""
    min_share: float = 1e-3
    """Of either kind."""
    min_scans: int = 5
    """Of the rarer kind: fewer are mishaps, and no kind."""
    rounds: int = 40
    """Of expectation and maximisation."""
    refit_rounds: int = 8
    """Of the fit in which each scan has one of two delays."""


@dataclass(frozen=True, kw_only=True)
class HeldOutSettings:
    """Scans that are kept from every fit and choice (`held_out_gap`)."""

    block: float = 1.0
    """[s] of scans that are held out together."""
    every: int = 8
    """One block in so many is held out."""
    n_replicates: int = 4
    """Replicates that the noise floor is averaged over."""
    pose_rounds: int = 3
    """Rounds of the pose error of a scan."""


@dataclass(frozen=True, kw_only=True)
class SiteSettings:
    """Baseline of a site: what good runs show though nothing is wrong (`commissioning`, `site_variation`)."""

    n_parts: int = 8
    """Parts of a run in time, and of its rays by bearing, for the jackknife."""
    confidence: float = 0.999
    """Of the t and F quantiles."""
    disagreement: float = 0.05
    """Chance, if clutter speaks for an effect of the sensor as often as against it, below which parts of the way agree."""
    min_windows: int = 4
    """Windows that a spread takes."""
    prior_windows: float = 3.0
    """Windows' worth of belief that a careful set-up varies by `prior_share` of the materiality."""
    prior_share: float = 1 / 3
    """Of the materiality."""
    free_width: float = 1e3
    """[m, rad, s] prior width of a number that is free."""
    clutter_factor: float = 3.0
    """Times the most that clutter alone has brought in one good run, that a name takes."""
    local_clutter_factor: float = 2.0
    """The same for effects at one place, of which a good run shows the worst of many."""
    min_clutter_factor: float = 1.4
    """Least such factor where several good runs show how far clutter goes."""
    max_clutter_factor: float = 3.0
    """And the largest."""
    min_wall: float = 0.3
    """[m] median length of walls, below which a map has no panes."""
    wide_noise: NoiseBounds = field(
        default_factory=lambda: NoiseBounds(
            core=(0.3, 4.0), tail=(0.005, 0.6), loss=(1e-4, 0.3), stray=(1e-4, 0.5), max_scale=1.0
        )
    )
    """Bounds of the noise in a run that is known to be good."""
    min_noise: Mapping[str, float] = field(
        default_factory=lambda: {"core": 0.1, "tail": 0.001, "loss": 1e-4, "stray": 1e-4}
    )
    """Least lower bounds of the noise of later runs."""
    noise_rise: float = 1.15
    """Factor by which noise levels may rise above those of the good run."""
    noise_fall: float = 2.0
    """Factor by which they may be lower: less noise is no effect."""
    misfit_factor: float = 3.0
    """Times the good run's own misfit, before anything is said to be unknown."""
    doubt_factor: float = 1.5
    """Times a doubt's threshold: the clutter of two days is never quite the same."""
    doubt_share: float = 0.02
    """Of the misfit beyond that, which counts against names."""
    sector: float = float(np.radians(20.0))
    """[rad] of rays that share what is in their way."""
    inner_share: float = 0.7
    """Of a disc's radius, within which a ray is aimed at it whatever the pose's error."""
    min_stopped_share: float = 0.95
    """Of the rays aimed at a thing in free space that it stops, if it stands there."""
    max_beside_share: float = 0.1
    """Of the rays that it stops, that may end as near beside it, if it stands alone."""
    min_stopped_rays: int = 30
    """That it stops."""
    min_stopped_scans: int = 10
    """That show it."""
    pose_factors: tuple[float, ...] = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5)
    """Factors of the tolerances of the poses that are tried."""
    windows: tuple[int, ...] = (1, 2, 4)
    """The run is looked at as a whole, in halves and in quarters."""


@dataclass(frozen=True, kw_only=True)
class NamingSettings:
    """Which effects of the accepted model are named (`diagnosis/naming.py`)."""

    min_material_probability: float = 0.65
    """Chance that an effect's size is material, which a name takes."""
    min_part: float = 0.15
    """[m] of a pane, a mirror or a black part; a shorter one may be a blurred corner."""
    map_sigmas: float = 4.0
    """Map tolerances by which an obstacle over a mapped one must stand out of it."""
    map_pixels: float = 2.5
    """Pixels of the map by which an obstacle must stand out of a mapped one, and half of the least part of a wall."""
    min_wall_pixels: float = 20.0
    """Pixels of the map that a wall must be long to be asked whether it has moved; of a shorter one its neighbours would tell."""
    min_passed_share: float = 0.5
    """Of the rays aimed at an obstacle of a map of pixels, that must pass where it is gone."""
    max_unexplained_share: float = 0.006
    """Of an effect's evidence; where more than this stays unexplained, its name falls; ..."""
    max_pixel_share: float = 0.03
    """... more in a map of pixels, which is coarse itself; ..."""
    max_building_share: float = 0.1
    """... and most, where that is only the building, which is not as its map: an effect of the sensor is everywhere."""
    max_probability: float = 0.975
    """Most that a name deserves: now and then something outside the library looks like it."""
    probability_per_nat: float = 0.15
    """Slope of the log-odds of a name with its evidence, or its margin over a rival [1/nat]."""
    doubted_factor: float = 0.5
    """Of the probability, where something is left unexplained."""
    stretched_factor: float = 1.25
    """Times the scale of stretched tolerances that an effect must be material."""
    rival_margin: float = 3.0
    """[nats] between a name and its rival within which neither is said to be found."""


@dataclass(frozen=True, kw_only=True)
class ScanSettings:
    """All tuned numbers of the scan channel, by stage."""

    intake: IntakeSettings = field(default_factory=IntakeSettings)
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    nuisance: NuisanceSettings = field(default_factory=NuisanceSettings)
    noise: NoiseBounds = field(default_factory=NoiseBounds)
    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    standard_error: StandardErrorSettings = field(default_factory=StandardErrorSettings)
    observability: ObservabilitySettings = field(default_factory=ObservabilitySettings)
    goodness_of_fit: GoodnessOfFitSettings = field(default_factory=GoodnessOfFitSettings)
    constancy: ConstancySettings = field(default_factory=ConstancySettings)
    profiles: ProfileSettings = field(default_factory=ProfileSettings)
    odd_scans: OddScanSettings = field(default_factory=OddScanSettings)
    held_out: HeldOutSettings = field(default_factory=HeldOutSettings)
    site: SiteSettings = field(default_factory=SiteSettings)
    naming: NamingSettings = field(default_factory=NamingSettings)


SCAN = ScanSettings()
"""The settings in use."""
