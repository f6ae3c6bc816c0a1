"""Tuning parameters of localization, with unit and meaning; `benchmarks/locate.py` measures the defaults."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.types import Floats

UNKNOWN_NORMAL_LENGTH = 0.3
"""Length of the vector that replaces a unit normal where only the viewing side of a point is known."""
SIGNIFICANT = 4.0
"""Standard errors beyond which a difference is not chance."""
CAUCHY = 3.0
"""Standard deviations at which Cauchy's weight is 1/2."""
N_REWEIGHTED = 15
"""Number of reweighted fits of a robust estimate; it settles within ten."""
EDGE_FLOOR = (0.004, 0.004, 0.0007)
"""[m, m, rad] Minimum standard deviations of an edge of the pose graph."""


@dataclass(frozen=True, kw_only=True)
class PointSettings:
    """Selection of the returns that become points."""

    max_range: float = 30.0
    """[m] Longer returns are dropped: a heading error displaces them most, and they are sparse."""
    spacing: float = 0.015
    """[m] Minimum distance between consecutive points of a scan; closer points are dropped."""
    reach: float = 0.12
    """[m] Distance along the scan within which neighbours contribute to the normal of a point."""
    gap: float = 0.25
    """[m] Distance between neighbouring returns above which they lie on different surfaces."""


SCANS = PointSettings()


@dataclass(frozen=True, kw_only=True)
class LineSettings:
    """Points of a line map."""

    voxel: float = 0.05
    """[m] Side of the cells in which points with similar normals are averaged; it bounds the cost of a match."""


LINES = LineSettings()


@dataclass(frozen=True, kw_only=True)
class LineMatchSettings:
    """Robust point-to-line match."""

    first_radius: float = 0.35
    """[m] Initial radius around a point within which the line is fitted; also the side of a map bucket."""
    last_radius: float = 0.20
    """[m] Radius in the last iterations."""
    sigma: float = 0.03
    """[m] Standard deviation of a return around its line: range noise plus the deviation of the surface from
    a line."""
    iterations: int = 12
    """Maximum number of Gauss-Newton steps."""
    tolerance: float = 1e-4
    """[m, rad] Largest component of a step below which the iteration stops."""
    roundness: float = 0.15
    """Ratio of the variances across and along a line above which it is a spot; a spot also constrains the
    tangential direction."""
    min_points: float = 2.0
    """Sum of neighbour weights below which no line is fitted."""
    same_side: float = 0.3
    """Cosine between two normals below which their points lie on different surfaces."""
    min_noise: float = 0.002
    """[m] Lower bound of the noise of residuals, and of the roughness of a surface; it keeps information finite."""
    inlier: float = 2.0
    """Number of standard deviations within which a point is an inlier."""
    dense: float = 0.09
    """[m] Point spacing of a scan above which the radii grow in proportion."""
    max_growth: float = 4.0
    """Maximum growth factor of the radii."""

    def for_spacing(self, spacing: float) -> LineMatchSettings:
        """Return the settings for scans with points `spacing` [m] apart: larger radii for lasers with few rays."""
        growth = min(max(spacing / self.dense, 1.0), self.max_growth)
        return replace(self, first_radius=growth * self.first_radius, last_radius=growth * self.last_radius)


MATCH = LineMatchSettings()


@dataclass(frozen=True, kw_only=True)
class WheelSettings:
    """Priors and noise of the wheel odometry, before and after calibration by the laser."""

    way_scale_sd: float = 0.1
    """Prior standard deviation of the distance scale."""
    turn_scale_sd: float = way_scale_sd
    """Prior standard deviation of the turn scale."""
    heading_bias_sd: float = 0.05
    """[rad/m] Prior standard deviation of the heading bias."""
    place_floor: float = 0.01
    """[m] Position noise of a step of any length, as a standard deviation."""
    ahead_per_metre: float = 0.08
    """[m/m] Position noise along the path, per distance driven."""
    left_per_metre: float = 0.05
    """[m/m] Position noise across the path, per distance driven."""
    place_per_turn: float = 0.03
    """[m/rad] Position noise per turn."""
    turn_floor: float = 0.004
    """[rad] Heading noise of a step of any length, as a standard deviation."""
    turn_per_metre: float = 0.03
    """[rad/m] Heading noise per distance driven."""
    turn_per_turn: float = 0.1
    """[rad/rad] Heading noise per turn."""
    max_speed: float = 5.0
    """[m/s] Speed above which a step is a jump of the odometry."""
    max_turn_rate: float = 10.0
    """[rad/s] Turn rate above which a step is a jump of the odometry."""
    min_scatter: float = 0.05
    """Lower bound of the estimated wheel noise, relative to the standard deviations above."""
    max_scatter: float = 3.0
    """Upper bound of the estimated wheel noise, relative to the standard deviations above."""
    unknown_sd: float = 1.0
    """[m, rad] Standard deviation of a step without odometry."""
    stretches: int = 12
    """Number of segments of a log with independent slip; their differences give the standard errors."""


WHEELS = WheelSettings()


