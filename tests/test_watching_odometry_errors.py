"""The filter of wheels, mount and clock on drives that the tests make: its standard errors, whatever the noise of a robot."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further
from localization_samples import loop_poses, room_run
from watching_samples import believing, graph

from logs.transforms import compose, invert, wrap
from sensorgraph.types import Floats
from sensorgraph.watching.observation import observations
from sensorgraph.watching.odometry_errors import UNKNOWN_FLOOR, OdometryErrors
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.robot import RobotHealth
from sensorgraph.watching.settings import DISTANCE_FAULTS
from sensorgraph.watching.watcher import Watcher

WHEEL, MOUNT_YAW, LATENCY = 0, 3, len(DISTANCE_FAULTS) - 1


def estimates_of_a_minute(seed: int, *, noise: float, jitter: float = 0.03) -> tuple[Floats, Floats]:
    """Drive for a minute, with `noise` times 15 mm and 8 mrad after one metre, and stamps with an error [s]."""
    rng = np.random.default_rng(seed)
    found, pose, twist = OdometryErrors(), np.zeros(3), np.zeros(2)
    for k in range(300):
        if k % 15 == 0:
            twist = np.array([rng.uniform(0.2, 0.7), rng.uniform(-0.8, 0.8)])
        step = 0.2 * np.array([twist[0], 0.0, twist[1]])
        deviations = np.array([0.015, 0.008, 0.008]) * noise * np.sqrt(step[0])
        pose = compose(pose, step + deviations * rng.normal(size=3))
        early = jitter * rng.normal() * np.array([twist[0], 0.0, twist[1]])
        tracked = compose(pose, early) + np.array([0.005, 0.005, 0.008]) * rng.normal(size=3)
        found.add(step, twist, tracked)
    return found.estimates()


@pytest.mark.parametrize("noise", [0.3, *further(1.0), 3.0])
def test_the_standard_error_of_the_wheels_is_that_of_the_robot_at_hand(noise: float) -> None:
    drives = [estimates_of_a_minute(seed, noise=noise) for seed in range(12)]
    values, errors = (np.array(column)[:, WHEEL] for column in zip(*drives, strict=True))
    ratio = np.mean((values / errors) ** 2)
    assert 0.2 < ratio < 2.2  # chi² of 12 drives over 12, at 0.1 % and 99 %
    length = 60 * 0.45
    assert np.median(errors) < 2.0 * max(0.015 * noise / np.sqrt(length), 0.0005) + 0.0015


def test_an_error_of_each_stamp_hides_no_error_of_the_wheels() -> None:
    """It scatters the poses along the motion by centimetres, but does not add up over the way."""
    exact, scattered = (
        estimates_of_a_minute(1, noise=0.3, jitter=jitter)[1][WHEEL] for jitter in (0.0, 0.03)
    )
    assert scattered < 2.0 * exact
    assert scattered < 0.003


def drive_on_a_drifting_floor(headings: Floats, drift: tuple[float, float], seed: int = 0) -> OdometryErrors:
    """Drive 10 m in each of some directions over a floor that moves the robot by `drift` [m/m] along x and y of map."""
    rng = np.random.default_rng(seed)
    found, pose = OdometryErrors(), np.zeros(3)
    for heading in headings:
        turn = wrap(heading - pose[2])
        for step in [np.array([0.0, 0.0, turn / 10])] * 10 + [np.array([0.1, 0.0, 0.0])] * 100:
            pose = compose(pose, step)
            pose[:2] += step[0] * np.array(drift)
            found.add(step, step[[0, 2]] / 0.2, pose + np.array([0.005, 0.005, 0.008]) * rng.normal(size=3))
    return found


def test_a_floor_that_moves_the_robot_is_no_error_of_wheels_or_mount() -> None:
    """As the nap of a carpet does on the logs aces and intel, by 1 and 1.6 cm per metre."""
    found = drive_on_a_drifting_floor(np.array([0.0, 2.0, 4.0, 1.0, 5.0, 3.0]), (0.012, -0.008))
    values, errors = found.estimates()
    assert abs(values[WHEEL]) < 3 * errors[WHEEL] and abs(values[MOUNT_YAW]) < 3 * errors[MOUNT_YAW]
    assert errors[WHEEL] < 0.003 and errors[MOUNT_YAW] < 0.003
    np.testing.assert_allclose(found.floor()[0], [0.012, -0.008], atol=0.002)


def test_a_drive_in_one_direction_does_not_tell_the_wheels_from_the_floor() -> None:
    one_way, all_ways = (
        drive_on_a_drifting_floor(headings, (0.0, 0.0)).estimates()[1][WHEEL]
        for headings in (np.zeros(6), np.array([0.0, 2.0, 4.0, 1.0, 5.0, 3.0]))
    )
    assert one_way > 0.9 * UNKNOWN_FLOOR.tolerance
    assert all_ways < 0.3 * one_way


def test_a_late_scan_is_found_where_a_log_stamps_its_messages_in_pairs() -> None:
    """From one message to the next, such a robot seems to drive at hundreds of times its speed or to stand."""
    health = RobotHealth(GraphReadings(graph(), graph().sensor))
    rng, pose, odometry, last = np.random.default_rng(5), np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(300):
        twist = np.array([0.4 + 0.2 * np.sin(0.1 * k), 0.0, 0.6 * np.sin(0.07 * k)])
        pose = compose(pose, 0.2 * twist)
        odometry = compose(odometry, 0.2 * twist)
        tracked = compose(pose, 0.1 * twist) + np.array([0.005, 0.005, 0.008]) * rng.normal(size=3)
        health._add_motion(compose(invert(last), odometry), 0.001 if k % 2 else 0.399, tracked, 1.0)
        last = odometry
    values, errors = health.motion.older.estimates()
    assert values[LATENCY] == pytest.approx(0.1, abs=0.02)
    assert abs(values[LATENCY] - 0.1) < 4 * errors[LATENCY]


def test_after_a_gap_without_scans_the_wheels_are_judged_anew() -> None:
    """The way in the gap is no step of the odometry: as one that it misses, it would be an error of the wheels."""
    poses = loop_poses(60, laps=0.5)
    watcher = Watcher(graph())
    for k, one in enumerate(observations(believing(room_run(poses, seed=21), poses))):
        if 30 <= k < 41:
            continue
        watcher.add(one)
        if k in (29, 41, 45):
            assert watcher.robot.motion.older.has_pose == (k != 41)


@pytest.mark.parametrize(("slips", "names"), [(False, []), (True, ["wheel_slip"])])
def test_scans_with_wrong_stamps_are_no_fault_of_the_odometry_and_slip_is_one(
    slips: bool, names: list[str]
) -> None:
    """Each fifth scan is older than its stamp: one step is too short, and the next one too long."""
    health = RobotHealth(GraphReadings(graph(), graph().sensor))
    way = np.full(40, 0.03 if slips else 0.1)
    way[10::5] -= 0.08
    way[11::5] += 0.08
    for x in way:
        health._steps.append((np.array([0.1, 0.0, 0.01]), np.array([x, 0.0, 0.01])))
    assert [doubt.name for doubt in health._of_steps() if doubt.p > 0.5] == names


def test_more_scans_of_the_same_way_are_no_more_degrees_of_freedom() -> None:
    """A bump of the floor shows in each of them; only further driving shows whether it was one."""
    freedoms = []
    for n in (100, 400):
        found, pose, step = OdometryErrors(), np.zeros(3), np.array([10.0 / n, 0.0, 0.0])
        for _ in range(n + 1):
            found.add(step, np.array([0.5, 0.0]), pose)
            pose = compose(pose, step)
        freedoms.append(found.freedom)
    assert freedoms == pytest.approx([30.0 - len(DISTANCE_FAULTS)] * 2)
