"""AMCL's parameters from a run: what was planted is found, with intervals that hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.run import Run
from sensorgraph.exporting.amcl import _motion_noise, estimate_amcl
from sensorgraph.loading import load_arena
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.simulate import occupancy_map

ROBOT = parse_robot("sensor: {n_rays: 61, rate: 5.0}\n")


def noisy_run(
    alphas: tuple[float, float, float, float],
    mixture: tuple[float, float, float],
    way: tuple[float, float] = (0.3, 0.4),
) -> Run:
    """Return a run with planted odometry noise (table 5.6) and a planted share of short, lost and random readings."""
    rng = np.random.default_rng(8)
    n, arena = 1500, load_arena("square")
    t = 0.5 * np.arange(n)
    phi, at, odo = 0.0, np.array([1.2, 1.2]), np.zeros(3)
    poses, odometry = [], []
    for _ in range(n):
        first, second = rng.uniform(-0.8, 0.8, 2)
        length = rng.uniform(*way)
        heading = np.arctan2(1.2 - at[1], 1.2 - at[0]) if np.hypot(*(at - 1.2)) > 0.3 else phi + first
        first = float((heading - phi + np.pi) % (2 * np.pi) - np.pi)
        first = float(np.clip(first, -1.0, 1.0))
        second = np.copysign(
            second, first
        )  # each step turns the robot, so that the filter is updated at each
        poses.append([*at, phi])
        odometry.append(odo.copy())
        at = at + length * np.array([np.cos(phi + first), np.sin(phi + first)])
        phi += first + second
        a1, a2, a3, a4 = alphas
        r1 = first + rng.normal() * np.sqrt(a1 * first**2 + a2 * length**2)
        d = length + rng.normal() * np.sqrt(a3 * length**2 + a4 * (first**2 + second**2))
        r2 = second + rng.normal() * np.sqrt(a1 * second**2 + a2 * length**2)
        odo = odo + [d * np.cos(odo[2] + r1), d * np.sin(odo[2] + r1), r1 + r2]
    truth = np.array(poses)
    ranges = cast(arena, truth, ROBOT.sensor).ranges
    ranges = ranges + 0.01 * rng.normal(size=ranges.shape)
    kind = rng.random(ranges.shape)
    short, lost, stray = mixture
    ranges = np.where(kind < short, rng.random(ranges.shape) * ranges, ranges)
    ranges = np.where((kind >= short) & (kind < short + lost), np.inf, ranges)
    uniform = rng.random(ranges.shape) * ROBOT.sensor.range_max
    ranges = np.where((kind >= short + lost) & (kind < short + lost + stray), uniform, ranges)
    return Run(
        sensor=ROBOT.sensor, stamps=t, ranges=ranges, pose_stamps=t, poses=truth, odom_stamps=t,
        odometry=np.array(odometry), odom_twists=np.zeros((n, 2)),
    )  # fmt: skip


def test_amcl_finds_the_planted_noise_of_odometry_and_laser() -> None:
    alphas, mixture = (0.01, 0.004, 0.02, 0.002), (0.0, 0.06, 0.04)
    arena = load_arena("square")
    found = estimate_amcl(noisy_run(alphas, mixture), arena, occupancy_map(arena))
    for name, planted in zip(("alpha1", "alpha2", "alpha3", "alpha4"), alphas, strict=True):
        wide = found[name].high - found[name].low
        assert found[name].low - wide / 2 <= planted <= found[name].high + wide / 2, name
        assert wide < 2 * planted + 1e-3
    assert found["z_max"].value == pytest.approx(0.06, abs=0.006)
    assert found["z_rand"].value + found["z_short"].value == pytest.approx(0.04, abs=0.008)
    assert found["z_hit"].value == pytest.approx(0.90, abs=0.01)
    assert 0.01 < found["sigma_hit"].value < 0.06  # half a cell and the laser's noise
    assert found["laser_max_range"].value == ROBOT.sensor.range_max


def test_noise_of_the_reference_on_short_ways_is_no_noise_of_the_wheels() -> None:
    """The direction of a short way is noise: the two turns are wrong by the same, and cancel."""
    alphas = (0.01, 0.004, 0.02, 0.002)
    run = noisy_run(alphas, (0.0, 0.0, 0.0), way=(0.02, 0.06))
    noise = np.random.default_rng(1).normal(size=run.poses.shape) * [0.005, 0.005, 0.001]
    found = _motion_noise(replace(run, poses=run.poses + noise))
    assert found["alpha1"].value == pytest.approx(alphas[0], rel=0.4)
