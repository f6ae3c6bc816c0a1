"""Odometry that counts backwards is named: its distance, its turns, both, or one wheel; sound odometry never is."""

from __future__ import annotations

import numpy as np
import pytest

from logs.run import Run
from sensorgraph.diagnosis.motion.odometry_channel import counts_backwards, diagnose_odometry
from sensorgraph.diagnosis.motion.wheel_rows import motion_signals
from sensorgraph.types import Floats
from sensorgraph.world.robot import parse_robot

BASE = 0.3
"""[m]"""
IDENTITY = np.eye(2)
SIGNS = {
    "counts its distance backwards, or the reference": np.diag([-1.0, 1.0]),
    "counts its turns backwards (left and right wheel exchanged)": np.diag([1.0, -1.0]),
    "counts its distance and turns backwards": -IDENTITY,
    "the left wheel of the odometry counts backwards": np.array([[0.0, BASE / 2], [2 / BASE, 0.0]]),
    "the right wheel of the odometry counts backwards": -np.array([[0.0, BASE / 2], [2 / BASE, 0.0]]),
}


def path(twists: Floats, dt: float) -> Floats:
    """Integrate twists (n, 2) [m/s, rad/s] from the origin; return (n + 1, 3)."""
    phi = np.append(0.0, np.cumsum(twists[:, 1] * dt))
    middle = phi[:-1] + twists[:, 1] * dt / 2
    steps = twists[:, :1] * dt * np.column_stack([np.cos(middle), np.sin(middle)])
    return np.column_stack([np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]), phi])


def drive(counts: Floats, *, curved: float = 0.0, late: float = 0.0) -> Run:
    """Drive for 60 s; the odometry reports counts (2, 2) times the true distance and turn."""
    rng, dt = np.random.default_rng(0), 0.05
    twists = np.repeat(rng.uniform([0.1, -0.8], [0.5, 0.8], (40, 2)), 30, axis=0)
    if curved:
        twists[:, 1] = curved * twists[:, 0]
    stamps = dt * np.arange(len(twists) + 1)
    robot = parse_robot("sensor: {n_rays: 9}")
    poses = path(twists, dt) + rng.standard_normal((len(stamps), 3)) * [0.002, 0.002, 0.001]
    n = len(stamps)
    return Run(
        sensor=robot.sensor,
        stamps=stamps[:1],
        ranges=np.ones((1, robot.sensor.n_rays)),
        pose_stamps=stamps,
        poses=poses,
        odom_stamps=stamps + late,
        odometry=path(twists @ counts.T, dt),
        odom_twists=np.zeros((n, 2)),
    )


@pytest.mark.parametrize("late", [0.0, 0.15])
@pytest.mark.parametrize("said", SIGNS)
def test_what_counts_backwards_is_named(said: str, late: float) -> None:
    assert said in counts_backwards(motion_signals(drive(SIGNS[said], late=late)))


@pytest.mark.parametrize("scale", [(0.5, 0.5), (1.0, 1.0), (2.0, 0.8)])
@pytest.mark.parametrize("curved", [0.0, 1.5])
def test_odometry_of_another_scale_does_not_count_backwards(
    scale: tuple[float, float], curved: float
) -> None:
    assert counts_backwards(motion_signals(drive(np.diag(scale), curved=curved))) == ""


def test_the_odometry_channel_says_it_and_names_no_effect() -> None:
    found = diagnose_odometry(drive(SIGNS["counts its distance and turns backwards"]), parse_robot(""))
    assert found.unknown is not None and not found.effects
    assert found.unknown.statement == (
        "the odometry counts its distance and turns backwards; correct the sign, then diagnose again"
    )
