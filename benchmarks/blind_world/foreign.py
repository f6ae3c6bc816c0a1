"""Effects outside the library: 30 kinds for development, 15 for reports, and their sizes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.blind_world.hidden import either_sign, rounded
from benchmarks.blind_world.library import Draw
from benchmarks.blind_world.robots import Robot

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
ODOMETRY = frozenset(
    [
        "f_wheelecc",
        "f_caster",
        "f_asym",
        "f_gyro",
        "f_lostticks",
        "f_backlash",
        "f_carpet",
        "f_wheelspin",
        "f_sideslip",
    ]
)
DRIVE = frozenset(["f_sag", "f_deadband", "f_dropout", "f_slew"])
POSE = frozenset(["f_lens", "f_freeze", "f_camyaw", "f_handover", "f_twoclocks"])
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
    width, half = rng.uniform(0.3, 0.6), robot.fov / 2
    first = rng.uniform(-half * 0.9, half * 0.9 - width)
    return {
        "theta1": rounded(first),
        "theta2": rounded(first + width),
        "p": rounded(rng.uniform(0.3, 0.5)),
        "r0": rounded(robot.range_min * 1.2 + 4 * robot.sigma, 4),
        "spread": 0.05,
    }


def _slew(rng: np.random.Generator, robot: Robot) -> dict[str, float]:
    share = rng.uniform(0.45, 0.6)
    return {"a": rounded(share * robot.limits[2], 4), "alpha": rounded(share * robot.limits[3], 4)}


def _between(low: float, high: float, key: str) -> Draw:
    return lambda rng, robot: {key: rounded(rng.uniform(low, high))}


def _several(**bounds: tuple[float, float]) -> Draw:
    """Draw each parameter between its bounds, in this order."""
    return lambda rng, robot: {key: rounded(rng.uniform(*span)) for key, span in bounds.items()}


def _signed(rng: np.random.Generator, low: float, high: float) -> float:
    return rounded(either_sign(rng) * rng.uniform(low, high))


# fmt: off
DRAWS: Mapping[str, Draw] = {
    "f_knock": lambda rng, robot: {"da": _signed(rng, 0.012, 0.025)} | _several(dx=(-0.03, 0.03), dy=(-0.03, 0.03))(rng, robot),
    "f_incbias": _between(0.05, 0.09, "b"),
    "f_fovscale": lambda rng, robot: {"s": _signed(rng, 0.01, 0.015)},
    "f_eccentric": _several(A=(0.025, 0.04), ph=(-3, 3)),
    "f_cyclic": _several(A=(0.02, 0.035), lam=(0.9, 1.6)),
    "f_thermal": _several(A=(0.02, 0.03), T=(15, 25)),
    "f_multipath": _several(b=(0.06, 0.1), len=(0.12, 0.2)),
    "f_vibration": _between(0.012, 0.02, "k"),
    "f_crosstalk": lambda rng, robot: {
        "n": 2, "half": rounded(rng.uniform(0.05, 0.1)), "w1": _signed(rng, 0.15, 0.4),
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
        "w": rounded(0.22 * robot.limits[1] * rng.uniform(0.8, 1.2)),
        "v": rounded(0.18 * robot.limits[0] * rng.uniform(0.8, 1.2))},
    "f_asym": _between(0.05, 0.08, "s"),
    "f_gyro": lambda rng, robot: {"bias": _signed(rng, 0.006, 0.012), "walk": _signed(rng, 0.01, 0.02)},
    "f_lostticks": lambda rng, robot: {"frac": rounded(rng.uniform(0.05, 0.08)), "above": rounded(0.5 * robot.limits[0])},
    "f_lens": lambda rng, robot: {"edge": _signed(rng, 0.04, 0.06)},
    "f_freeze": lambda rng, robot: {"n": int(rng.integers(10, 16)), "dur": rounded(rng.uniform(0.35, 0.7))},
    "f_camyaw": _several(A=(0.015, 0.025), dir=(-3, 3)),
    "f_bloom": _several(gamma=(0.06, 0.12), short=(0.04, 0.07)),
    "f_curtain": _several(off=(0.06, 0.1), sway=(0.04, 0.06), T=(3, 6), wave=(0.6, 1.2)),
    "f_grime": _grime,
    "f_ripple": _several(A=(0.012, 0.02), ph=(-3, 3)),
    "f_backlash": lambda rng, robot: {"play": rounded(robot.wheel_base * rng.uniform(0.05, 0.08))},
    "f_carpet": _several(s=(0.03, 0.05), dir=(-3, 3)),
    "f_wheelspin": lambda rng, robot: {
        "loss": rounded(rng.uniform(0.15, 0.3)), "above": rounded(0.25 * robot.limits[2])},
    "f_sideslip": _between(0.08, 0.15, "k"),
    "f_dropout": _several(per_minute=(8, 12), longest=(0.6, 0.9)),
    "f_slew": _slew,
    "f_handover": _handover,
    "f_twoclocks": _between(0.04, 0.07, "tau"),
}
# fmt: on
"""Sizes of the kinds that need nothing of the run; `changes` and `placing` draw the others."""
