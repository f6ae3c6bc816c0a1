"""A slow sweep fixes the pose in its middle; at its stamp, the pose lies between the middles of two sweeps."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further

from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert, twists_of, wrap
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.sweep_middles import SweepMiddles
from tests.localization_samples import Floats, looking_about, seen, timed

T = 0.2
"""[s] of a sweep, and from one to the next, as of an LDS-01."""
WHEEL = 1.05
"""Ratio of the stated turns to the true ones, of a robot with a wrong wheelbase."""


def run_of(n: int, sweep_time: float = T, *, scatter: float = 0.0, scale: float = 1.0, seed: int = 0) -> Run:
    """Return the run of a robot that looks about; its odometry is `scale` too long, and its stamps scatter [s]."""
    rng = np.random.default_rng(seed)
    sensor = RangeSensor(
        bearings=np.linspace(-np.pi, np.pi, 120, endpoint=False), range_max=20.0, rate=1 / T, sweep_time=sweep_time
    )  # fmt: skip
    stamps = T * np.arange(1, n + 1)
    rays = looking_about(stamps[:, None] + sensor.ray_delays)
    rays[..., 2] += sensor.bearings
    ranges = seen(rays.reshape(-1, 3), np.zeros(1)).reshape(n, -1) + 0.01 * rng.normal(size=(n, 120))
    times = np.arange(0.0, stamps[-1] + 2 * T, 0.05)
    odometry = compose(
        invert(looking_about(times[:1])), looking_about(times + scatter * rng.normal(size=len(times)))
    )
    odometry[:, 2] = scale * np.unwrap(odometry[:, 2])
    return timed(
        Run(
            sensor=sensor, stamps=stamps, ranges=ranges, odom_stamps=times,
            odometry=np.column_stack([odometry[:, :2], wrap(odometry[:, 2])]), odom_twists=twists_of(times, odometry),
        )
    )  # fmt: skip


def by_middles(run: Run, motion: Motion) -> tuple[Floats, Floats]:
    """Return errors [rad] and standard deviations of the headings (n_scans,) if the middle of each sweep is known."""
    half = float(run.sensor.ray_delays.mean())
    middles = SweepMiddles.of(run, motion)
    assert middles is not None
    poses = compose(looking_about(run.stamps + half), invert(middles.to_own))
    found, covariances = middles.placed(poses, np.zeros((run.n_scans, 3, 3)), np.arange(run.n_scans) > 0)
    return wrap(found[:, 2] - looking_about(run.stamps)[:, 2]), np.sqrt(covariances[:, 2, 2])


def motion_of(run: Run) -> Motion:
    poses = np.column_stack([run.odometry[:, :2], np.unwrap(run.odometry[:, 2])])
    return Motion(stamps=run.odom_stamps, poses=poses)


@pytest.mark.parametrize("sweep_time", [T, -T])
def test_a_wrong_wheelbase_turns_no_pose_between_two_middles(sweep_time: float) -> None:
    run = run_of(100, sweep_time, scale=WHEEL)
    off, deviations = by_middles(run, motion_of(run))
    alone = (WHEEL - 1) * T / 2  # [rad] of a turn at 1 rad/s
    assert np.abs(off[1:-1]).max() < 0.15 * alone  # a change of the speed within the sweep remains
    assert np.abs(off[[0, -1]]).max() < alone
    assert (np.abs(off) < 3 * deviations + 1e-4).all()


@pytest.mark.parametrize("seed", [0, *further(1, 2)])
def test_stamps_that_scatter_are_in_the_deviations(seed: int) -> None:
    run = run_of(400, scatter=0.003, seed=seed)
    off, deviations = by_middles(run, motion_of(run))
    z = off / deviations
    assert np.mean(np.abs(z) < 2) == pytest.approx(
        0.954, abs=0.035
    )  # 3 of its own deviations, from 400 scans
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2


def test_a_motion_by_which_a_scan_was_not_deskewed_moves_it_nowhere() -> None:
    run = run_of(20, scale=WHEEL)
    middles = SweepMiddles.of(run, motion_of(run))
    assert middles is not None
    other = np.arange(20) == 10
    poses, none = looking_about(run.stamps), np.zeros((20, 3, 3))
    found, covariances = middles.without(other).placed(poses, none, np.arange(20) > 0)
    assert (found[10] == poses[10]).all()
    assert (covariances[10] == 0).all()


def test_a_laser_without_a_sweep_has_no_middles() -> None:
    run = run_of(20, 0.0)
    assert SweepMiddles.of(run, motion_of(run)) is None


def test_headings_of_a_slow_laser_are_within_their_deviations() -> None:
    run = run_of(120, scatter=0.003)
    found = map_run(run)
    off = wrap(found.poses[:, 2] - looking_about(run.stamps)[:, 2])
    off = wrap(off - np.angle(np.exp(1j * off).mean()))
    z = off / np.sqrt(found.covariances[:, 2, 2])
    assert np.mean(np.abs(z) < 2) > 0.9  # of 95 %
    assert set(found.status) == {"ok"}
