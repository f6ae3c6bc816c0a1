"""Every tuned number of the localisation, with unit and meaning; the defaults are those of `benchmarks/locate.py`."""

from __future__ import annotations

from dataclasses import dataclass, replace

UNSURE = 0.3
"""Length of the vector that stands for a normal where only the side is known from which a point was seen."""


@dataclass(frozen=True, kw_only=True)
class PointSettings:
    """Which returns become points."""

    max_range: float = 30.0
    """[m] farther returns are left out: a wrong heading moves them too far, and they are sparse."""
    spacing: float = 0.015
    """[m] from a point to the next of its scan, below which the latter is left out."""
    reach: float = 0.12
    """[m] along the scan from a point to the neighbours that give its normal."""
    gap: float = 0.25
    """[m] between neighbouring returns that lie on two surfaces."""


SCANS = PointSettings()


@dataclass(frozen=True, kw_only=True)
class LineSettings:
    """Points of a line map."""

    voxel: float = 0.05
    """[m] side of the cells in which points of one direction are put together: bounds the work of a match."""


LINES = LineSettings()


@dataclass(frozen=True, kw_only=True)
class LineMatchSettings:
    """Robust match of points against lines."""

    first_radius: float = 0.35
    """[m] around a point within which the line is fitted, at first; also the side of a bucket of the map."""
    last_radius: float = 0.20
    """[m] the same in the last iterations."""
    sigma: float = 0.03
    """[m] standard deviation of a return around a perfect line: noise, and that surfaces are no lines."""
    iterations: int = 12
    """Gauss-Newton steps at most."""
    tolerance: float = 1e-4
    """[m, rad] a smaller step is the last one."""
    roundness: float = 0.15
    """Ratio of the variances across and along a line, above which it is a spot, which also holds along."""
    min_points: float = 2.0
    """Weight of neighbours below which there is no line."""
    same_side: float = 0.3
    """Cosine between the normals of two points below which these lie on different surfaces."""
    min_noise: float = 0.003
    """[m] the residuals are never believed to be smaller: the information of a match stays finite."""
    inlier: float = 2.0
    """Standard deviations within which a point is an inlier."""
    dense: float = 0.09
    """[m] from a point of a scan to the next, above which the radii grow in proportion."""
    max_growth: float = 4.0
    """Of the radii at most."""

    def for_spacing(self, spacing: float) -> LineMatchSettings:
        """Return the settings for scans whose points are `spacing` [m] apart: wider for lasers of few rays."""
        growth = min(max(spacing / self.dense, 1.0), self.max_growth)
        return replace(self, first_radius=growth * self.first_radius, last_radius=growth * self.last_radius)


MATCH = LineMatchSettings()


@dataclass(frozen=True, kw_only=True)
class WheelSettings:
    """What is believed of the wheels before and after the laser has measured them."""

    way_scale_sd: float = 0.1
    """Standard deviation of the scale of ways before any scan."""
    turn_scale_sd: float = 0.1
    """Standard deviation of the scale of turns before any scan."""
    heading_bias_sd: float = 0.05
    """[rad/m] standard deviation of the heading bias before any scan."""
    place_floor: float = 0.01
    """[m] standard deviation of a step of any length."""
    ahead_per_metre: float = 0.08
    """[m/m] along the way, per way driven."""
    left_per_metre: float = 0.05
    """[m/m] across the way, per way driven."""
    place_per_turn: float = 0.03
    """[m/rad] per turn."""
    turn_floor: float = 0.004
    """[rad] standard deviation of the turn of a step of any length."""
    turn_per_metre: float = 0.03
    """[rad/m] per way driven."""
    turn_per_turn: float = 0.1
    """[rad/rad] per turn."""
    max_speed: float = 5.0
    """[m/s] a step that is faster is a jump of the odometry."""
    max_turn_rate: float = 10.0
    """[rad/s] the same of turns."""
    least_scatter: float = 0.05
    """Share of the standard deviations above that the wheels may show in the end: they are good."""
    most_scatter: float = 3.0
    """The same of bad ones."""
    slip: float = 3.0
    """Standard deviations at which the weight of a step is halved."""
    unknown_sd: float = 1.0
    """[m, rad] standard deviation of a step without odometry."""
    outlier: float = 4.0
    """Standard deviations beyond which a step says nothing about the wheels: slip."""
    stretches: int = 12
    """Parts of a log whose slip is independent: standard errors are by how far these differ."""


WHEELS = WheelSettings()