@dataclass(frozen=True, kw_only=True)
class FrontEndSettings:
    """Tracking against the last key frames."""

    key_frame_distance: float = 0.3
    """[m] Distance between key frames."""
    key_frame_turn: float = 0.21
    """[rad] Turn between key frames."""
    window: int = 40
    """Number of recent key frames in the map to match against."""
    still_distance: float = 0.02
    """[m] Motion below which a scan is placed by the odometry instead of a match."""
    still_turn: float = 0.01
    """[rad] The same for turns."""
    still_time: float = 0.5
    """[s] Time after the last match beyond which a scan is matched even at standstill."""
    min_inliers: float = 0.6
    """Minimum share of inliers among the points near a surface; below, other starts are tried."""
    min_continuity: float = 0.8
    """Minimum agreement of a scan at its odometry pose, relative to the last match. Below, the robot may have
    been carried, so that continuity is not known. Of 360 carried robots, all were below 0.75 except those set
    down at nearly the same pose. Of 11,383 scans of three logs, 8 were below (swapped halves of
    `benchmarks/localize_in_map.py`)."""
    max_slip: float = 8.0
    """Deviation of a match from its odometry pose, in standard deviations of the odometry, beyond which it counts only if the
    odometry is contradicted: a narrow laser in a cave had wrong matches from 8 on. Of 4,934 scans of fr079, a dozen right ones
    are 8 to 12 off; they are matched again from the poses of the scans around them (`mapping.py`)."""
    unknown_motion: tuple[float, float, float] = (1.0, 1.0, 0.5)
    """[m, m, rad] Standard deviations of a motion that is not known, as between two track segments; also the greatest slip
    ahead, to the left and in heading. After a gap in the scans, `max_slip` standard deviations are many metres, but a long way
    averages and errs by more than this only within `SIGNIFICANT` standard deviations."""
    min_overlap: float = 0.3
    """Minimum share of the points with a surface near them."""
    min_share_elsewhere: float = 0.85
    """Minimum agreement of a match from another start, relative to the usual agreement: many poses fit a room
    partly."""
    min_share_after_failure: float = 0.5
    """The same for a match near the prediction, after scans without a match."""
    agreement_rate: float = 0.05
    """Weight of a new match in the usual agreement."""
    start_turns: tuple[float, ...] = (0.0, -0.1, 0.1, -0.21, 0.21)
    """[rad] Heading offsets of the other starts."""
    start_offsets: tuple[float, ...] = (0.0, -0.25, 0.25)
    """[m] Position offsets of the other starts, along and across."""
    patience: float = 2.0
    """[s] Time without a match after which a new track segment begins; so it does after `patience_distance`."""
    patience_distance: float = 1.0
    """[m] Distance driven without a match after which a new track segment begins."""
    patience_scans: int = 5
    """Minimum number of scans without a match before a new track segment begins."""
    speed_sd: float = 0.6
    """[m/s] Standard deviation of the change of speed between scans, without odometry."""
    turn_rate_sd: float = 0.8
    """[rad/s] Standard deviation of the change of turn rate between scans, without odometry."""
    correlation: float = 2.0
    """Factor by which the information of a match is reduced, since its residuals are correlated."""

    def most_slip(self, deviations: Floats) -> Floats:
        """Return the greatest slip (3,) [m, m, rad] for the standard deviations (3,) of a motion by the odometry."""
        usual = np.minimum(self.max_slip * deviations, self.unknown_motion)
        return np.asarray(np.maximum(usual, SIGNIFICANT * deviations))


FRONT_END = FrontEndSettings()


@dataclass(frozen=True, kw_only=True)
class GraphSettings:
    """Pose graph."""

    cauchy: float = 1.0
    """Residual [standard deviations] at which Cauchy's weight of a closure is 1/2."""
    tolerance: float = 1e-4
    """Relative decrease of the error at which the optimization stops."""
    inlier_probability: float = 0.999
    """Chi-squared probability within which a closure is an inlier."""


GRAPH = GraphSettings()


