"""What encoders make of the wheels in the conventions that drivers have, and the overhead pose reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects.log import Floats, Odometry
from benchmarks.hidden_effects.worlds.blind.base import PHI, RIM_LEFT, RIM_RIGHT, X, Y
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import Hidden
from benchmarks.hidden_effects.worlds.blind.robots import Robot
from benchmarks.hidden_effects.worlds.blind.rooms import Room


@dataclass(frozen=True, kw_only=True)
class Convention:
    """How a driver counts, adds up and stamps; all of these are right."""

    integration: str = "exact"
    """exact, mid or rect: along the arc, or along the heading at the middle or at the start of a period."""
    twist: str = "back"
    """back: of the last period; smooth: the mean of the last two."""
    age: float = 0.0
    """[s] how much older a reading is than its stamp."""
    phase: float = 0.0
    """Share of a period before the first stamp."""
    skew: float = 0.0
    """By how much the rate differs from the data sheet."""


def count(
    robot: Robot,
    driven: Driven,
    rng: np.random.Generator,
    convention: Convention,
    *,
    gyro_bias: Callable[[Floats], Floats] | None = None,
    lost_above: float = np.inf,
    lost_share: float = 0.0,
) -> Odometry:
    """Return the odometry of a drive.

    Parameters
    ----------
    gyro_bias : [rad/s] at stamps, of a gyro that gives the heading
    lost_above, lost_share : the right encoder loses this share of its ticks above this speed [m/s]
    """
    rate = robot.odometry_rate * (1 + convention.skew)
    stamps = np.arange(0.1 + convention.phase / rate, driven.duration - 0.1, 1 / rate)
    taken = stamps - convention.age
    right, left = np.diff(driven.at(taken, RIM_RIGHT)), np.diff(driven.at(taken, RIM_LEFT))
    right = np.where(right * rate > lost_above, right * (1 - lost_share), right)
    right, left = np.r_[0, np.cumsum(right)] + 0.3e-3, np.r_[0, np.cumsum(left)] + 0.1e-3
    step_right = np.diff(np.floor(right / robot.tick) * robot.tick)
    step_left = np.diff(np.floor(left / robot.tick) * robot.tick)
    moves = (np.abs(step_right) + np.abs(step_left)) > 0
    n = moves.size
    way = 0.5 * (step_right + step_left) + rng.normal(0, robot.noise_v / rate, n) * moves
    turn = (step_right - step_left) / robot.wheel_base + rng.normal(0, robot.noise_omega / rate, n) * moves
    if gyro_bias is not None:
        turn = turn + gyro_bias(stamps[1:]) / rate
    phi = np.r_[0, np.cumsum(turn)]
    heading = phi[:-1] + {"exact": 0.5 * turn, "mid": 0.5 * turn, "rect": 0 * turn}[convention.integration]
    chord = way * (np.sinc(turn / 2 / np.pi) if convention.integration == "exact" else 1.0)
    x, y = np.cumsum(chord * np.cos(heading)), np.cumsum(chord * np.sin(heading))
    v, omega = way * rate, turn * rate
    if convention.twist == "smooth":
        v = np.convolve(np.r_[v[0], v], [0.5, 0.5], "valid")
        omega = np.convolve(np.r_[omega[0], omega], [0.5, 0.5], "valid")
    return Odometry(
        stamps=stamps[1:], poses=np.column_stack([x, y, phi[1:]]), twists=np.column_stack([v, omega])
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """What is logged."""

    stamps: Floats
    """(n,) [s]"""
    poses: Floats
    """(n, 3) [m, m, rad], phi not wrapped."""
    off_xy: float
    off_yaw: float
    """[m, rad] r.m.s. of what is hidden in it."""


def observe(
    robot: Robot,
    room: Room,
    driven: Driven,
    secrets: Mapping[str, Hidden],
    *,
    duration: float,
    rate_rng: np.random.Generator,
    noise_rng: np.random.Generator,
    dirty_rng: np.random.Generator | None,
) -> Reference:
    """Return the poses of a drive.

    Parameters
    ----------
    duration : [s] as planned
    dirty_rng : of a dirty set-up, whose noise lasts several frames and which is off by a millimetre here and there
    """
    first, last = 0.05 + rate_rng.uniform(0, 1 / robot.pose_rate), driven.duration - 0.05
    stamps = np.arange(first, last, (1 + rate_rng.uniform(-1, 1) * 2e-3) / robot.pose_rate)
    taken = _taken(stamps, duration, secrets, noise_rng)
    if dirty_rng is not None:
        taken = taken + np.clip(noise_rng.normal(0, 0.0008, stamps.size), -0.002, 0.002)
    true = np.stack([driven.at(taken, column) for column in (X, Y, PHI)])  # (3, n)
    noise = noise_rng.normal(0, 1, (3, stamps.size))
    warp: Floats = np.zeros((3, 1))
    if dirty_rng is not None:
        keep = np.exp(-1 / dirty_rng.uniform(3, 8))
        noise = lfilter([np.sqrt(1 - keep * keep)], [1, -keep], noise, axis=1)
        a, b = dirty_rng.uniform(0.8, 2, 2), dirty_rng.uniform(0, 6, 4)
        waves = [a[0] * true[0] + b[0], a[1] * true[1] + b[1], a[0] * true[1] + b[2]]
        warp = np.array([[0.0008], [0.0008], [0.0004]]) * np.sin(waves)
    told = _told(room, true, secrets)
    now = np.stack([driven.at(stamps, column) for column in (X, Y, PHI)])
    square = np.mean((told - now) ** 2, axis=1)
    poses = told + warp + noise * np.array([[robot.sigma_xy], [robot.sigma_xy], [robot.sigma_yaw]])
    if "f_freeze" in secrets:
        for k in np.flatnonzero(stamps - taken > 0.6 / robot.pose_rate):
            poses[:, k] = poses[:, k - 1]  # to the bit
    return Reference(
        stamps=stamps,
        poses=poses.T,
        off_xy=float(np.sqrt(square[0] + square[1])),
        off_yaw=float(np.sqrt(square[2])),
    )


def _taken(
    stamps: Floats, duration: float, secrets: Mapping[str, Hidden], rng: np.random.Generator
) -> Floats:
    taken = stamps.copy()
    freeze = secrets.get("f_freeze")
    if freeze is not None:
        for begin in np.sort(rng.uniform(2, duration - 3, int(freeze["n"]))):
            taken[(stamps > begin) & (stamps < begin + freeze["dur"])] = begin
    if "f_twoclocks" in secrets:
        taken = taken + secrets["f_twoclocks"]["tau"] * np.where(np.arange(stamps.size) % 2, 1, -1)
    return taken


def _told(room: Room, true: Floats, secrets: Mapping[str, Hidden]) -> Floats:
    """Return the poses (3, n) as a camera sees them, without noise."""
    x, y, phi = true
    off_x, off_y = x - room.middle[0], y - room.middle[1]
    lens = secrets.get("f_lens")
    if lens is not None:
        reach = np.hypot(*(room.outer.max(axis=0) - room.middle)) * 0.75
        grown = lens["edge"] / reach**3 * (off_x**2 + off_y**2)
        x, y = x + grown * off_x, y + grown * off_y
    tilted = secrets.get("f_camyaw")
    if tilted is not None:
        along = off_x * np.cos(tilted["dir"]) + off_y * np.sin(tilted["dir"])
        phi = phi + tilted["A"] * along / 1.5
    second = secrets.get("f_handover")
    if second is not None:
        c, s = np.cos(second["turn"]), np.sin(second["turn"])
        beyond = off_x * np.cos(second["dir"]) + off_y * np.sin(second["dir"]) > 0
        x = np.where(beyond, room.middle[0] + c * off_x - s * off_y + second["dx"], x)
        y = np.where(beyond, room.middle[1] + s * off_x + c * off_y + second["dy"], y)
        phi = phi + second["turn"] * beyond
    return np.stack([x, y, phi])