@dataclass(frozen=True, kw_only=True)
class FrontEndSettings:
    """Tracking against the last key frames."""

    way: float = 0.3
    """[m] from one key frame to the next."""
    turn: float = 0.21
    """[rad] from one key frame to the next."""
    window: int = 40
    """Key frames that make the map to match against."""
    still_way: float = 0.02
    """[m] below which a scan is not matched, but placed by the odometry."""
    still_turn: float = 0.01
    """[rad] the same of turns."""
    still_time: float = 0.5
    """[s] after which a scan is matched in any case."""
    enough: float = 0.6
    """Share of the points near a surface that must lie on it; below, other starts are tried."""
    going_on: float = 0.8
    """Share of the last match's agreement that a scan has where the odometry has it; below, it is not known that the robot
    only went on: it may have been carried. Of 360 robots that were carried, all were below 0.75 but those set down at nearly the
    same pose; of 11,383 scans of three logs, 8 were (swapped halves of `benchmarks/localize_in_map.py`)."""
    most_slip: float = 20.0
    """Standard deviations of the odometry that a match is from where it has the scan; beyond, the same holds. One of these
    scans was, by 22."""
    least_overlap: float = 0.3
    """Share of the points that must have a surface near them."""
    usual_elsewhere: float = 0.85
    """Share of the usual agreement that a match from another start needs: in a room much fits somewhere."""
    usual_after_failure: float = 0.5
    """The same of a match near the prediction, after scans that fitted nowhere."""
    usual_rate: float = 0.05
    """Weight of a new match in the usual agreement."""
    start_turns: tuple[float, ...] = (0.0, -0.1, 0.1, -0.21, 0.21)
    """[rad] of the other starts."""
    start_ways: tuple[float, ...] = (0.0, -0.25, 0.25)
    """[m] of the other starts, along and across."""
    patience: float = 2.0
    """[s] from the first scan without a match, or `patience_way` driven, after which a new piece of track begins."""
    patience_way: float = 1.0
    """[m]"""
    patience_scans: int = 5
    """Scans without a match before a new piece of track begins, however long that is."""
    speed_sd: float = 0.6
    """[m/s] standard deviation of the change of speed between scans, where there is no odometry."""
    turn_rate_sd: float = 0.8
    """[rad/s] the same of the turn rate."""
    correlation: float = 2.0
    """Times a match against the last key frames knows less than its residuals say: these are not independent."""
    floor_place: float = 0.004
    """[m] least standard deviation of an edge between key frames."""
    floor_turn: float = 0.0007
    """[rad] the same of its turn."""
    broken_place: float = 1.0
    """[m] standard deviation of the edge between two pieces of track."""
    broken_turn: float = 0.5
    """[rad] the same of its turn."""


FRONT_END = FrontEndSettings()


@dataclass(frozen=True, kw_only=True)
class GraphSettings:
    """The pose graph."""

    cauchy: float = 1.0
    """Standard deviations at which a closure's weight is halved."""
    tolerance: float = 1e-4
    """Relative decrease of the error at which a solution is good enough."""
    inlier_probability: float = 0.999
    """A closure is true within this share of chi²."""


GRAPH = GraphSettings()


@dataclass(frozen=True, kw_only=True)
class ClosureSettings:
    """Search and test of loop closures."""

    submap: int = 16
    """Key frames of a submap."""
    step: int = 8
    """Key frames from one submap to the next."""
    seen: int = 6
    """Key frames in the middle of a submap that are sought in an older one."""
    apart: int = 24
    """Key frames between two submaps, below which they are neighbours on the way."""
    reach: float = 4.0
    """[m] between the middles of two submaps that can see the same."""
    window: float = 0.4
    """[m] half width of the search at least."""
    window_per_metre: float = 0.015
    """[m/m] more of it per way since the last closure."""
    max_window: float = 12.0
    """[m] at most."""
    turn_window: float = 0.05
    """[rad] half width of the headings that are tried, at least."""
    turn_window_per_metre: float = 0.003
    """[rad/m] more of it per way since the last closure."""
    max_turn_window: float = 0.8
    """[rad] at most."""
    broken_window: float = 6.0
    """[m] half width of the search around each older submap after the track broke, until the next closure."""
    broken_candidates: int = 40
    """Older submaps that are tried then."""
    broken_score: float = 0.75
    """Of the likelihood field, below which nothing fits then: there is no guess that speaks for it."""
    candidates: int = 3
    """Older visits of a place that are tried for each submap."""
    score: float = 0.55
    """Of the likelihood field, below which nothing fits."""
    rivalry: float = 0.92
    """Share of the best score from which another place is as good."""
    rival_apart: float = 0.5
    """[m] from the best place to another."""
    rival_turn: float = 0.17
    """[rad] the same of headings."""
    visits_apart: float = 2.0
    """[m] the same of places that two older visits show: these may be adrift of each other."""
    drift_per_metre: float = 0.0075
    """[m/m] that the track may be off per way since the last closure: two places within it are rivals."""
    inliers: float = 0.6
    """Share of the points near surfaces that lie on them."""
    overlap: float = 0.4
    """Share of the points that have surfaces near."""
    correlation: float = 20.0
    """Times a match of submaps knows less than its residuals say."""
    weak: float = 0.03
    """[m] standard deviation above which a direction says nothing: a corridor."""
    no_information: float = 10.0
    """[m] standard deviation along a corridor."""
    weak_turn: float = 0.05
    """[rad] standard deviation of a closure's heading above which it is none: it would tie nothing."""
    see_through: float = 0.2
    """Share of an older place's points in view that may lie where rays went through; 0.22 at most at true closures of
    aces and 0.07 of fr079, 0.58 in the middle where these are moved by 0.5 m."""
    margin: float = 0.15
    """[m] before the end of a ray that count as free."""
    floor_place: float = 0.004
    """[m] least standard deviation."""
    floor_turn: float = 0.0007
    """[rad] the same of the heading."""
    kept_pyramids: int = 128
    """Submaps whose likelihood fields are kept, those used last; each takes 2 to 5 MB, and a day has thousands."""
    solve_every: int = 4
    """Submaps after which closures are taken into the graph while the map is made."""
    second_window: float = 0.4
    """[m] of the second pass, when the first has closed the loops."""
    second_turn: float = 0.035
    """[rad] of the second pass."""


