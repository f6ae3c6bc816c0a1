"""What may be hidden in the blind world: a hidden effect, the kinds outside the library, and how large each is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.blind.robots import Robot


@dataclass(kw_only=True, eq=False)
class Hidden:
    """One effect; filled step by step while a case is drawn."""

    name: str
    values: dict[str, float] = field(default_factory=dict)
    """Parameters as told, SI units."""
    wall: int = -1
    """Index in Room.walls of the wall it sits on."""
    place: str | None = None
    """Name of the wall or obstacle it sits on."""
    xy: tuple[float, float] | None = None
    """[m] where it is."""
    shapes: dict[str, Floats] = field(default_factory=dict)
    """What the physics needs besides, not told."""

    def __getitem__(self, parameter: str) -> float:
        return self.values[parameter]


Secrets = Mapping[str, Hidden]
"""Effects by name."""


def rounded(value: Any, digits: int = 5) -> float:
    """Return a value as the truth tells it."""
    return float(round(value, digits))


def either_sign(rng: np.random.Generator) -> int:
    """Draw -1 or 1."""
    return int(rng.choice([-1, 1]))


def material_size(rng: np.random.Generator, materiality: float) -> float:
    """Draw a size clearly above a materiality."""
    return float(materiality * rng.uniform(1.7, 6))


PAIRS = (
    ("range_scale", "wheel_slip"), ("mount_xy", "random_outliers"),
    ("mount_yaw", "actuator_lag"), ("glass", "wheel_radius"),
    ("mirror", "range_noise"), ("black_surface", "moved_wall"),
    ("moved_obstacle", "range_bias"), ("missing_obstacle", "latency"),
    ("people", "wheel_base"), ("unmapped_obstacle", "dead_time"),
    ("incidence_dropout", "range_bias"), ("max_range", "mount_yaw"),
    ("tilt", "wheel_radius_diff"), ("mixed_pixels", "pose_clock_offset"),
    ("self_occlusion", "map_scale"), ("sector_bias", "speed_saturation"),
    ("scan_skew", "missing_obstacle"), ("range_drift", "moved_obstacle"),
    ("quantisation", "wheel_base"), ("wheel_radius", "dead_time"),
)  # fmt: skip
"""Pairs that do not hide each other."""
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


LIBRARY_DRAWS: Mapping[str, Draw] = {
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
    "speed_saturation": lambda rng, robot: {"v_max": rounded(robot.v * rng.uniform(0.45, 0.68), 4)},
}


DEVELOPMENT: Mapping[str, str] = {
    "f_crosstalk": "ghost returns of a second laser (do not occlude); near people/random_outliers",
    "f_lens": "radial distortion of the overhead camera; near range_scale/map_scale",
    "f_knock": "laser knocked during the run; near mount_yaw/mount_xy",
    "f_door": "a door opens during the run; near glass/moved_wall",
    "f_incbias": "range bias grows with incidence; near range_bias",
    "f_fovscale": "bearings stretched by a scale; near mount_yaw",
    "f_eccentric": (
        "eccentric mirror: sinusoidal bias over bearing; near mount_xy, which differs only where rays meet walls "
        "obliquely: a wrong name, though an understandable one"
    ),
    "f_wheelecc": "one wheel is eccentric, periodic yaw error; none near",
    "f_caster": "caster drags after a change of turning sense; near wheel_slip/wheel_base",
    "f_sag": "battery sags: gain commands to motion falls during the run; none near",
    "f_gyro": "odometry heading from a gyro with drifting bias; near wheel_radius_diff",
    "f_dup": "duplicated scans under new stamps; near latency",
    "f_shear": "the room is a sheared map; near map_scale/moved_wall",
    "f_bow": "one wall is bowed; near moved_wall",
    "f_fence": "a mesh fence that returns a share of the rays; near unmapped_obstacle/people",
    "f_dust": "dust cloud at one place; near people/random_outliers/unmapped_obstacle",
    "f_clockjump": "the laser clock jumps to and fro; near latency",
    "f_clockdrift": "laser clock drifts; near latency",
    "f_stuck": "some rays stay at an old value for seconds; near people",
    "f_vibration": "whole-scan bearing jitter that grows with turn rate; none near",
    "f_thermal": "range bias oscillates in time; near range_drift",
    "f_multipath": "corners read long; near range_bias",
    "f_ramp": "the robot tilts at one place of the floor; near tilt/unmapped_obstacle",
    "f_deadband": "small commands do not move the base; near dead_time/actuator_lag",
    "f_asym": "left turns lose a share on the floor, right ones do not; near wheel_base",
    "f_lostticks": "one encoder loses ticks at high speed; near wheel_radius_diff",
    "f_freeze": "the camera pose freezes at times; near latency/pose_clock_offset",
    "f_camyaw": "the camera heading has an error that depends on the place; near mount_yaw",
    "f_sun": "returns lost towards one direction of the world; near incidence_dropout/max_range",
    "f_cyclic": "cyclic (phase) range error; near range_bias",
}
REPORT: Mapping[str, str] = {
    "f_bloom": (
        "a retroreflective panel is seen by rays that pass beside it, and reads short; near "
        "black_surface/unmapped_obstacle"
    ),
    "f_curtain": "a curtain hangs before a wall and sways; near moved_wall/people",
    "f_corrugated": "the longest wall has niches; near moved_wall",
    "f_shoved": "an obstacle is pushed aside during the run; near moved_obstacle",
    "f_grime": "a dirty window scatters a share of one sector back, right before the laser; near self_occlusion",
    "f_ripple": "the mirror turns unevenly: bearing error of two periods a turn; near mount_yaw",
    "f_wing": "the building beyond a line is turned about it; near map_scale/moved_wall",
    "f_backlash": "play between encoder and wheel; near wheel_slip",
    "f_carpet": "the pile of a carpet carries the body aside in one direction; near wheel_radius_diff/wheel_slip",
    "f_wheelspin": "wheels spin while they gain speed; near wheel_slip",
    "f_sideslip": "the body slides outward in curves; none near",
    "f_dropout": "the radio link drops out at times and a watchdog stops the base; near dead_time",
    "f_slew": "the base has slower ramps of its own; near actuator_lag",
    "f_handover": "beyond a line a second camera takes over, which is shifted and turned; near moved_wall/map_scale",
    "f_twoclocks": "poses of two cameras alternate, one early and one late; near latency/pose_clock_offset",
}
KINDS: Mapping[str, Mapping[str, str]] = {"development": DEVELOPMENT, "report": REPORT}
NOTES: Mapping[str, str] = {**DEVELOPMENT, **REPORT}
"""What it is, and which effects of the library come near."""
CHANNELS = {
    **dict.fromkeys(("f_wheelecc", "f_caster", "f_asym", "f_gyro", "f_lostticks", "f_backlash"), "odometry"),
    **dict.fromkeys(("f_carpet", "f_wheelspin", "f_sideslip"), "odometry"),
    **dict.fromkeys(("f_sag", "f_deadband", "f_dropout", "f_slew"), "drive"),
    **dict.fromkeys(("f_lens", "f_freeze", "f_camyaw", "f_handover", "f_twoclocks"), "pose"),
}
"""Where those show that do not show in the scans."""
NEEDS_GAP = frozenset(["f_fovscale", "f_eccentric"])
"""Without meaning, or too near to the mount, for a laser that looks all round."""


def _vector(rng: np.random.Generator, low: float, high: float) -> tuple[float, float]:
    """Draw dx, dy [m] of a length between two bounds."""
    angle, size = rng.uniform(-np.pi, np.pi), rng.uniform(low, high)
    return rounded(size * np.cos(angle)), rounded(size * np.sin(angle))


def _handover(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    dx, dy = _vector(rng, 0.03, 0.05)
    turn = rounded(either_sign(rng) * rng.uniform(0.01, 0.02))
    return {"dir": rounded(rng.uniform(-3, 3)), "dx": dx, "dy": dy, "turn": turn}


def _grime(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    return {
        **_sector(rng, robot, 0.3, 0.6, 0.9),
        "p": rounded(rng.uniform(0.3, 0.5)),
        "r0": rounded(robot.range_min * 1.2 + 4 * robot.sigma, 4),
        "spread": 0.05,
    }


def _slew(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    share = rng.uniform(0.45, 0.6)
    return {"a": rounded(share * robot.a, 4), "alpha": rounded(share * robot.alpha, 4)}


def _between(low: float, high: float, key: str) -> Draw:
    return lambda rng, robot: {key: rounded(rng.uniform(low, high))}


def _several(**bounds: tuple[float, float]) -> Draw:
    """Draw each parameter between its bounds, in this order."""
    return lambda rng, robot: {key: rounded(rng.uniform(*span)) for key, span in bounds.items()}


def _either(rng: np.random.Generator, low: float, high: float) -> float:
    return rounded(either_sign(rng) * rng.uniform(low, high))


# fmt: off
DRAWS: Mapping[str, Draw] = {
    **LIBRARY_DRAWS,
    "f_knock": lambda rng, robot: {"da": _either(rng, 0.012, 0.025)} | _several(dx=(-0.03, 0.03), dy=(-0.03, 0.03))(rng, robot),
    "f_incbias": _between(0.05, 0.09, "b"),
    "f_fovscale": lambda rng, robot: {"s": _either(rng, 0.01, 0.015)},
    "f_eccentric": _several(A=(0.025, 0.04), ph=(-3, 3)),
    "f_cyclic": _several(A=(0.02, 0.035), lam=(0.9, 1.6)),
    "f_thermal": _several(A=(0.02, 0.03), T=(15, 25)),
    "f_multipath": _several(b=(0.06, 0.1), len=(0.12, 0.2)),
    "f_vibration": _between(0.012, 0.02, "k"),
    "f_crosstalk": lambda rng, robot: {
        "n": 2, "half": rounded(rng.uniform(0.05, 0.1)), "w1": _either(rng, 0.15, 0.4),
        "p1": rounded(rng.uniform(-3, 3)), "dmax": rounded(rng.uniform(1.5, 3))},
    "f_dup": _between(0.12, 0.2, "p"),
    "f_clockjump": _several(jump=(0.06, 0.12), period=(12, 20), on=(3, 6)),
    "f_clockdrift": _between(0.08, 0.15, "end"),
    "f_stuck": lambda rng, robot: {"n": int(rng.integers(10, 18)), "width": int(max(4, robot.n_rays // 25))},
    "f_sun": _several(dir=(-3, 3), half=(0.25, 0.4), p=(0.6, 0.9)),
    "f_wheelecc": _between(0.05, 0.08, "ecc"),
    "f_caster": _several(loss=(0.35, 0.55), time=(0.5, 0.9)),
    "f_sag": _between(0.15, 0.25, "end"),
    "f_deadband": lambda rng, robot: {
        "w": rounded(0.22 * robot.omega * rng.uniform(0.8, 1.2)),
        "v": rounded(0.18 * robot.v * rng.uniform(0.8, 1.2))},
    "f_asym": _between(0.05, 0.08, "s"),
    "f_gyro": lambda rng, robot: {"bias": _either(rng, 0.006, 0.012), "walk": _either(rng, 0.01, 0.02)},
    "f_lostticks": lambda rng, robot: {"frac": rounded(rng.uniform(0.05, 0.08)), "above": rounded(0.5 * robot.v)},
    "f_lens": lambda rng, robot: {"edge": _either(rng, 0.04, 0.06)},
    "f_freeze": lambda rng, robot: {"n": int(rng.integers(10, 16)), "dur": rounded(rng.uniform(0.35, 0.7))},
    "f_camyaw": _several(A=(0.015, 0.025), dir=(-3, 3)),
    "f_bloom": _several(gamma=(0.06, 0.12), short=(0.04, 0.07)),
    "f_curtain": _several(off=(0.06, 0.1), sway=(0.04, 0.06), T=(3, 6), wave=(0.6, 1.2)),
    "f_grime": _grime,
    "f_ripple": _several(A=(0.012, 0.02), ph=(-3, 3)),
    "f_backlash": lambda rng, robot: {"play": rounded(robot.wheel_base * rng.uniform(0.05, 0.08))},
    "f_carpet": _several(s=(0.03, 0.05), dir=(-3, 3)),
    "f_wheelspin": lambda rng, robot: {
        "loss": rounded(rng.uniform(0.15, 0.3)), "above": rounded(0.25 * robot.a)},
    "f_sideslip": _between(0.08, 0.15, "k"),
    "f_dropout": _several(per_minute=(8, 12), longest=(0.6, 0.9)),
    "f_slew": _slew,
    "f_handover": _handover,
    "f_twoclocks": _between(0.04, 0.07, "tau"),
}
# fmt: on
"""Sizes of the effects that need nothing of the run; `changes` and `placing` draw the others."""
