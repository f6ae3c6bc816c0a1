"""The error of a reference that varies within a sweep: its size, and that it is no noise of the laser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_samples import hall_arena

from logs.run import Run
from planners.arena import wrap
from planners.types import Floats
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.intake import (
    estimated_wobble,
    references_in_sweep,
    share_within,
)
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import parse_robot

TEXT = "sensor: {{n_rays: 90, fov: 3.14159265, sweep_time: {sweep}, sigma: 0.01, rate: 4}}\ntolerances: {{pose_xy: 0.004, pose_yaw: 0.009}}\n"


def path(t: Floats) -> Floats:
    return np.stack([3 + 1.5 * np.cos(0.4 * t), 2.2 + np.sin(0.4 * t), 0.8 * t], axis=-1)


def sweeps(sweep: float, memory: float) -> ScanData:
    """Return scans of a laser that sweeps while a reference at 25 Hz has noise of 3 mm and 8 mrad that lasts."""
    rng, hall = np.random.default_rng(0), hall_arena()
    robot = parse_robot(TEXT.format(sweep=sweep))
    t, fine = np.arange(1.0, 50.0, 0.25), np.arange(0.0, 52.0, 0.04)
    noise = rng.normal(size=(len(fine), 3))
    for k in range(1, len(noise)):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    poses = path(fine) + noise * [0.003, 0.003, 0.008]
    ranges = np.empty((len(t), robot.sensor.n_rays))
    for k, delay in enumerate(robot.sensor.ray_delays):
        lasers = laser_poses(path(t + delay), robot.sensor.mount)
        ranges[:, k] = cast_laser(hall.walls, lasers, robot.sensor.bearings[k : k + 1], 50.0)[0][:, 0]
    ranges += 0.01 * rng.normal(size=ranges.shape)
    run = Run(
        sensor=robot.sensor, stamps=t, ranges=ranges, pose_stamps=fine,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
    )  # fmt: skip
    return prepare_scans(run, hall, robot)[0]


def test_noise_that_is_new_in_every_pose_wobbles_and_noise_that_lasts_hardly_does() -> None:
    white, lasting = sweeps(0.2, 0.0).wobble, sweeps(0.2, 0.95).wobble
    assert white == pytest.approx((0.003 * np.sqrt(0.485), 0.008 * np.sqrt(0.485)), rel=0.15)
    assert lasting[0] < 0.4 * white[0] and lasting[1] < 0.4 * white[1]
    assert sweeps(0.0, 0.0).wobble == (0.0, 0.0)


@pytest.mark.parametrize("count", [0.3, 0.85, 1.0, 1.5, 2.0, 5.0])
def test_what_varies_within_a_sweep_is_that_of_errors_interpolated_between_poses(count: float) -> None:
    """Drawn anew in every pose; a sweep that is shorter than the time between two poses has a part of it, too."""
    rng = np.random.default_rng(0)
    known, begin = rng.normal(size=(20_000, int(count) + 3)), rng.random((20_000, 1))
    at = begin + count * np.linspace(0.0, 1.0, 101)
    k, part = at.astype(np.intp), at % 1
    error = np.take_along_axis(known, k, 1) * (1 - part) + np.take_along_axis(known, k + 1, 1) * part
    assert share_within(count) == pytest.approx(error.var(axis=1).mean(), rel=0.03)


def test_interlaced_sweeps_take_as_long_as_from_the_first_ray_to_the_last() -> None:
    """Two sweeps of 30 ms, 40 ms apart, beside a pose every 0.1 s: half of the rays see the robot elsewhere."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 40.0, 0.1)
    sensor = parse_robot(
        "sensor: {n_rays: 90, sweep_time: 0.03, interlaced_sweeps: 2, sweep_period: 0.04}"
    ).sensor
    poses = path(t) + rng.normal(size=(len(t), 3)) * [0.004, 0.004, 0.002]
    run = Run(
        sensor=sensor, stamps=t, ranges=np.ones((len(t), 90)), pose_stamps=t,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
    )  # fmt: skip
    assert references_in_sweep(run, sensor) == pytest.approx(0.7)
    xy, yaw = estimated_wobble(
        run, sensor, parse_robot("tolerances: {pose_xy: 0.01, pose_yaw: 0.01}").tolerances
    )
    assert (xy, yaw) == pytest.approx(
        (0.004 * share_within(0.7) ** 0.5, 0.002 * share_within(0.7) ** 0.5), rel=0.2
    )


def test_the_turning_of_a_robot_between_rare_poses_is_no_noise() -> None:
    """Poses every half second of one that weaves, without any noise, and a sweep of 0.2 s; one of 26 ms has none at all."""
    t = np.arange(0.0, 60.0, 0.5)
    poses = np.column_stack([0.5 * t, np.sin(t), 0.9 * np.sin(1.3 * t)])
    robot = parse_robot(
        "sensor: {n_rays: 90, sweep_time: 0.026}\ntolerances: {pose_xy: 0.003, pose_yaw: 0.001}"
    )
    run = Run(sensor=robot.sensor, stamps=t, ranges=np.ones((len(t), 90)), pose_stamps=t, poses=poses)
    xy, yaw = estimated_wobble(run, robot.sensor, robot.tolerances)
    assert xy < 0.03 * 0.003 and yaw < 0.03 * 0.001


def test_slanting_rays_scatter_as_the_wobble_says() -> None:
    """By how much does their scatter exceed that of rays that meet their wall head-on?"""
    data = sweeps(0.2, 0.0)
    ratios = []
    for one in (data, replace(data, wobble=(0.0, 0.0), memo={})):
        view = FitResiduals(one, fit(one, (), start_state(one, SCAN.noise), SCAN.noise))
        incidence, off = np.degrees(view.incidence), np.abs(view.z - view.mu) / view.sigma
        slanting, facing = (
            view.returned & (incidence > low) & (incidence < high) for low, high in ((50, 70), (0, 15))
        )
        ratios.append(float(np.median(off[slanting]) / np.median(off[facing])))
    assert abs(ratios[0] - 1) < 0.3 < ratios[1] - 1
