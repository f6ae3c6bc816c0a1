"""The embedded robot: it keeps its limits, lags as told, drifts as told, follows its plan, stops at walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.run import RangeSensor
from planners.arena import Arena, wrap
from planners.trajectory import Trajectory
from planners.types import Floats
from sensorgraph.world.drive import TRUTH_STEP, ExecutedDrive, follow, odometry, replay
from sensorgraph.world.robot import Actuators, PoseReference, Robot, Wheels, default_robot
from sensorgraph.world.scene import Scene, apply_range_limits
from sensorgraph.world.simulate import scan_stamps, simulate
from sensorgraph.world.wall_distance import WallDistance


def nowhere_near(x: float, y: float) -> float:
    return np.inf


def quiet(robot: Robot) -> Robot:
    """Return the robot without any noise."""
    return replace(
        robot,
        sensor=replace(robot.sensor, sigma=0.0, resolution=0.0),
        pose=PoseReference(sigma_xy=0.0, sigma_yaw=0.0),
        wheels=Wheels(sigma_v=0.0, sigma_omega=0.0),
    )


def arc(v: float, omega: float, duration: float, start: tuple[float, float, float]) -> Trajectory:
    """Make a circle, driven from rest to rest with half the limits of acceleration."""
    t = np.arange(0, duration, 0.02)
    share = np.minimum(np.minimum(t / 2.0, 1.0), np.maximum((duration - 0.02 - t) / 2.0, 0.0))
    way = np.concatenate([[0], np.cumsum((share[1:] + share[:-1]) / 2 * 0.02)])
    phi = start[2] + omega * way
    step = v * np.diff(way) * np.sinc(omega * np.diff(way) / 2 / np.pi)
    middle = (phi[1:] + phi[:-1]) / 2
    x = start[0] + np.concatenate([[0], np.cumsum(step * np.cos(middle))])
    y = start[1] + np.concatenate([[0], np.cumsum(step * np.sin(middle))])
    return Trajectory(
        stamps=t,
        poses=np.column_stack([x, y, wrap(phi)]),
        twists=np.outer(share, [v, omega]),
        primitives=np.full(len(t), "move"),
    )


def steps(commands: list[tuple[float, float, float]], robot: Robot) -> ExecutedDrive:
    """Drive (stamp, v, omega) commands from the origin."""
    table = np.array(commands)
    return replay(table[:, 0], table[:, 1:], np.zeros(3), robot, clearance=nowhere_near)


@pytest.mark.parametrize("omega", [-0.6, 0.0, 0.6])
def test_it_follows_a_curve_to_a_centimetre(omega: float) -> None:
    robot = default_robot()
    plan = arc(0.3, omega, 20.0, (1.0, 2.0, 3.0))
    driven = follow(plan, robot, clearance=nowhere_near, rng=np.random.default_rng(0))
    want, _ = plan.at(driven.stamps)
    off = driven.poses - want
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.01
    assert np.abs(wrap(off[:, 2])).max() < 0.02


def test_commands_and_motion_keep_the_limits() -> None:
    robot = default_robot()
    wild = [(0.05 * k, 9.0 * (-1) ** (k // 40), 9.0 * (-1) ** (k // 23)) for k in range(400)]
    driven = steps(wild, robot)
    limits = robot.limits
    assert np.abs(driven.commands).max(axis=0).tolist() == [limits.v, limits.omega]
    rates = np.abs(np.diff(driven.twists, axis=0)) / TRUTH_STEP
    assert (rates <= np.array([limits.a, limits.alpha]) + 1e-9).all()
    assert (np.abs(driven.twists) <= [limits.v, limits.omega]).all()


def test_a_dubins_car_never_drives_backwards() -> None:
    robot = default_robot()
    car = replace(robot, drive="dubins", limits=replace(robot.limits, turning_radius=0.4))
    driven = steps([(0.0, -0.3, 0.0), (2.0, 0.2, 0.0), (4.0, -0.3, 0.0)], car)
    assert driven.twists[:, 0].min() >= 0


@pytest.mark.parametrize(("tau", "delay"), [(0.3, 0.0), (0.1, 0.2)])
def test_a_step_rises_after_the_dead_time_with_the_time_constant(tau: float, delay: float) -> None:
    robot = replace(default_robot(), actuators=Actuators(tau=tau, delay=delay))
    driven = steps([(0.0, 0.0, 0.1), (5.0, 0.0, 0.1)], robot)  # so small that alpha does not limit it
    t = driven.stamps
    expected = np.where(t > delay, 0.1 * (1 - np.exp(-(t - delay) / tau)), 0.0)
    np.testing.assert_allclose(driven.twists[t < 4.9, 1], expected[t < 4.9], atol=1e-9)


def test_without_noise_odometry_is_the_drive_itself() -> None:
    robot = quiet(default_robot())
    driven = follow(
        arc(0.3, 0.5, 15.0, (0.0, 0.0, 0.0)), robot, clearance=nowhere_near, rng=np.random.default_rng(0)
    )
    stamps, poses, _ = odometry(driven, robot, np.random.default_rng(1))
    truth = driven.at(stamps)
    assert np.abs(poses[:, :2] - truth[:, :2]).max() < 1e-3  # arcs of 50 ms against steps of 10 ms
    assert np.abs(wrap(poses[:, 2] - truth[:, 2])).max() < 1e-9


def test_odometry_drifts_as_its_noise_says() -> None:
    robot = replace(default_robot(), wheels=Wheels(sigma_v=0.02, sigma_omega=0.03))
    driven = steps([(0.0, 0.0, 0.0), (100.0, 0.0, 0.0)], robot)
    ends = np.array([odometry(driven, robot, np.random.default_rng(k))[1][-1] for k in range(200)])
    n, rate = 20 * 100.5, 20.0
    assert ends[:, 2].std() == pytest.approx(0.03 * np.sqrt(n) / rate, rel=0.2)
    assert abs(ends[:, 2].mean()) < 3 * ends[:, 2].std() / np.sqrt(200)


def test_the_body_stops_at_a_wall_while_the_wheels_turn(room: Arena) -> None:
    robot = quiet(default_robot())
    table = np.array([[0.0, 0.4, 0.0], [20.0, 0.4, 0.0]])
    driven = replay(table[:, 0], table[:, 1:], np.array([1.0, 2.2, 0.0]), robot, clearance=WallDistance(room))
    assert driven.contacts == 1
    assert driven.poses[-1, 0] == pytest.approx(4.0 - 0.2, abs=0.005)
    assert odometry(driven, robot, np.random.default_rng(0))[1][-1, 0] > 7.0


def test_wall_distance_is_exact_beside_a_wall_and_nearly_so_elsewhere(room: Arena) -> None:
    distance = WallDistance(room)
    assert distance(1.0, 0.21) == pytest.approx(0.21, abs=1e-9)
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 0], [4, 3], (500, 2))
    a, d = room.walls[:, 0], room.walls[:, 1] - room.walls[:, 0]
    share = np.clip(((points[:, None] - a) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    exact = np.linalg.norm(points[:, None] - a - share[..., None] * d, axis=-1).min(axis=1)
    assert np.abs([distance(*p) for p in points] - exact).max() < 0.02
    assert distance(-1.0, 1.0) == 0.0


def still(seconds: float, pose: tuple[float, float, float]) -> ExecutedDrive:
    t = np.arange(0, seconds + 1e-9, TRUTH_STEP)
    return ExecutedDrive(
        stamps=t, poses=np.tile(np.array(pose), (len(t), 1)), twists=np.zeros((len(t), 2)),
        cmd_stamps=np.zeros(0), commands=np.zeros((0, 2)), contacts=0,
    )  # fmt: skip


def test_noise_of_scans_and_poses_is_as_stated(room: Arena) -> None:
    robot = default_robot()
    run = simulate(still(60, (1.0, 1.5, 0.3)), room, robot, rng=np.random.default_rng(0))
    assert run.ranges.shape == (601, 181)
    assert run.ranges.std(axis=0).mean() == pytest.approx(robot.sensor.sigma, rel=0.03)
    np.testing.assert_allclose(run.ranges * 1000, np.round(run.ranges * 1000), atol=1e-6)
    assert run.poses.std(axis=0).tolist() == pytest.approx([0.002, 0.002, 0.0015], rel=0.06)
    assert run.pose_stamps[0] <= run.stamps[0]
    assert run.pose_stamps[-1] >= run.stamps[-1]


def test_readings_beyond_the_limits_become_infinite() -> None:
    sensor = RangeSensor(bearings=np.array([0.0, 1.0, 2.0, 3.0]), range_min=0.5, range_max=2.0, sigma=0.0)
    ideal = np.array([[0.4, 1.0, 2.1, np.inf]])
    assert apply_range_limits(ideal, sensor).tolist() == [[-np.inf, 1.0, np.inf, np.inf]]


def test_a_sweep_takes_every_ray_from_where_the_robot_then_is(room: Arena) -> None:
    """Turn at 1 rad/s: ray i of a swept scan equals ray i of a still scan taken at its own time."""
    t = np.arange(0, 2.0 + 1e-9, TRUTH_STEP)
    poses = np.column_stack([np.full_like(t, 1.0) + 0.1 * t, np.full_like(t, 1.2), 1.0 * t])
    driven = replace(still(2.0, (0, 0, 0)), poses=poses)
    sensor = RangeSensor(bearings=np.linspace(-1.5, 1.5, 31), sweep_time=0.2, mount=np.array([0.1, 0.0, 0.2]))
    stamps = scan_stamps(driven, sensor)
    assert stamps[-1] + sensor.sweep_time <= 2.0 + 1e-9

    def ideal(sensor: RangeSensor, stamps: Floats) -> Floats:
        return Scene(arena=room, sensor=sensor, stamps=stamps, motion=driven.at, span=2.0).run().ranges

    swept = ideal(sensor, stamps)
    for ray in (0, 7, 30):
        late: Floats = stamps + 0.2 * ray / 31
        at_its_time = ideal(replace(sensor, sweep_time=0.0), late)
        np.testing.assert_allclose(swept[:, ray], at_its_time[:, ray], rtol=0, atol=1e-9)
