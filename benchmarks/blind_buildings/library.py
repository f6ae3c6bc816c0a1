"""The 35 effects of the library, as laws of the reference page on effects."""

from __future__ import annotations

import math
from collections.abc import Mapping

from benchmarks.blind_buildings import library_laser as laser
from benchmarks.blind_buildings import library_motion as motion
from benchmarks.blind_buildings import library_places as places
from benchmarks.blind_buildings.effect import Effect

LIBRARY: Mapping[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        laser.RangeBias,
        laser.RangeScale,
        laser.RangeNoise,
        laser.SectorBias,
        laser.MountYaw,
        laser.MountXY,
        laser.Latency,
        laser.ScanSkew,
        laser.MixedPixels,
        places.Glass,
        places.Mirror,
        places.BlackSurface,
        laser.IncidenceDropout,
        laser.MaxRange,
        laser.MinRange,
        laser.Quantisation,
        places.UnmappedObstacle,
        places.MovedObstacle,
        places.MissingObstacle,
        places.MovedWall,
        places.MapScale,
        places.People,
        laser.RangeDrift,
        laser.SonarCone,
        laser.SelfOcclusion,
        laser.Tilt,
        laser.RandomOutliers,
        motion.WheelRadius,
        motion.WheelRadiusDiff,
        motion.WheelBase,
        motion.WheelSlip,
        motion.PoseClockOffset,
        motion.ActuatorLag,
        motion.DeadTime,
        motion.SpeedSaturation,
    )
}
"""In this order, which the turns of the suite are drawn from."""

MATERIALITY: Mapping[str, tuple[str, float]] = {
    "range_bias": ("b", 0.005),
    "range_scale": ("s", 0.002),
    "range_noise": ("k", 0.0025),
    "sector_bias": ("b", 0.006),
    "mount_yaw": ("delta", 0.00175),
    "mount_xy": ("dx", 0.005),
    "latency": ("tau", 0.005),
    "scan_skew": ("T", 0.01),
    "mixed_pixels": ("gamma", 0.00209),
    "unmapped_obstacle": ("r", 0.02),
    "moved_obstacle": ("dx", 0.01),
    "moved_wall": ("d", 0.01),
    "map_scale": ("s", 0.002),
    "people": ("p", 0.002),
    "range_drift": ("b1", 0.006),
    "random_outliers": ("p", 0.002),
    "wheel_radius": ("s", 0.005),
    "wheel_radius_diff": ("s", 0.003),
    "wheel_base": ("s", 0.006),
    "wheel_slip": ("s", 0.05),
    "pose_clock_offset": ("tau", 0.005),
    "actuator_lag": ("tau", 0.015),
    "dead_time": ("L", 0.02),
}
"""From which size of a parameter on an effect matters; dx stands for the length of (dx, dy)."""


def materiality_ratio(effect: Effect) -> float | None:
    """Return how many times the size that matters an effect has; None where the page has no such size."""
    if effect.name not in MATERIALITY:
        return None
    key, least = MATERIALITY[effect.name]
    told = effect.parameters
    value = math.hypot(told["dx"], told["dy"]) if key == "dx" else abs(told[key] or 0)
    return round(value / least, 4)