CLOSURES = ClosureSettings()


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """Poses and surfaces together."""

    iterations: int = 8
    """Gauss-Newton steps; surfaces are cut anew before each."""
    first_side: float = 0.30
    """[m] between the middles of neighbouring surface patches, at first."""
    last_side: float = 0.20
    """[m] the same in the last iterations."""
    first_gate: float = 0.25
    """[m] from a patch's line to the points that belong to it, at first."""
    last_gate: float = 0.10
    """[m] the same in the last iterations."""
    first_sigma: float = 0.10
    """[m] half the distance from a patch at which Cauchy's weight is 1/2, at first: visits that lie apart must pull."""
    last_sigma: float = 0.02
    """[m] the same in the last iterations, unless the patch is rougher."""
    min_sigma: float = 0.002
    """[m] a patch is never believed to be smoother."""
    shrinkage: float = 10.0
    """Points that the noise of all patches counts in the noise of one."""
    roundness: float = 0.25
    """Ratio of the variances across and along a patch, above which it is none."""
    min_points: float = 4.0
    """Points of a patch at least."""
    tolerance: float = 1e-3
    """Relative residual at which conjugate gradients stop."""
    max_steps: int = 300
    """Of conjugate gradients."""
    samples: int = 48
    """Of the bootstrap of the covariances: their standard deviations are right to about 1 / sqrt(2 · samples)."""


REFINEMENT = RefinementSettings()


@dataclass(frozen=True, kw_only=True)
class RayTimeSettings:
    """When each ray of a scan was taken, where the log does not say."""

    pieces: int = 40
    """Pieces of track that are looked at: those in which the robot turned fastest."""
    least_pieces: int = 8
    """Fewer tell no standard errors."""
    frames: int = 12
    """Key frames of a piece: about two turns of the robot, or 4 m."""
    fast: float = 1.0
    """[rad/s] a robot that turns faster counts as one of this rate: wheels slip."""
    least_rate: float = 0.1
    """[rad/s] a robot that turns no faster shows nothing: 10 ms are 0.06° then."""
    apart: float = 1000.0
    """[m] between the maps of two pieces."""
    steps: int = 4
    """Gauss-Newton steps, the points moved anew before each: surfaces that are smeared themselves hide a fifth."""
    short: float = 0.01
    """[s] over which the velocity at a scan is taken."""
    widest: float = 0.2
    """[s] standard deviation of a delay before any scan."""
    motion_error: float = 0.1
    """Share by which velocities by the odometry may be off within a scan, and so the times."""
    least_gain: float = 25.0
    """Twice the log likelihood by which a laser must be better than no sweep, and than any other: five standard errors."""
    most_distance: float = 18.5
    """Squared standard errors between estimate and laser: 99.9 % of chi-squared with four degrees of freedom."""


RAY_TIMES = RayTimeSettings()


@dataclass(frozen=True, kw_only=True)
class FinalSettings:
    """Scans between key frames, placed in the refined map."""

    place_sd: float = 0.03
    """[m] standard deviation of the track between two key frames."""
    turn_sd: float = 0.015
    """[rad] the same of its heading."""
    inliers: float = 0.5
    """Share of the points near surfaces that must lie on them."""
    overlap: float = 0.3
    """Share of the points that must have surfaces near."""
    joining: int = 2
    """Loop closures that agree, before a piece of track after a break is believed to lie where they say."""


FINAL = FinalSettings()


@dataclass(frozen=True, kw_only=True)
class SmoothingSettings:
    """The laser's odometry, with which all poses of a run are smoothed."""

    step_floor: tuple[float, float, float] = (0.003, 0.003, 0.0008)
    """[m, m, rad] standard deviations of the laser's odometry from scan to scan, however short."""
    step_per_metre: float = 0.01
    """[m/m, rad/m] the same per way."""
    step_per_turn: float = 0.02
    """[m/rad, rad/rad] the same per turn."""
    blind_step: float = 10.0
    """Times as much where the front end did not match a scan."""
    broken_step: float = 100.0
    """[m, rad] where the way is not known."""


SMOOTHING = SmoothingSettings()
