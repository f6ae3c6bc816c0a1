"""Rooms of straight walls, and a laser in them: a ray caster of its own, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from numpy.typing import NDArray

from logs.run import RangeSensor, Run

Floats = NDArray[np.float64]

ROOM = [  # an L with a niche and a box: no symmetry
    (0.0, 0.0, 8.0, 0.0), (8.0, 0.0, 8.0, 3.0), (8.0, 3.0, 5.0, 3.0), (5.0, 3.0, 5.0, 6.0), (5.0, 6.0, 2.6, 6.0),
    (2.6, 6.0, 2.6, 6.6), (2.6, 6.6, 1.6, 6.6), (1.6, 6.6, 1.6, 6.0), (1.6, 6.0, 0.0, 6.0), (0.0, 6.0, 0.0, 0.0),
    (3.2, 2.1, 3.9, 2.3), (3.9, 2.3, 3.7, 3.0), (3.7, 3.0, 3.0, 2.8), (3.0, 2.8, 3.2, 2.1),
]  # fmt: skip
"""Walls (x0, y0, x1, y1) [m]."""
CORRIDOR = [(-30.0, -1.0, 30.0, -1.0), (-30.0, 1.0, 30.0, 1.0)]
"""Two walls that look the same everywhere."""


def seen(poses: Floats, bearings: Floats, walls: list[tuple[float, float, float, float]] = ROOM) -> Floats:
    """Return ranges (n, n_rays) [m] from poses (n, 3) of the laser; +inf where there is no wall."""
    a = np.array(walls)[:, :2]
    d = np.array(walls)[:, 2:] - a
    angle = poses[:, 2:3] + bearings  # (n, n_rays)
    u = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, :, None]  # (n, n_rays, 1, 2)
    to = a - poses[:, None, None, :2]
    across = u[..., 0] * d[:, 1] - u[..., 1] * d[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (to[..., 0] * d[:, 1] - to[..., 1] * d[:, 0]) / across
        along = (to[..., 0] * u[..., 1] - to[..., 1] * u[..., 0]) / across
    hit = (way > 0) & (along >= 0) & (along <= 1)
    return np.where(hit, way, np.inf).min(axis=2)


def loop_poses(n: int, *, laps: float = 1.0) -> Floats:
    """Return poses (n, 3) around the box of the room, about 8 m a lap, looking ahead."""
    t = np.linspace(0, 2 * np.pi * laps, n)
    x, y = 3.2 + 1.5 * np.cos(t), 2.6 + 1.5 * np.sin(t)
    return np.column_stack([x, y, t + np.pi / 2])


def looking_about(t: Floats) -> Floats:
    """Drive around the box of the room and look about: up to 1 rad/s, in both senses; poses (n, 3) at times (n,) [s]."""
    x, y = 3.2 + 1.5 * np.cos(0.2 * t), 2.6 + 1.5 * np.sin(0.2 * t)
    return np.stack([x, y, 0.2 * t + np.pi / 2 + 0.9 * np.sin(0.9 * t)], axis=-1)


def room_run(
    poses: Floats,
    *,
    n_rays: int = 120,
    sigma: float = 0.01,
    way_scale: float = 1.0,
    heading_bias: float = 0.0,
    rate: float = 5.0,
    seed: int = 0,
    walls: list[tuple[float, float, float, float]] = ROOM,
) -> Run:
    """Return a run of scans with wheels that measure ways times `way_scale`, and miss `heading_bias` [rad/m]."""
    rng = np.random.default_rng(seed)
    bearings = np.linspace(-np.pi, np.pi, n_rays, endpoint=False)
    sensor = RangeSensor(bearings=bearings, range_max=20.0, sigma=sigma, rate=rate)
    ranges = seen(poses, bearings, walls)
    ranges = ranges + sigma * rng.normal(size=ranges.shape)
    stamps = np.arange(len(poses)) / rate
    odometry = np.zeros_like(poses)
    for k in range(1, len(poses)):
        step = poses[k, :2] - poses[k - 1, :2]
        c, s = np.cos(poses[k - 1, 2]), np.sin(poses[k - 1, 2])
        ahead, left = c * step[0] + s * step[1], -s * step[0] + c * step[1]
        turn = poses[k, 2] - poses[k - 1, 2] - heading_bias * float(np.hypot(*step))
        c, s = np.cos(odometry[k - 1, 2]), np.sin(odometry[k - 1, 2])
        odometry[k, :2] = odometry[k - 1, :2] + way_scale * np.array(
            [c * ahead - s * left, s * ahead + c * left]
        )
        odometry[k, 2] = odometry[k - 1, 2] + turn
    return Run(
        sensor=sensor,
        stamps=stamps,
        ranges=ranges,
        odom_stamps=stamps,
        odometry=odometry,
        odom_twists=np.zeros((len(poses), 2)),
    )


def timed(run: Run) -> Run:
    """Return the run with ray times that a robot.yaml states: they are used as they are, which saves two thirds of the time."""
    return replace(run, meta={**run.meta, "ray_times": "robot.yaml"})


def untimed(run: Run) -> Run:
    """Return the run as it is: its ray times are estimated."""
    return run


any_times = pytest.mark.parametrize("times", [timed, *further(untimed)])
"""Claims about a run whose ray times are known, and in the slow suite about one whose ray times are estimated."""
