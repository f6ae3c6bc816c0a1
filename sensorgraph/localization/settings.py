"""What depends on robot, laser or building in localization, with unit and meaning.

`benchmarks/locate.py` and, in a known place, `benchmarks/localize_in_map.py` measure the defaults. Constants of an algorithm
are in the module that uses them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.jumps import JUMP_LIMITS
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
MIN_NOISE = 0.002
"""[m] Lower bound of the noise of residuals, and of the roughness of a surface; it keeps information finite."""
DENSE = 0.09
"""[m] Point spacing of a scan above which the radii of a match grow in proportion ..."""
MAX_GROWTH = 4.0
"""... up to this factor."""


@dataclass(frozen=True, kw_only=True)
class PointSettings:
    """Selection of the returns that become points."""

    max_range: float = 30.0
    """[m] Longer returns are dropped: a heading error displaces them most, and they are sparse."""
    gap: float = 0.25
    """[m] Distance between neighbouring returns above which they lie on different surfaces."""


SCANS = PointSettings()


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

    def for_spacing(self, spacing: float) -> LineMatchSettings:
        """Return the settings for scans with points `spacing` [m] apart: larger radii for lasers with few rays."""
        growth = min(max(spacing / DENSE, 1.0), MAX_GROWTH)
        return replace(self, first_radius=growth * self.first_radius, last_radius=growth * self.last_radius)


MATCH = LineMatchSettings()


@dataclass(frozen=True, kw_only=True)
class WheelSettings:
    """Priors and noise of the wheel odometry, before and after calibration by the laser."""

    scale_sd: float = 0.1
    """Prior standard deviation of the scales of distance and turn."""
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
    max_speed: float = JUMP_LIMITS.speed
    """[m/s] Speed above which a step is a jump of the odometry."""
    max_turn_rate: float = 10.0
    """[rad/s] Turn rate above which a step is a jump of the odometry."""


WHEELS = WheelSettings()


@dataclass(frozen=True, kw_only=True)
class FrontEndSettings:
    """Tracking against the last key frames."""

    key_frame_distance: float = 0.3
    """[m] Distance between key frames."""
    key_frame_turn: float = 0.21
    """[rad] Turn between key frames."""
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
    patience: float = 2.0
    """[s] Time without a match after which a new track segment begins, or after which the robot is lost in a known place; so it
    does after `patience_distance`."""
    patience_distance: float = 1.0
    """[m] Distance driven without a match after which a new track segment begins."""
    speed_sd: float = 0.6
    """[m/s] Standard deviation of the change of speed between scans, without odometry."""
    turn_rate_sd: float = 0.8
    """[rad/s] Standard deviation of the change of turn rate between scans, without odometry."""

    def most_slip(self, deviations: Floats) -> Floats:
        """Return the greatest slip (3,) [m, m, rad] for the standard deviations (3,) of a motion by the odometry."""
        usual = np.minimum(self.max_slip * deviations, self.unknown_motion)
        return np.asarray(np.maximum(usual, SIGNIFICANT * deviations))


FRONT_END = FrontEndSettings()


@dataclass(frozen=True, kw_only=True)
class ClosureSettings:
    """Search and validation of loop closures."""

    reach: float = 4.0
    """[m] Distance between the middles of two submaps that can observe the same surfaces."""
    max_window: float = 12.0
    """[m] Maximum half width of the search for a submap in an older one."""
    score: float = 0.55
    """Minimum likelihood-field score."""
    rivalry: float = 0.92
    """Share of the best score above which another place fits equally well."""
    drift_per_metre: float = 0.0075
    """[m/m] Expected drift of the track per distance driven since the last closure; two places within it are
    rivals, and the half width of the search grows by twice as much."""
    overlap: float = 0.4
    """Minimum share of the points with a surface near them."""
    weak: float = 0.03
    """[m] Standard deviation above which a direction is unconstrained, as along a corridor."""
    see_through: float = 0.2
    """Maximum share of an older place's visible points in space that rays crossed. True closures have at most
    0.22 in aces and 0.07 in fr079; the same closures displaced by 0.5 m have a median of 0.58."""
    margin: float = 0.15
    """[m] Distance before the end of a ray up to which the ray counts as having crossed space."""


CLOSURES = ClosureSettings()


@dataclass(frozen=True, kw_only=True)
class SmoothingSettings:
    """Noise of the laser odometry with which the poses of a run are smoothed."""

    step_floor: tuple[float, float, float] = (0.003, 0.003, 0.0008)
    """[m, m, rad] Standard deviations of a step from scan to scan, of any length."""
    step_per_metre: float = 0.01
    """[m/m, rad/m] Additional standard deviation per distance driven."""
    step_per_turn: float = 0.02
    """[m/rad, rad/rad] Additional standard deviation per turn."""


SMOOTHING = SmoothingSettings()


@dataclass(frozen=True, kw_only=True)
class KnownMapSettings:
    """A known map, and the likelihood of a ray in it."""

    ray_sigma: float = 0.07
    """[m] Scatter of a return around its surface, including the pose error after a fine match. A ray that ends five times as far
    behind a wall has crossed it."""
    hit: float = 0.7
    """Share of the returns from surfaces of the map."""
    unmapped: float = 0.25
    """Share of the returns from objects that are missing from the map: people, furniture. The others are from behind a wall of
    the map: moved walls, glass, opened doors."""
    ray_length: float = 10.0
    """[m] Length over which returns without a surface are distributed uniformly."""


KNOWN_MAP = KnownMapSettings()


@dataclass(frozen=True, kw_only=True)
class GlobalSearchSettings:
    """Global search for a robot, without a prior pose."""

    accept_fit: float = 0.6
    """`GlobalPlaces.fit` of the first place at which the search stops; also the minimum fit of a place without rivals."""
    hidden_weight: float = 2.0
    """Weight of a point that a wall of the map should have hidden, relative to a point on a surface."""
    min_seen: float = 0.5
    """Minimum share of the points in observed space; a smaller share lowers the fit of a place."""
    min_seen_anywhere: float = 0.8
    """The same in a search of the whole map, where a place at its edge can fit by chance."""
    rival_probability: float = 0.02
    """Probability below which a place is ruled out, if it also fits worse than the best by `RIVAL_MARGIN`."""


GLOBAL_SEARCH = GlobalSearchSettings()


@dataclass(frozen=True, kw_only=True)
class MapTrackingSettings:
    """Tracking a robot in a known place."""

    prior_floor: tuple[float, float, float] = (0.01, 0.01, 0.005)
    """[m, m, rad] Standard deviations of the motion from scan to scan, of any length."""
    prior_per_motion: float = 0.03
    """[m/m, rad/m] Additional standard deviation per distance driven; also per turn, [m/rad, rad/rad]."""
    max_offset: float = 0.3
    """[m] Maximum distance between a match and its prediction; a larger one indicates another wall."""
    max_turn_offset: float = 0.17
    """[rad] Maximum heading difference between a match and its prediction."""
    agreement: float = 0.3
    """Minimum share of inliers among all points."""
    patience_distance: float = 2.0
    """[m] Distance driven without an accepted match after which the robot is lost. A scan farther from one that fits the map is
    lost, too."""
    near_fit: float = 0.4
    """Minimum fit of a place that agrees with the odometry since the robot was lost, or that leads all others; and of a scan
    with a confirmed pose. When the robot is lost, all poses after the last such scan are discarded."""
    expected_fit: float = 0.3
    """Minimum fit of a place at the odometry pose, if no place of the map fits better. Such a coincidence is unlikely."""
    far_fit: float = 0.75
    """Minimum fit of a place that contradicts the odometry."""
    drift_floor: float = 0.5
    """[m] Drift of the odometry since the robot was lost, at any distance."""
    drift_per_metre: float = 0.05
    """[m/m] Additional drift per distance driven."""
    turn_drift_floor: float = 0.1
    """[rad] Heading drift since the robot was lost, at any distance."""
    turn_drift_per_metre: float = 0.02
    """[rad/m] Additional heading drift per distance driven."""
    min_fit: float = 0.2
    """Averaged fit below which the robot is lost."""
    usual_distance: float = 5.0
    """[m] Distance over which the usual fit is averaged, which falls slowly where a map ends. Within it, a robot that was found
    must keep an averaged fit above `near_fit`, and scans around a search with several answers must fit one of these by
    `GlobalSearchSettings.accept_fit`."""
    loss_share: float = 0.5
    """Share of the usual fit below which the averaged fit indicates that the robot is elsewhere."""
    confirmed_share: float = 0.75
    """Minimum share of the usual fit for a confirmed pose."""
    place_floor: tuple[float, float, float] = (0.0007, 0.0007, 0.0002)
    """[m, m, rad] Minimum standard deviations of a pose in a map."""
    map_share: float = 0.8
    """Ratio of a pose's standard deviation to the excess scatter of the returns around the walls of the map.
    The excess is relative to the scatter around the surfaces of the preceding scans. The larger of local and
    usual scatter counts, and the result is divided by the share of the returns on walls."""
    map_share_of_noise: float = 0.2
    """Ratio of a pose's standard deviation to the scatter of returns around the preceding scans: walls made
    of a few returns each are displaced as a whole."""
    map_turn: float = 0.3
    """[rad/m] Standard deviation of the heading per standard deviation of the position."""


MAP_TRACKING = MapTrackingSettings()
