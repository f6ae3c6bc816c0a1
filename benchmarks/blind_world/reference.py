"""The overhead pose reference, and what may be wrong with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.blind_world.base import PHI, X, Y
from benchmarks.blind_world.drive import Driven
from benchmarks.blind_world.hidden import Hidden
from benchmarks.blind_world.robots import Robot
from benchmarks.blind_world.rooms import Floats, Room


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
