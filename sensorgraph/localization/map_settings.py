"""Tuning parameters of localization in a known place, set by `benchmarks/localize_in_map.py`."""

from __future__ import annotations

from dataclasses import dataclass

from sensorgraph.localization.settings import FINAL, FRONT_END


@dataclass(frozen=True, kw_only=True)
class KnownMapSettings:
    """A known map, and the likelihood of a ray in it."""

    spacing: float = 0.04
    """[m] Spacing of the points on the walls to which scans are matched."""
    resolution: float = 0.05
    """[m] Cell size of the field in which rays are evaluated; the cells of the global search are twice as large."""
    search_sigma: float = 0.12
    """[m] Scatter of returns around the surfaces of that field."""
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

    points: int = 160
    """Maximum number of points of a view; a quick search finds places with half of them, and evaluates these with all."""
    min_points: int = 25
    """Minimum number of points of a view, and lower limit of the number taken from each of its scans."""
    heading_step: float = 0.0175
    """[rad] Step between headings."""
    min_score: float = 0.25
    """Minimum mean of the field at the points."""
    rival_ratio: float = 0.6
    """Share of the best field score down to which places are evaluated with the beam model."""
    max_modes: int = 120
    """Maximum number of places that are evaluated."""
    max_matches: int = 40
    """Number of the best places that are matched and evaluated again."""
    max_restarts: int = 5
    """Number of the best matches around which matches start again. The field has one place within `apart`,
    but close walls can hold a match at several poses."""
    restart_offset: float = FRONT_END.start_offsets[-1]
    """[m] Offset of these starts along x and y."""
    accept_fit: float = 0.6
    """`GlobalPlaces.fit` of the first place at which the search stops."""
    min_joint_fit: float = 0.25
    """Minimum fit of all scans at a place that the last scan alone fits: the map may lack what the other
    scans observed, but they must not contradict the place."""
    apart: float = 0.5
    """[m] Distance below which two places are the same, if their headings differ by less than `apart_turn`."""
    apart_turn: float = 0.26
    """[rad] Heading difference below which two places are the same."""
    quick_modes: int = 12
    """Maximum number of places that a quick search evaluates and matches."""
    quick_ratio: float = 0.85
    """`rival_ratio` of a quick search."""
    quick_restarts: int = 2
    """`max_restarts` of a quick search."""
    correlation: float = 4.0
    """Factor by which the log likelihood of a view is divided, since its rays meet the same surfaces."""
    hidden_weight: float = 2.0
    """Weight of a point that a wall of the map should have hidden, relative to a point on a surface."""
    min_seen: float = 0.5
    """Minimum share of the points in observed space; a smaller share lowers the fit of a place."""
    min_seen_anywhere: float = 0.8
    """The same in a search of the whole map, where a place at its edge can fit by chance."""
    rival_probability: float = 0.02
    """Probability below which a place is ruled out, if it also fits worse than the best by `rival_margin`."""
    rival_margin: float = 0.05
    """Standard error of a fit: for a share of 0.85 of `points` / `correlation` points."""


GLOBAL_SEARCH = GlobalSearchSettings()


@dataclass(frozen=True, kw_only=True)
class MapTrackingSettings:
    """Tracking a robot in a known place."""

    min_points: int = GLOBAL_SEARCH.min_points
    """Minimum number of points of a scan to be matched."""
    prior_floor: tuple[float, float, float] = (0.01, 0.01, 0.005)
    """[m, m, rad] Standard deviations of the motion from scan to scan, of any length."""
    prior_per_motion: float = 0.03
    """[m/m, rad/m] Additional standard deviation per distance driven; also per turn, [m/rad, rad/rad]."""
    max_offset: float = 0.3
    """[m] Maximum distance between a match and its prediction; a larger one indicates another wall."""
    max_turn_offset: float = 0.17
    """[rad] Maximum heading difference between a match and its prediction."""
    inliers: float = FINAL.inliers
    """Minimum share of inliers among the points near a surface."""
    agreement: float = 0.3
    """Minimum share of inliers among all points."""
    patience: float = FRONT_END.patience
    """[s] Time without an accepted match after which the robot is lost; so it is after `patience_distance`. A scan farther from
    one that fits the map is lost, too."""
    patience_distance: float = 2.0
    """[m] Distance driven without an accepted match after which the robot is lost."""
    backward_patience: float = 1.0
    """[s] The same time when tracking backwards from where the robot was found."""
    found_fit: float = GLOBAL_SEARCH.accept_fit
    """Minimum `GlobalPlaces.fit` of a place without rivals."""
    unrivalled_lead: float = 0.5
    """Lead over all other places at which a fit of `near_fit` is enough; between, the limit is interpolated. An opened door or
    a moved cupboard lowers the fit of the true place, but a place that fits by chance has rivals with a similar fit: with
    `near_fit` they lead by at most 0.21, at 160 places of three logs outside the map (`localize_in_map --swap`)."""
    mirror_looks: int = 2
    """Number of short drives that are searched as seen in a mirror."""
    mirror_lead: float = 0.2
    """Minimum lead of a mirrored fit."""
    near_fit: float = 0.4
    """Minimum fit of a place that agrees with the odometry since the robot was lost, or that leads all others; and of a scan
    with a confirmed pose. When the robot is lost, all poses after the last such scan are discarded."""
    expected_fit: float = 0.3
    """Minimum fit of a place within `expected_distance` and `expected_turn` of the odometry pose, if no place of
    the map fits better. Such a coincidence is unlikely."""
    expected_distance: float = 0.1
    """[m] Maximum distance from the odometry pose."""
    expected_turn: float = 0.05
    """[rad] Maximum heading difference from the odometry pose."""
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
    fit_memory: float = 1.0
    """[s] Time constant of the averaged fit."""
    min_fit: float = 0.2
    """Averaged fit below which the robot is lost."""
    usual_distance: float = 5.0
    """[m] Distance over which the usual fit is averaged, which falls slowly where a map ends. Within it, a robot that was found
    must keep an averaged fit above `near_fit`, and scans around a search with several answers must fit one of these by
    `found_fit`."""
    loss_share: float = 0.5
    """Share of the usual fit below which the averaged fit indicates that the robot is elsewhere."""
    confirmed_share: float = 0.75
    """Minimum share of the usual fit for a confirmed pose."""
    search_distance: float = 0.3
    """[m] Distance between searches while the robot is lost; it doubles after each failed search, up to eight times as much or
    `search_growth` times the distance driven while lost."""
    search_turn: float = 0.35
    """[rad] Turn between searches; it doubles likewise."""
    search_growth: float = 0.1
    """[m/m] Ratio of the distance between searches to the distance driven while lost, where a long drive fits nowhere."""
    looks: int = 5
    """Number of short drives that are searched before all scans are tracked. If none fits by `near_fit`, the map is
    of another place. A fit below `found_fit` counts only as far as the scans before or after continue there: short
    drives fit parts of another floor by up to 0.56, and the scans beside these by at most 0.23."""
    look_scans: int = 120
    """Number of scans of such a drive."""
    every_nth_everywhere: int = 3
    """Every n-th search covers the whole map, even if the odometry limits where the robot can be."""
    view_scans: int = 5
    """Maximum number of scans that are searched together."""
    rival_scans: int = 12
    """Maximum number of the scans around such a search."""
    rematch_deviations: tuple[float, float, float] = (0.05, 0.05, 0.02)
    """[m, m, rad] Standard deviations of the smoothed track, as prior of the last matches."""
    correlation: float = FRONT_END.correlation
    """Factor by which the information of a match is reduced, since neighbouring scans share surfaces."""
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
