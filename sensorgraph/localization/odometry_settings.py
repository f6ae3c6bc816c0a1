"""Settings of the check of the odometry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class OdometryCheckSettings:
    """Thresholds of the check."""

    n_scans: int = 120
    """Number of scans of the segment that is tracked by the scans alone."""
    min_turn: float = 0.7
    """[rad] Minimum turn by the scans for a comparison of turns."""
    min_distance: float = 1.0
    """[m] Minimum distance by the scans for a comparison of distances."""
    every: int = 4
    """Number of scans of a step, so that the noise of a match is small against its motion."""
    min_matched: float = 0.9
    """Minimum share of matched scans."""
    tolerance: float = 0.35
    """Maximum deviation from the factor of a unit, in the logarithm."""
    opposite: float = -0.6
    """Correlation of the turns below which one of the two is mirrored."""
    moving: float = 0.05
    """[m, rad] Minimum motion of a step by the scans for a step-by-step comparison."""
    max_ratio: float = 3.0
    """Maximum ratio of such a step between odometry and scans, and its inverse."""
    min_agreeing: float = 0.5
    """Minimum share of such steps within this ratio; below, the odometry is not used."""
    min_moving: int = 5
    """Minimum number of such steps for a step-by-step comparison."""
    max_direction: float = 0.5
    """[rad] Maximum angle between the motion by the scans and by the odometry, for a stated mount."""
    noted_direction: float = 0.035
    """[rad] A smaller angle between these motions is not worth a note."""
    max_unexplained: float = 0.6
    """Maximum error of a step, relative to its length, for a comparison of directions."""
    min_error: float = 0.02
    """Error of a step, relative to its length, below which it counts fully."""
    lever: float = 0.3
    """[m] Standard deviation of the distance of a laser of unknown mount from the robot's centre."""
    right_angle: float = 0.1
    """[rad] A mount with an unknown yaw within this of a multiple of 90° has exactly that yaw."""


CHECK = OdometryCheckSettings()