@dataclass(frozen=True, kw_only=True)
class ClosureSettings:
    """Search and validation of loop closures."""

    submap: int = 16
    """Number of key frames of a submap; consecutive submaps overlap by half."""
    core: int = 6
    """Number of key frames in the middle of a submap that are searched for in an older one."""
    reach: float = 4.0
    """[m] Distance between the middles of two submaps that can observe the same surfaces."""
    window: float = 0.4
    """[m] Minimum half width of the search, and that of the second pass, after the first has closed the loops."""
    max_window: float = 12.0
    """[m] Maximum half width."""
    turn_window: float = 0.05
    """[rad] Minimum half width of the heading search. A closure is rejected if the standard deviation of its heading is larger,
    because it would constrain nothing."""
    turn_window_per_metre: float = 0.003
    """[rad/m] Growth of the heading half width per distance driven since the last closure."""
    max_turn_window: float = 0.8
    """[rad] Maximum heading half width."""
    broken_window: float = 6.0
    """[m] Half width of the search around each older submap after a break of the track, until the next
    closure."""
    broken_candidates: int = 40
    """Approximate number of older submaps that are searched after a break."""
    broken_score: float = 0.75
    """Minimum likelihood-field score after a break; it is higher because no prior pose supports the match."""
    candidates: int = 3
    """Number of older visits that are searched for each submap."""
    score: float = 0.55
    """Minimum likelihood-field score."""
    rivalry: float = 0.92
    """Share of the best score above which another place fits equally well."""
    rival_apart: float = 0.5
    """[m] Minimum distance between the best place and a rival."""
    rival_turn: float = 0.17
    """[rad] Minimum heading difference between the best place and a rival."""
    visits_apart: float = 2.0
    """[m] Minimum distance between places found in two older visits, which may have drifted relative to each
    other."""
    drift_per_metre: float = 0.0075
    """[m/m] Expected drift of the track per distance driven since the last closure; two places within it are
    rivals, and the half width of the search grows by twice as much."""
    inliers: float = FRONT_END.min_inliers
    """Minimum share of inliers among the points near surfaces."""
    overlap: float = 0.4
    """Minimum share of the points with a surface near them."""
    correlation: float = 20.0
    """Factor by which the information of a submap match is reduced, since its residuals are correlated."""
    weak: float = 0.03
    """[m] Standard deviation above which a direction is unconstrained, as along a corridor."""
    no_information: float = 10.0
    """[m] Standard deviation assigned to an unconstrained direction."""
    see_through: float = 0.2
    """Maximum share of an older place's visible points in space that rays crossed. True closures have at most
    0.22 in aces and 0.07 in fr079; the same closures displaced by 0.5 m have a median of 0.58."""
    margin: float = 0.15
    """[m] Distance before the end of a ray up to which the ray counts as having crossed space."""
    kept_pyramids: int = 128
    """Number of recently used submaps whose likelihood fields are kept; each takes 2 to 5 MB, and a day of
    driving has thousands."""
    solve_every: int = 4
    """Number of submaps between optimizations of the pose graph during the search."""
    second_turn: float = 0.035
    """[rad] Heading half width of the second pass."""

    @property
    def apart(self) -> int:
        """Minimum number of key frames between two submaps of a track segment; closer ones are neighbours along the track."""
        return self.submap + self.submap // 2


CLOSURES = ClosureSettings()


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """Joint refinement of poses and surfaces."""

    iterations: int = 8
    """Number of Gauss-Newton steps; the patches are cut anew before each."""
    first_side: float = 0.30
    """[m] Initial spacing of the surface patches."""
    last_side: float = 0.20
    """[m] Patch spacing in the last iterations."""
    first_gate: float = 0.25
    """[m] Initial distance from a patch's line within which points belong to it."""
    last_gate: float = 0.10
    """[m] The same in the last iterations."""
    first_sigma: float = 0.10
    """[m] Initial scale of Cauchy's weight, which is 1/2 at twice this distance; it is large so that
    displaced visits attract each other."""
    last_sigma: float = 0.02
    """[m] The same in the last iterations, unless the patch is rougher."""
    shrinkage: float = 10.0
    """Weight, in points, of the noise of all patches in the noise of one."""
    roundness: float = 0.25
    """Ratio of the variances across and along above which points form no patch."""
    min_points: float = 4.0
    """Minimum number of points of a patch."""
    tolerance: float = 1e-3
    """Relative residual at which conjugate gradients stop."""
    max_steps: int = 300
    """Maximum number of conjugate-gradient steps."""
    samples: int = 48
    """Number of bootstrap samples of the covariances; the relative error of a standard deviation is about 1 /
    sqrt(2 · samples)."""


REFINEMENT = RefinementSettings()


@dataclass(frozen=True, kw_only=True)
class FinalSettings:
    """Placement of the scans between key frames in the refined map."""

    place_sd: float = 0.03
    """[m] Standard deviation of the track between two key frames."""
    turn_sd: float = 0.015
    """[rad] Standard deviation of its heading."""
    inliers: float = 0.5
    """Minimum share of inliers among the points near surfaces."""
    overlap: float = FRONT_END.min_overlap
    """Minimum share of the points with a surface near them."""
    min_joining_closures: int = 2
    """Number of consistent loop closures that join a track segment to the map after a break."""

    @property
    def covariance(self) -> Floats:
        """Covariance (3, 3) of the track between two key frames."""
        return np.diag([self.place_sd**2, self.place_sd**2, self.turn_sd**2])


FINAL = FinalSettings()


@dataclass(frozen=True, kw_only=True)
class SmoothingSettings:
    """Noise of the laser odometry with which the poses of a run are smoothed."""

    step_floor: tuple[float, float, float] = (0.003, 0.003, 0.0008)
    """[m, m, rad] Standard deviations of a step from scan to scan, of any length."""
    step_per_metre: float = 0.01
    """[m/m, rad/m] Additional standard deviation per distance driven."""
    step_per_turn: float = 0.02
    """[m/rad, rad/rad] Additional standard deviation per turn."""
    unmatched_factor: float = 10.0
    """Factor on the standard deviation where the front end did not match a scan."""
    unknown_step: float = 100.0
    """[m, rad] Standard deviation where the motion is not known."""


SMOOTHING = SmoothingSettings()
