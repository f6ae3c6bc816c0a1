"""The 35 effects of the library: where each shows, and the size from which on it matters (docs: reference/effects.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping

SCAN = (
    "range_bias", "range_scale", "range_noise", "sector_bias", "mount_yaw", "mount_xy", "latency", "scan_skew",
    "mixed_pixels", "glass", "mirror", "black_surface", "incidence_dropout", "max_range", "min_range", "quantisation",
    "unmapped_obstacle", "moved_obstacle", "missing_obstacle", "moved_wall", "map_scale", "people", "range_drift",
    "sonar_cone", "self_occlusion", "tilt", "random_outliers",
)  # fmt: skip
ODOMETRY = ("wheel_radius", "wheel_radius_diff", "wheel_base", "wheel_slip", "pose_clock_offset")
DRIVE = ("actuator_lag", "dead_time", "speed_saturation")
LIBRARY = (*SCAN, *ODOMETRY, *DRIVE)
"""In this order, which the turns of the suites are drawn from."""
CHANNEL = {
    **dict.fromkeys(SCAN, "scan"),
    **dict.fromkeys(ODOMETRY, "odometry"),
    **dict.fromkeys(DRIVE, "drive"),
}
DETERMINISTIC = {
    "range_bias", "range_scale", "sector_bias", "mount_yaw", "mount_xy", "latency", "scan_skew", "unmapped_obstacle",
    "moved_obstacle", "missing_obstacle", "moved_wall", "map_scale", "range_drift", "self_occlusion", "tilt",
}  # fmt: skip
"""Effects of the scan whose gap in metres means something: no chance, no lost returns, no mixtures."""
MATERIALITY: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "range_bias": (0.005, ("b",)), "range_scale": (0.002, ("s",)), "range_noise": (0.0025, ("k",)),
    "sector_bias": (0.006, ("b",)), "mount_yaw": (0.00175, ("delta",)), "mount_xy": (0.005, ("dx", "dy")),
    "latency": (0.005, ("tau",)), "scan_skew": (0.01, ("T",)), "mixed_pixels": (0.00209, ("gamma",)),
    "unmapped_obstacle": (0.02, ("r",)), "moved_obstacle": (0.01, ("dx", "dy")), "moved_wall": (0.01, ("d",)),
    "map_scale": (0.002, ("s",)), "people": (0.002, ("p",)), "range_drift": (0.006, ("b1",)),
    "random_outliers": (0.002, ("p",)), "wheel_radius": (0.005, ("s",)), "wheel_radius_diff": (0.003, ("s",)),
    "wheel_base": (0.006, ("s",)), "wheel_slip": (0.05, ("s",)), "pose_clock_offset": (0.005, ("tau",)),
    "actuator_lag": (0.015, ("tau",)), "dead_time": (0.02, ("L",)),
}  # fmt: skip
"""The bound, in the unit of the parameters whose length is compared with it. The other effects have none."""


def materiality_ratio(name: str, values: Mapping[str, float | None]) -> float | None:
    """Return the size of an effect over its materiality, None for effects without a size."""
    if name not in MATERIALITY:
        return None
    bound, parameters = MATERIALITY[name]
    return math.hypot(*(values[parameter] or 0.0 for parameter in parameters)) / bound
