"""Every tuned number of localisation in a known place, with unit and meaning; set by `benchmarks/localize_in_map.py`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class KnownMapSettings:
    """A known place, and how likely a ray is in it."""

    spacing: float = 0.04
    """[m] between the points on the walls to which scans are matched."""
    resolution: float = 0.05
    """[m] of the field that judges rays."""
    search_resolution: float = 0.1
    """[m] of the field that is searched without a guess."""
    search_sigma: float = 0.12
    """[m] scatter of returns around the surfaces of that field."""
    ray_sigma: float = 0.07
    """[m] scatter of a return around its surface, with the error of a pose after a fine match."""
    hit: float = 0.7
    """Share of the returns that are of surfaces of the map."""
    unmapped: float = 0.25
    """Share of the returns that are of what the map lacks: people, furniture."""
    through_wall: float = 0.05
    """Share of the returns from behind a wall of the map: moved walls, glass, opened doors."""
    ray_length: float = 10.0
    """[m] over which returns without a surface are spread."""
    before_wall: float = 0.35
    """[m] before its end a ray that meets a wall went through it."""


KNOWN_MAP = KnownMapSettings()


@dataclass(frozen=True, kw_only=True)
class GlobalSearchSettings:
    """Finding a robot without a guess."""

    points: int = 160
    """Of a view, at most."""
    least_points: int = 25
    """Of a view; also of each of its scans, if it has them."""
    heading_step: float = 0.0175
    """[rad] between headings that are tried."""
    min_score: float = 0.25
    """Mean of the field at the points, below which a place is none."""
    rival_ratio: float = 0.6
    """Of the best score of the field, down to which places are judged by the beam model."""
    max_modes: int = 120
    """Places that are judged, at most."""
    max_matches: int = 40
    """The best of them, that are matched and judged again."""
    max_nudged: int = 5
    """The best of these, around which matches start once more: the field knows one place within `apart`, where walls that
    are close to each other hold a match in several."""
    nudge: float = 0.25
    """[m] along x and y, from these to the other starts."""
    enough_fit: float = 0.6
    """`GlobalPlaces.fit` of the first place, from which on no other scans are sought."""
    least_joint_fit: float = 0.25
    """The same by all scans of a place that the last scan alone fits: the map may lack what the others saw, but they do
    not speak against it."""
    apart: float = 0.5
    """[m] places nearer than this, and than `apart_turn`, are one."""
    apart_turn: float = 0.26
    """[rad]"""
    correlation: float = 4.0
    """Times the likelihood of a view says too much, as its rays meet the same surfaces."""
    hidden_weight: float = 2.0
    """Points that walls of the map should have hidden, in points that lie on surfaces: one speaks against a place as
    two speak for it."""
    least_seen: float = 0.5
    """Share of the points of which the map must say something; what is missing counts against a place."""
    least_seen_anywhere: float = 0.8
    """The same where nobody knows where the robot is: some place at the edge of a map fits by chance."""
    rival_probability: float = 0.02
    """A less probable place is ruled out, if it fits worse than the best by `rival_margin`."""
    rival_margin: float = 0.05
    """Standard error of a fit: of a share of .85 of `points` / `correlation`."""


GLOBAL_SEARCH = GlobalSearchSettings()


@dataclass(frozen=True, kw_only=True)
class MapTrackingSettings:
    """Following a robot through a known place."""

    least_points: int = 25
    """Of a scan, below which it is not matched."""
    prior_floor: tuple[float, float, float] = (0.01, 0.01, 0.005)
    """[m, m, rad] standard deviations of the way from scan to scan, however short."""
    prior_per_metre: float = 0.03
    """[m/m, rad/m] the same per way."""
    prior_per_turn: float = 0.03
    """[m/rad, rad/rad] the same per turn."""
    most_off: float = 0.3
    """[m] from where a scan was expected; a match farther off is of another wall."""
    most_turned: float = 0.17
    """[rad] the same of its heading."""
    inliers: float = 0.5
    """Share of the points near a surface that lie on it, in a match that is believed."""
    agreement: float = 0.3
    """Share of all points that lie on surfaces, in a match that is believed."""
    patience: float = 2.0
    """[s] without such a match, or `patience_way`, after which the robot is lost."""
    patience_way: float = 2.0
    """[m]"""
    back_patience: float = 1.0
    """[s] the same on the way back from where it was found."""
    found_fit: float = 0.6
    """`GlobalPlaces.fit` from which on a place without rivals is believed."""
    alone_fit: float = 0.4
    """The same of a place that fits better than any other by `alone_lead`, and in proportion between: an opened door or
    a moved cupboard lets the true place fit badly, but what fits by chance has its like elsewhere."""
    alone_lead: float = 0.5
    """Of places by chance that fit by `alone_fit`, 0.21 at most at 160 places of three logs that the map lacks
    (`localize_in_map --swap`)."""
    near_fit: float = 0.4
    """The same of a place where the robot must be by its odometry since it was lost."""
    expected_fit: float = 0.3
    """The same of a place within `expected_way` and `expected_turn` of where the odometry has it, if no place of the map
    fits better: that the best one lies just there is hardly chance."""
    expected_way: float = 0.1
    """[m]"""
    expected_turn: float = 0.05
    """[rad]"""
    far_fit: float = 0.75
    """The same of a place where it cannot be by its odometry."""
    drift_floor: float = 0.5
    """[m] that the odometry may be off since the robot was lost."""
    drift_per_metre: float = 0.05
    """[m/m] the same per way."""
    turn_drift_floor: float = 0.1
    """[rad] the same of its heading."""
    turn_drift_per_metre: float = 0.02
    """[rad/m] the same per way."""
    fit_memory: float = 1.0
    """[s] over which the fit is averaged while the robot is followed."""
    proof_way: float = 5.0
    """[m] after it was found, within which the averaged fit must stay above `near_fit`."""
    least_fit: float = 0.2
    """Averaged fit below which the robot is lost."""
    usual_way: float = 5.0
    """[m] over which the usual fit is averaged: it falls slowly where a map ends."""
    sudden_share: float = 0.5
    """Of the usual fit, below which the averaged fit says that the robot is elsewhere."""
    sure_fit: float = 0.4
    """Fit that a scan last had where the robot was surely right; what follows is lost with it."""
    sure_share: float = 0.75
    """Of the usual fit, that such a scan has at least."""
    search_way: float = 0.3
    """[m] between searches while it is lost, doubled after each that fails."""
    search_turn: float = 0.35
    """[rad] the same of turns."""
    most_search_way: float = 2.4
    """[m] between searches at most."""
    every_nth_everywhere: int = 3
    """Searches after which one is made in all of the map, though the odometry says where the robot is."""
    view_scans: int = 5
    """Searched together, at most."""
    rival_way: float = 5.0
    """[m] around a search that several places answered, of which all scans must fit one of these by `found_fit`."""
    rival_scans: int = 12
    """Of these, at most."""
    rematch_deviations: tuple[float, float, float] = (0.05, 0.05, 0.02)
    """[m, m, rad] of the smoothed track, as the prior of the last matches."""
    correlation: float = 2.0
    """Times a match with a map knows less than its residuals say: surfaces are shared by neighbouring scans."""
    place_floor: tuple[float, float, float] = (0.0007, 0.0007, 0.0002)
    """[m, m, rad] least standard deviations of a pose in a map."""
    map_share: float = 0.8
    """Standard deviation of a pose in a map, as a share of how much more the returns scatter around its walls than around
    the surfaces of the scans just before, there or usually, whichever is more: so far the walls are off. Divided by the
    share of the returns that lie on walls."""
    map_share_of_noise: float = 0.2
    """The same as a share of how far returns scatter around the scans just before: walls of a few returns each are off
    as a whole."""
    map_turn: float = 0.3
    """[rad/m] the standard deviation of the heading, per that of the place."""
    ok_within: float = 2.0
    """[s] from a scan that fits the map; a scan farther from any is lost."""


MAP_TRACKING = MapTrackingSettings()
