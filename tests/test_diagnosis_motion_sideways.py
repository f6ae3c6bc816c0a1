"""Across the heading: sliding and jumps of the reference are told, set-up is not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run

from logs.run import Run
from planners.types import Floats
from sensorgraph.diagnosis.motion.consequence import simulation_error
from sensorgraph.diagnosis.motion.odometry_channel import aligned_rows, diagnose_odometry
from sensorgraph.diagnosis.motion.wheel_model import WheelModel
from sensorgraph.diagnosis.motion.wheel_rows import motion_signals


def moved_aside(run: Run, speed: Callable[[Floats, Floats, Floats], Floats]) -> Run:
    """Return the run of a body that moves to its left at a speed [m/s] of v, omega and heading."""
    stamps, phi = run.pose_stamps, np.unwrap(run.poses[:, 2])
    v, omega = (np.interp(stamps, run.cmd_stamps, command) for command in run.commands.T)
    step = speed(v, omega, phi) * np.gradient(stamps)
    poses = run.poses.copy()
    poses[:, 0] -= np.cumsum(step * np.sin(phi))
    poses[:, 1] += np.cumsum(step * np.cos(phi))
    return replace(run, poses=poses)


def sliding_outward(v: Floats, omega: Floats, phi: Floats) -> Floats:
    """Slide outward in curves, a tenth of a second long."""
    return -0.1 * v * omega


def carried(v: Floats, omega: Floats, phi: Floats) -> Floats:
    """Go along y with 4 % of the way, as over the pile of a carpet: what is across the heading."""
    return 0.04 * np.abs(v) * np.cos(phi)


@pytest.mark.parametrize(
    ("speed", "said"),
    [(sliding_outward, "sideways sliding in curves"), (carried, "depends on the heading")],
    ids=["outward in curves", "the pile of a carpet"],
)
def test_what_moves_a_body_aside_is_unknown(
    speed: Callable[[Floats, Floats, Floats], Floats], said: str
) -> None:
    result = diagnose_odometry(moved_aside(make_run(21), speed), ROBOT)
    assert result.effects == ()
    assert result.unknown is not None and said in result.unknown.statement


def test_a_reference_that_is_mounted_askew_and_off_the_axle_is_set_up() -> None:
    run = make_run(22)
    poses = run.poses.copy()
    poses[:, :2] += 0.03 * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)  # ahead of the axle
    poses[:, 2] += 0.01
    result = diagnose_odometry(replace(run, poses=poses), ROBOT)
    assert result.effects == () and result.unknown is None


@pytest.mark.parametrize(("angle", "side"), [(0.085, "left"), *further((-0.085, "right"))])
def test_a_body_that_goes_askew_is_told_with_its_angle(angle: float, side: str) -> None:
    run = make_run(22)
    poses = run.poses.copy()
    poses[:, 2] -= angle
    result = diagnose_odometry(replace(run, poses=poses), ROBOT)
    assert result.unknown is not None and result.effects == ()
    told = re.search(rf"([\d.]+)° to the {side} of the body's heading", result.unknown.statement)
    assert told is not None and abs(float(told[1]) - 4.87) < 0.3
    located = diagnose_odometry(replace(run, poses=poses, pose_frame="laser"), ROBOT)
    assert located.unknown is None  # its mount may be what is askew


def test_positions_a_little_older_than_headings_are_within_the_tolerance_of_a_clock() -> None:
    result = diagnose_odometry(moved_aside(make_run(23), lambda v, omega, _: -0.004 * v * omega), ROBOT)
    assert result.effects == () and result.unknown is None


def test_rows_across_the_heading_are_what_the_body_slid() -> None:
    plain, slid = (
        WheelModel(aligned_rows(signals), signals.wheels, ROBOT)
        for signals in (
            motion_signals(run) for run in (make_run(24), moved_aside(make_run(24), sliding_outward))
        )
    )
    rows, wheels, period = slid.rows, slid.wheels, 0.1
    expected = rows.masked(-0.1 * (rows.D_along @ wheels.distance) * (rows.D_yaw @ wheels.turn) / period)
    moved = (slid.y - plain.y)[2 * rows.n :]
    error = moved - expected
    assert np.sqrt(np.mean(error**2)) < 0.3 * np.sqrt(
        np.mean(expected**2)
    )  # motors lag 0.1 s behind commands
    assert abs(np.polyfit(expected, moved, 1)[0] - 1) < 0.05


def handed_over(run: Run, turn: float = 0.015) -> Run:
    """Return the run as two cameras see it: beyond a line the second is 4 cm and a little turned off."""
    poses = run.poses.copy()
    beyond = poses[:, 0] > np.median(poses[:, 0])
    c, s = np.cos(turn), np.sin(turn)
    x, y = poses[:, :2].T
    other = np.stack([c * x - s * y + 0.03, s * x + c * y - 0.026, poses[:, 2] + turn], axis=1)
    return replace(run, poses=np.where(beyond[:, None], other, poses))


@pytest.mark.parametrize("seed", [11, *further(25)])
def test_a_second_camera_beyond_a_line_is_no_slippery_patch(seed: int) -> None:
    result = diagnose_odometry(handed_over(make_run(seed)), ROBOT)
    assert result.effects == () and result.unknown is not None
    assert "reference" in result.unknown.statement


def test_a_simulation_that_slides_aside_is_as_far_off_as_it_slid() -> None:
    n, dt = 1200, 0.1
    aside = np.full(n, 0.001 * dt)  # 1 mm/s to the left of a straight way
    size = simulation_error(np.full(n, 0.03), np.zeros(n), np.zeros(2 * n), np.full(n, dt), 0.4, aside)
    assert size.drift == pytest.approx(0.06, rel=0.01)  # a minute of it
    assert size.speed == pytest.approx(0.001)
