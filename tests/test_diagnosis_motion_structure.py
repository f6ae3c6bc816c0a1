"""What wheels, floors and references do that no effect of the library makes: unknown, and said in its own words."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run, reported

from logs.run import Run
from planners.arena import wrap
from planners.types import Floats
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry


def turned_by_place(run: Run) -> Run:
    """Return the run as a camera sees it whose sense of direction depends on the place."""
    poses = run.poses.copy()
    poses[:, 2] += 0.045 * np.sin(2.0 * poses[:, 0]) * np.cos(1.7 * poses[:, 1])
    return replace(run, poses=poses)


def bent_by_place(run: Run) -> Run:
    """Return the run as a camera with a distorted lens sees it: 8 cm at the corner of what was driven."""
    poses, off = run.poses.copy(), run.poses[:, :2] - run.poses[:, :2].mean(axis=0)
    poses[:, :2] += 0.08 * off * (off**2).sum(axis=1, keepdims=True) / np.abs(off).max() ** 3
    return replace(run, poses=poses)


def turned_by_iron(run: Run) -> Run:
    """Return the run as an odometry reports it whose heading is of a compass beside iron, up to 4 degrees off."""
    odometry = run.odometry.copy()
    odometry[:, 2] = wrap(odometry[:, 2] + 0.07 * np.sin(np.unwrap(run.odometry[:, 2]) - 0.8))
    return replace(run, odometry=odometry)


def worn_half_way(run: Run, at: float = 35.0) -> Run:
    """Return the run as wheels report it that lose 6 % of their radius at 35 s, or at another time [s]."""
    grown = np.where(run.odom_stamps > at, 1.06, 1.0)[:, None]
    odometry = run.odometry.copy()
    step = np.diff(odometry[:, :2], axis=0, prepend=0.0)
    turn = np.asarray(wrap(np.diff(odometry[:, 2], prepend=0.0)))
    phi = np.cumsum(turn * grown[:, 0])
    angle = np.cumsum(turn * (grown[:, 0] - 1.0)) - turn * (grown[:, 0] - 1.0) / 2
    c, s = np.cos(angle), np.sin(angle)
    moved = np.stack([c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]], axis=1) * grown
    odometry = np.column_stack([np.cumsum(moved, axis=0), wrap(phi)])
    return replace(run, odometry=odometry, odom_twists=run.odom_twists * grown)


def with_wheels(run: Run, left: Floats | float, right: Floats | float) -> Run:
    """Return the run as wheels report it that read so many times (n,) what they roll."""
    (v, omega), base = run.odom_twists.T, ROBOT.wheels.base
    at_left, at_right = (v - base / 2 * omega) * left, (v + base / 2 * omega) * right
    return reported(run, (at_left + at_right) / 2, (at_right - at_left) / base)


def out_of_round(run: Run) -> Run:
    """Return the run of which the right wheel sits 6 % of its radius off its axle."""
    v, omega = run.odom_twists.T
    way = np.cumsum(v + ROBOT.wheels.base / 2 * omega) * np.gradient(run.odom_stamps)
    return with_wheels(run, 1.0, 1 + 0.06 * np.cos(way / ROBOT.wheels.radius))


def losing_air(run: Run) -> Run:
    """Return the run of which one tyre loses 6 % of its radius bit by bit."""
    return with_wheels(run, 1.0, 1 + 0.06 * run.odom_stamps / run.odom_stamps[-1])


def loaded_for_a_while(run: Run) -> Run:
    """Return the run of a robot that carries something from 22 s to 58 s, more on its left."""
    loaded = (run.odom_stamps > 22) & (run.odom_stamps < 58)
    return with_wheels(run, 1 + 0.06 * loaded, 1 + 0.015 * loaded)


def scrubbing(run: Run) -> Run:
    """Return the run of wide tyres, which turn the body less the tighter it turns."""
    v, omega = run.odom_twists.T
    at_rim = np.abs(omega) * ROBOT.wheels.base / 2
    return reported(run, v, omega * (1 + 0.12 * (at_rim / (at_rim + np.abs(v) + 1e-6)) ** 2))


def slewed(run: Run) -> Run:
    """Return the run of a base whose clock runs off by 0.15 s and is pulled back, every 16 s."""
    late = 0.15 * np.abs((run.odom_stamps / 8) % 2 - 1)
    v, omega = (np.interp(run.odom_stamps - late, run.odom_stamps, c) for c in run.odom_twists.T)
    return reported(run, v, omega)


def spinning(run: Run) -> Run:
    """Return the run of a body that is carried by two wheels, of which each loses a quarter while it gains speed."""
    way = run.odom_twists * np.gradient(run.odom_stamps)[:, None]
    sides = way[:, :1] + np.array([-1.0, 1.0]) * ROBOT.wheels.base / 2 * way[:, 1:]
    speed = np.apply_along_axis(np.convolve, 0, sides, np.ones(5) / 5, mode="same")
    gains = np.gradient(speed, axis=0) * np.sign(speed) > 1e-4
    lost = 0.25 * sides * gains
    back = np.stack([lost.mean(axis=1), (lost[:, 1] - lost[:, 0]) / ROBOT.wheels.base], axis=1)
    along, turned = (np.interp(run.pose_stamps, run.odom_stamps, np.cumsum(c)) for c in back.T)
    true = np.unwrap(run.poses[:, 2])
    phi = true - turned
    x, y = run.poses[:, :2].T
    dx, dy = np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0])
    step = dx * np.cos(true) + dy * np.sin(true) - np.diff(along, prepend=0.0)
    poses = np.column_stack([np.cumsum(step * np.cos(phi)), np.cumsum(step * np.sin(phi)), wrap(phi)])
    return replace(run, poses=poses)


def turning_at_rest(run: Run) -> Run:
    """Return the run of an odometry that turns by a gyro, whose bias grows to 0.6°/s."""
    v, omega = run.odom_twists.T
    return reported(run, v, omega + 0.01 * (1 - np.exp(-run.odom_stamps / 30)))


def sliding_at_speed(run: Run) -> Run:
    """Return the run as wheels report it that turn the body a quarter less at 0.4 m/s than in place."""
    v, omega = run.odom_twists.T
    return reported(run, v, omega * (1 + 2.0 * v**2))


@pytest.mark.parametrize(
    ("distort", "said"),
    [
        (turning_at_rest, "continues at rest"),
        *further(
            (out_of_round, "repeats with every turn of a wheel"),
            (turned_by_place, "yaw error of the reference"),
            (worn_half_way, "changes once"),
            (scrubbing, "in tight turns"),
            (slewed, "clock offset that changes"),
            (sliding_at_speed, "depends on speed"),
            (spinning, "differ by"),
            (bent_by_place, "reference"),
            (turned_by_iron, "depends on the heading"),
            (losing_air, "loses air"),
            (loaded_for_a_while, "a scale"),
        ),
    ],
    ids=[
        "turns at rest",
        "out of round",
        "turned by place",
        "worn half-way",
        "scrubbing",
        "slewed clock",
        "slides at speed",
        "wheels that spin",
        "bent by place",
        "compass",
        "losing air",
        "loaded",
    ],
)
def test_what_no_effect_makes_is_unknown(distort: Callable[[Run], Run], said: str) -> None:
    result = diagnose_odometry(distort(make_run(11, duration=80.0)), ROBOT)
    assert result.unknown is not None and said in result.unknown.statement
    assert result.unknown.deviation is not None
    assert f"(log Bayes factor {result.unknown.statistic:.0f})" in result.unknown.deviation.sentence()
    assert not {a.name for a in result.effects} & {"wheel_slip", "wheel_base", "wheel_radius_diff"}


@pytest.mark.parametrize(("seed", "at"), [(11, 52.6), *further((13, 52.6), (14, 37.3))])
def test_wheels_that_wear_where_the_robot_was_not_before_are_no_slippery_patch(seed: int, at: float) -> None:
    result = diagnose_odometry(worn_half_way(make_run(seed, duration=80.0), at), ROBOT)
    assert result.effects == () and result.unknown is not None
    moment = re.search(r"changes once, after (\d+) s", result.unknown.statement)
    assert moment is not None and abs(float(moment[1]) - at) <= 2.0


@pytest.mark.slow
def test_what_the_odometry_shows_is_not_said_again_of_the_motors() -> None:
    run = worn_half_way(make_run(11, duration=80.0))
    odometry = diagnose_odometry(run, ROBOT)
    assert odometry.motion is not None
    assert diagnose_drive(run, ROBOT).unknown is not None
    assert diagnose_drive(run, ROBOT, wheels=odometry.motion).unknown is None
