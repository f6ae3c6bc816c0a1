"""Every tuned number of the localisation, with unit and meaning; the defaults are those of `benchmarks/locate.py`."""

from __future__ import annotations

from dataclasses import dataclass


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
    min_points: float = 2.5
    """Weight of neighbours below which there is no line."""
    same_side: float = 0.3
    """Cosine between the normals of two points below which these lie on different surfaces."""
    min_noise: float = 0.003
    """[m] the residuals are never believed to be smaller: the information of a match stays finite."""
    inlier: float = 2.0
    """Standard deviations within which a point is an inlier."""


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
    outlier: float = 4.0
    """Standard deviations beyond which a step says nothing about the wheels: slip."""


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
    least_overlap: float = 0.3
    """Share of the points that must have a surface near them."""
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
