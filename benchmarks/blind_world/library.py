"""The 35 effects of the library: their channels, materiality, pairs, and sizes that need nothing of the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.blind_world.hidden import either_sign, material_size, rounded
from benchmarks.blind_world.robots import Robot

SCAN = [
    "range_bias",
    "range_scale",
    "range_noise",
    "sector_bias",
    "mount_yaw",
    "mount_xy",
    "latency",
    "scan_skew",
    "mixed_pixels",
    "glass",
    "mirror",
    "black_surface",
    "incidence_dropout",
    "max_range",
    "min_range",
    "quantisation",
    "unmapped_obstacle",
    "moved_obstacle",
    "missing_obstacle",
    "moved_wall",
    "map_scale",
    "people",
    "range_drift",
    "sonar_cone",
    "self_occlusion",
    "tilt",
    "random_outliers",
]
ODOMETRY = ["wheel_radius", "wheel_radius_diff", "wheel_base", "wheel_slip", "pose_clock_offset"]
DRIVE = ["actuator_lag", "dead_time", "speed_saturation"]
LIBRARY = (*SCAN, *ODOMETRY, *DRIVE)
PAIRS = (
    ("range_scale", "wheel_slip"),
    ("mount_xy", "random_outliers"),
    ("mount_yaw", "actuator_lag"),
    ("glass", "wheel_radius"),
    ("mirror", "range_noise"),
    ("black_surface", "moved_wall"),
    ("moved_obstacle", "range_bias"),
    ("missing_obstacle", "latency"),
    ("people", "wheel_base"),
    ("unmapped_obstacle", "dead_time"),
    ("incidence_dropout", "range_bias"),
    ("max_range", "mount_yaw"),
    ("tilt", "wheel_radius_diff"),
    ("mixed_pixels", "pose_clock_offset"),
    ("self_occlusion", "map_scale"),
    ("sector_bias", "speed_saturation"),
    ("scan_skew", "missing_obstacle"),
    ("range_drift", "moved_obstacle"),
    ("quantisation", "wheel_base"),
    ("wheel_radius", "dead_time"),
)
"""Pairs that do not hide each other."""
MATERIALITY: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "range_bias": (0.005, ("b",)),
    "range_scale": (0.002, ("s",)),
    "range_noise": (0.0025, ("k",)),
    "sector_bias": (0.006, ("b",)),
    "mount_yaw": (0.00175, ("delta",)),
    "mount_xy": (0.005, ("dx", "dy")),
    "latency": (0.005, ("tau",)),
    "scan_skew": (0.01, ("T",)),
    "mixed_pixels": (0.00209, ("gamma",)),
    "unmapped_obstacle": (0.02, ("r",)),
    "moved_obstacle": (0.01, ("dx", "dy")),
    "moved_wall": (0.01, ("d",)),
    "map_scale": (0.002, ("s",)),
    "people": (0.002, ("p",)),
    "range_drift": (0.006, ("b1",)),
    "random_outliers": (0.002, ("p",)),
    "wheel_radius": (0.005, ("s",)),
    "wheel_radius_diff": (0.003, ("s",)),
    "wheel_base": (0.006, ("s",)),
    "wheel_slip": (0.05, ("s",)),
    "pose_clock_offset": (0.005, ("tau",)),
    "actuator_lag": (0.015, ("tau",)),
    "dead_time": (0.02, ("L",)),
}
"""Of effects.md: the bound, in the unit of the parameters whose length is compared with it. The others have none."""
DETERMINISTIC = frozenset(
    [
        "range_bias",
        "range_scale",
        "sector_bias",
        "mount_yaw",
        "mount_xy",
        "latency",
        "scan_skew",
        "unmapped_obstacle",
        "moved_obstacle",
        "missing_obstacle",
        "moved_wall",
        "map_scale",
        "range_drift",
        "self_occlusion",
        "tilt",
    ]
)
"""Whose gap in metres means something: no chance, no lost returns, no mixtures."""


def materiality_ratio(name: str, values: Mapping[str, float]) -> float | None:
    """Return the size over the materiality, None for effects without a size."""
    if name not in MATERIALITY:
        return None
    bound, parameters = MATERIALITY[name]
    return math.hypot(*(values[parameter] for parameter in parameters)) / bound


Draw = Callable[[np.random.Generator, Robot], dict[str, float]]


def _signed(key: str, materiality: float) -> Draw:
    return lambda rng, robot: {key: rounded(either_sign(rng) * material_size(rng, materiality))}


def _positive(key: str, materiality: float) -> Draw:
    return lambda rng, robot: {key: rounded(material_size(rng, materiality))}


def _sector(
    rng: np.random.Generator, robot: Robot, narrow: float, wide: float, share: float
) -> dict[str, float]:
    """Draw a sector [rad] within this share of the field of view."""
    width, half = rng.uniform(narrow, wide), robot.fov / 2
    first = rng.uniform(-half * share, half * share - width)
    return {"theta1": rounded(first), "theta2": rounded(first + width)}


def _sector_bias(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    sector = _sector(rng, robot, 0.5, 1.3, 0.95)
    return sector | {"b": rounded(either_sign(rng) * material_size(rng, 0.006))}


def _mount_xy(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    angle = rng.uniform(0, 2 * np.pi)
    size = material_size(rng, 0.005)
    return {"dx": rounded(size * np.cos(angle)), "dy": rounded(size * np.sin(angle))}


def _range_drift(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    b1 = rounded(either_sign(rng) * rng.uniform(2, 6) * 0.006)
    return {"b1": b1, "tau": 0.0 if rng.random() < 0.5 else rounded(rng.uniform(8, 25), 2)}


def _self_occlusion(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    sector = _sector(rng, robot, 0.1, 0.35, 0.9)
    nearest = robot.range_min * 1.2 + 4 * robot.sigma
    return sector | {"r0": rounded(max(nearest, rng.uniform(0.12, 0.28)), 4)}


def _tilt(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    beta, most = rounded(robot.height / rng.uniform(1.7, 2.8)), 0.7 * (robot.fov / 2)
    return {"beta": beta, "theta0": rounded(rng.uniform(-most, most))}


DRAWS: Mapping[str, Draw] = {
    "range_bias": _signed("b", 0.005),
    "range_scale": _signed("s", 0.002),
    "range_noise": lambda rng, robot: {"k": rounded(rng.uniform(2.2, 6) * 0.0025)},
    "sector_bias": _sector_bias,
    "mount_yaw": _signed("delta", 0.00175),
    "mount_xy": _mount_xy,
    "latency": _positive("tau", 0.005),
    "scan_skew": _positive("T", 0.01),
    "mixed_pixels": lambda rng, robot: {"gamma": rounded(rng.uniform(2, 6) * 0.00209)},
    "incidence_dropout": lambda rng, robot: {"alpha_max": rounded(rng.uniform(1.05, 1.3))},
    "quantisation": lambda rng, robot: {"q": rounded(robot.sigma * rng.uniform(4, 7), 3)},
    "random_outliers": _positive("p", 0.002),
    "range_drift": _range_drift,
    "sonar_cone": lambda rng, robot: {
        "gamma": rounded(rng.uniform(0.04, 0.12)),
        "alpha_max": rounded(rng.uniform(0.55, 1.05)),
    },
    "self_occlusion": _self_occlusion,
    "tilt": _tilt,
    "wheel_radius": _signed("s", 0.005),
    "wheel_radius_diff": _signed("s", 0.003),
    "wheel_base": _signed("s", 0.006),
    "pose_clock_offset": _positive("tau", 0.005),
    "actuator_lag": _positive("tau", 0.015),
    "dead_time": _positive("L", 0.02),
    "speed_saturation": lambda rng, robot: {"v_max": rounded(robot.limits[0] * rng.uniform(0.45, 0.68), 4)},
}
"""Sizes of the effects that need nothing of the run; `changes` and `placing` draw the others."""
