"""Tuning parameters of ray times and clocks in localization, with unit and meaning."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import chdtri

from sensorgraph.localization.settings import WHEELS

CLASSES = 4
"""Number of ray classes, by ray number modulo this: the maximum number of interlaced sweeps."""


@dataclass(frozen=True, kw_only=True)
class RayTimeSettings:
    """Ray times of a scan, identified from the run."""

    pieces: int = 40
    """Maximum number of track pieces used; the fastest-turning ones are chosen."""
    min_pieces: int = 8
    """Minimum number of pieces; fewer give no standard errors."""
    frames: int = 12
    """Maximum number of key frames of a piece: about two turns of the robot, or 4 m."""
    min_frames: int = 5
    """Minimum number of key frames of a piece; fewer do not determine its surfaces."""
    max_rate: float = 1.0
    """[rad/s] Upper limit of the turn rate that ranks a piece, because wheels slip in fast turns."""
    min_rate: float = 0.1
    """[rad/s] Minimum turn rate; at this rate 10 ms correspond to 0.06°."""
    piece_offset: float = 1000.0
    """[m] Offset between the maps of two pieces."""
    steps: int = 10
    """Maximum number of Gauss-Newton steps. Points are deskewed again before each, because smeared surfaces
    hide a fifth of the effect; from the opposite direction most of it."""
    settled: float = 1.0
    """Squared step, in standard errors, below which the iteration ends."""
    velocity_interval: float = 0.01
    """[s] Interval over which the velocity at a scan is computed."""
    delay_sd: float = 0.2
    """[s] Prior standard deviation of a delay."""
    motion_error: float = 0.1
    """Relative error of the odometry velocity within a scan, and thus of the times."""
    min_gain: float = 25.0
    """Minimum advantage of a laser over no sweep and over any other laser, as twice the log likelihood: five
    standard errors."""
    agrees: float = float(chdtri(CLASSES, 0.05))
    """Squared Mahalanobis distance up to which the times of the log are kept after the first step: 95 % of
    chi-squared with the time of each class."""
    max_distance: float = float(chdtri(CLASSES, 0.001))
    """Maximum squared Mahalanobis distance between estimate and laser: 99.9 % of chi-squared."""


RAY_TIMES = RayTimeSettings()


@dataclass(frozen=True, kw_only=True)
class ScanLagSettings:
    """Lag of the scans relative to the odometry."""

    rate_interval: float = 0.05
    """[s] Interval over which the turn rate of the odometry is computed."""
    max_steps: float = 3.0
    """Maximum step between two scans, in median steps."""
    min_scans: int = 50
    """Minimum number of steps."""
    min_change: float = 0.01
    """[rad/s] Minimum root mean square change of the turn rate between two scans."""
    min_slope: float = 0.3
    """Minimum ratio of the turns of laser and odometry."""
    segments: int = WHEELS.stretches
    """Number of segments of the log for the standard error."""
    rounds: int = 8
    """Number of rounds of robust weighting."""
    min_lag: float = 0.01
    """[s] Minimum lag that is reported."""
    relative_error: float = 0.2
    """Relative error of a lag that still agrees with the duration of a scan."""
    latency: float = 0.05
    """[s] Latency of odometry, at most: the period of slow wheel controllers."""


SCAN_LAG = ScanLagSettings()
