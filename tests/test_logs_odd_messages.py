"""Scans whose angles contradict each other, scans that a driver repeats, and orientations that are none."""

from __future__ import annotations

import re
import struct
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import HUMBLE, Message, odometry, pose, read, scan, transform, write_bag2

import logs
import sensorgraph as sg
from logs.notes import assumptions_of
from logs.ros.bearings import bend
from logs.run_warnings import warnings_of
from logs.stream import McapStream, open_log
from logs.transforms import are_oriented
from sensorgraph.errors import SensorgraphError

N = 120


def room(x: float, seed: int) -> np.ndarray:
    """Return the ranges (N,) of a full turn at (x, 1.1) in a room of 6 by 4 m, with 1 cm of noise."""
    angles = -np.pi + 2 * np.pi / N * np.arange(N)
    with np.errstate(divide="ignore"):
        along_x = (np.where(np.cos(angles) > 0, 6.0, 0.0) - x) / np.cos(angles)
        along_y = (np.where(np.sin(angles) > 0, 4.0, 0.0) - 1.1) / np.sin(angles)
    noise = 0.01 * np.random.default_rng(seed).normal(size=N)
    return np.minimum(np.abs(along_x), np.abs(along_y)) + noise


def drive(
    *,
    increment: float = 2 * np.pi / N,
    stuck: range = range(0),
    speed: float = 0.5,
    n: int = 30,
    held: int = 1,
) -> list[Message]:
    """Return a drive along x; the scans in `stuck` repeat the one before, and each is repeated until `held` are there."""
    out = [transform(0.0, "base_link", "laser", 0, 0, 0, static=True)]
    for i in range(n):
        k = stuck[0] - 1 if i in stuck else i - i % held
        out.append(scan(i / 10, room(1 + speed * k / 10, k), angle_min=-np.pi, increment=increment))
        out.append(odometry(i / 10, speed * i / 10, 0, 0, speed, omega=0.0))
    return out


def with_angles(bag: list[Message], **angles: float) -> list[Message]:
    """Return the messages with other angles in the scans."""
    out = []
    for topic, kind, at, data in bag:
        if topic == "/scan":
            whole = HUMBLE.deserialize_cdr(data, kind)
            for name, value in angles.items():
                setattr(whole, name, value)
            data = bytes(HUMBLE.serialize_cdr(whole, kind))
        out.append((topic, kind, at, data))
    return out


TRUE = {"angle_max": np.pi - 2 * np.pi / N}


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_straight_surfaces_decide_between_a_wrong_increment_and_the_last_bearing(
    factor: float, tmp_path: Path
) -> None:
    bag = with_angles(drive(increment=factor * 2 * np.pi / N), **TRUE)
    run = read(tmp_path, bag)
    np.testing.assert_allclose(run.sensor.bearings, -np.pi + 2 * np.pi / N * np.arange(N), atol=1e-5)
    assert any("surfaces are straight with the step" in note for note in assumptions_of(run))


@pytest.mark.parametrize("end", [0.0, 2 * np.pi])
def test_a_right_increment_is_kept_and_the_wrong_last_bearing_noted(end: float, tmp_path: Path) -> None:
    run = read(tmp_path, with_angles(drive(), angle_max=end))
    np.testing.assert_allclose(np.diff(run.sensor.bearings), 2 * np.pi / N, atol=1e-5)
    assert any("the increment was used" in note for note in assumptions_of(run))


def test_a_last_bearing_that_is_a_step_off_is_not_worth_a_note(tmp_path: Path) -> None:
    assert assumptions_of(read(tmp_path, with_angles(drive(), angle_max=np.pi))) == []


def test_a_log_with_contradictory_angles_is_not_read_in_pieces(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", with_angles(drive(increment=np.pi / N), **TRUE))
    (file,) = bag.glob("*.mcap")
    assert not isinstance(open_log(file), McapStream)
    (file,) = write_bag2(tmp_path / "good", drive()).glob("*.mcap")
    assert isinstance(open_log(file), McapStream)


def test_a_bend_needs_returns() -> None:
    assert bend(np.full((2, 9), np.inf), np.arange(9.0)) == np.inf


def test_angles_that_are_not_finite_cost_their_scans(tmp_path: Path) -> None:
    good = drive()
    broken = with_angles(good, angle_min=np.nan)
    with pytest.raises(logs.LogError, match="no scan has a finite angle_min"):
        read(tmp_path / "all", broken)
    run = read(tmp_path / "some", broken[:10] + good[10:])
    assert run.n_scans == sum(one[0] == "/scan" for one in good[10:])
    assert any("whose angle_min is not finite were left out" in note for note in assumptions_of(run))
    run = read(tmp_path / "step", with_angles(good, angle_increment=np.nan, **TRUE))
    np.testing.assert_allclose(np.diff(run.sensor.bearings), 2 * np.pi / N, atol=1e-5)


def test_scans_that_a_driver_repeats_while_the_robot_moves_state_nothing(tmp_path: Path) -> None:
    run = read(tmp_path, drive(stuck=range(10, 20)))
    assert np.isnan(run.ranges[10:20]).all()
    assert np.isfinite(run.ranges[[*range(10), *range(20, 30)]]).all()
    assert any(note.startswith("10 scans repeat the one before") for note in assumptions_of(run))


def test_a_driver_that_repeats_most_scans_leaves_those_that_were_measured(tmp_path: Path) -> None:
    run = read(tmp_path, drive(n=36, held=3))
    assert np.isfinite(run.ranges).all(axis=1).tolist() == 12 * [True, False, False]


def test_a_laser_that_measures_once_gives_no_poses(tmp_path: Path) -> None:
    run = read(tmp_path, drive(n=36, held=36))
    assert np.isfinite(run.ranges).all(axis=1).sum() == 1
    with pytest.raises(SensorgraphError, match=r"only 1 of the 36 scans have returns.*the driver was stuck"):
        sg.locate(run)


@pytest.mark.parametrize("time_increment", [np.nan, np.inf])
def test_a_time_increment_that_is_not_finite_is_none(time_increment: float, tmp_path: Path) -> None:
    bag = with_angles(drive(), time_increment=time_increment, scan_time=np.nan)
    run = read(tmp_path, bag)
    assert run.sensor.sweep_time == 0
    assert any("time_increment" in note and "0 was used" in note for note in assumptions_of(run))


@pytest.mark.parametrize("stuck", [0.0, np.nan])
def test_odometry_that_fills_in_only_its_twist_is_integrated(stuck: float, tmp_path: Path) -> None:
    scans = [one for one in drive() if one[0] == "/scan"]
    wheels = [odometry(i / 20, stuck, stuck, 0.0, v=0.4) for i in range(61)]  # turns by 0.5 rad/s
    run = read(tmp_path, [*scans, *wheels])
    radius, turn = 0.4 / 0.5, 1.5
    np.testing.assert_allclose(
        run.odometry[-1], [radius * np.sin(turn), radius * (1 - np.cos(turn)), turn], atol=1e-6
    )
    assert any("the twist was integrated" in note for note in assumptions_of(run))
    alone = read(tmp_path / "pose", [*scans, *(odometry(i / 20, 0.02 * i, 0, 0) for i in range(61))])
    np.testing.assert_allclose(alone.odometry[-1], [1.2, 0, 0], atol=1e-6)


def test_twists_are_integrated_with_their_sideways_part_and_without_a_lag(tmp_path: Path) -> None:
    scans = [one for one in drive() if one[0] == "/scan"]
    at = np.arange(61) / 20
    wheels = [odometry(t, 0, 0, 0, v=0.3, left=-0.4, omega=0.0) for t in at]
    run = read(tmp_path, [*scans, *wheels])
    np.testing.assert_allclose(run.odometry[-1], [0.9, -1.2, 0.0], atol=1e-6)
    faster = [odometry(t, 0, 0, 0, v=0.2 * t, omega=0.0) for t in at]
    run = read(tmp_path / "faster", [*scans, *faster])
    np.testing.assert_allclose(run.odometry[:, 0], 0.1 * at**2, atol=1e-6)


def test_a_reference_that_stopped_is_noticed_by_the_odometry(tmp_path: Path) -> None:
    stuck = [pose(i / 10, 1 + 0.5 * min(i, 10) / 10, 0, 0) for i in range(30)]
    run = read(tmp_path, [*drive(), *stuck])
    assert any(
        "the place of the pose stays the same for 1.9 s from 1.0 s while" in w for w in warnings_of(run)
    )
    odometry_with_gaps = run.odometry.copy()
    odometry_with_gaps[5::7] = np.nan, np.inf, 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        said = warnings_of(replace(run, odometry=odometry_with_gaps))
    assert any("the place of the pose stays the same for 1.9 s" in w for w in said)
    alive = [pose(i / 10, 1 + 0.5 * i / 10, 0, 0) for i in range(30)]
    assert not any("stays the same" in w for w in warnings_of(read(tmp_path / "alive", [*drive(), *alive])))


@pytest.mark.parametrize(
    ("factor", "words"), [(1000, "looks like millimetres"), (100, "looks like centimetres")]
)
def test_ranges_in_another_unit_than_range_max_are_named(factor: float, words: str, tmp_path: Path) -> None:
    bag = [
        scan(i / 10, factor * room(1 + i / 20, i), angle_min=-np.pi, increment=2 * np.pi / N)
        for i in range(12)
    ]
    run = read(tmp_path, bag)
    assert any(
        re.search(f"the median reading .* is beyond range_max 10 m and {words}", s)
        for s in assumptions_of(run)
    )
    with pytest.raises(SensorgraphError, match=f"beyond range_max 10 m and {words}"):
        sg.locate(run)
    coded = [scan(i / 10, np.where(room(1, i) > 1.2, 65.535, 1.0)) for i in range(12)]
    assert not any("looks like" in text for text in assumptions_of(read(tmp_path / "coded", coded)))


def test_a_range_min_above_most_readings_is_not_used(tmp_path: Path) -> None:
    bag = [
        scan(i / 10, room(1 + i / 20, i), increment=0.05, range_min=11.1, range_max=101.1) for i in range(12)
    ]
    run = read(tmp_path, bag)
    assert np.isfinite(run.ranges).all() and run.sensor.range_min == 0
    assert "100 % of the readings are below range_min 11.1 m: 0 was used" in assumptions_of(run)
    near = read(tmp_path / "near", [scan(i / 10, [0.2, 0.05, 1, 2, 3]) for i in range(12)])
    assert np.isneginf(near.ranges[:, 1]).all() and not assumptions_of(near)[1:]


def test_equal_scans_of_a_robot_that_stands_are_kept(tmp_path: Path) -> None:
    run = read(tmp_path, drive(stuck=range(10, 20), speed=0.0))
    assert np.isfinite(run.ranges).all()
    assert assumptions_of(run) == []


def test_equal_scans_without_motion_in_the_log_are_noted(tmp_path: Path) -> None:
    bag = [one for one in drive(stuck=range(10, 20)) if one[0] != "/odom"]
    run = read(tmp_path, bag)
    assert np.isfinite(run.ranges).all()
    assert any(note.startswith("10 scans in a row are equal") for note in assumptions_of(run))


def test_a_yaw_in_the_z_of_a_quaternion_is_no_orientation(tmp_path: Path) -> None:
    out = []
    for topic, kind, at, data in drive():
        if topic == "/odom":
            whole = HUMBLE.deserialize_cdr(data, kind)
            whole.pose.pose.orientation.z, whole.pose.pose.orientation.w = whole.pose.pose.position.x, 1.0
            data = bytes(HUMBLE.serialize_cdr(whole, kind))
        out.append((topic, kind, at, data))
    run = read(tmp_path, out)
    assert any("have no orientation (quaternions of changing norm)" in note for note in assumptions_of(run))
    assert (run.odometry[:, 2] == 0).all()


def test_scaled_and_rounded_quaternions_are_orientations_and_a_single_wrong_one_is_none() -> None:
    yaw = np.linspace(-3, 3, 40)
    unit = np.column_stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)])
    assert are_oriented(unit).all()
    assert are_oriented(2.5 * unit).all()
    assert are_oriented(unit.round(2)).all()
    unit[3] *= 4
    unit[5] = 0
    assert np.flatnonzero(~are_oriented(unit)).tolist() == [3, 5]


def test_a_static_transform_with_two_values_and_one_without_orientation_are_noted(tmp_path: Path) -> None:
    again = transform(1.0, "base_link", "laser", 0.3, 0, 0, static=True)
    said = assumptions_of(read(tmp_path / "two", [*drive(), again]))
    assert said == ["static transform base_link -> laser has 2 different values: the last one was used"]
    topic, kind, at, data = transform(0.0, "base_link", "laser", 0.3, 0, 0, static=True)
    assert data.endswith(struct.pack("<4d", 0, 0, 0, 1))
    none = (topic, kind, at, data[:-32] + bytes(32))
    said = assumptions_of(read(tmp_path / "none", [none, *drive()[1:]]))
    assert any(
        "/tf_static base_link -> laser: 1 of 1 transforms are not finite or have no" in s for s in said
    )


def test_scans_from_which_a_filter_removed_readings_are_refused(tmp_path: Path) -> None:
    bag = []
    for k in range(30):
        ranges = room(1 + 0.05 * k, k)
        bag.append(scan(k / 10, ranges[ranges < 2.5 + 0.05 * k], angle_min=-np.pi, increment=2 * np.pi / N))
    full = with_angles(bag, angle_max=np.pi - 2 * np.pi / N)
    with pytest.raises(
        logs.LogError, match=r"scans hold \d+ to \d+ readings, but their angles state 120 rays: a filter"
    ):
        read(tmp_path, full)


def test_a_laser_whose_speed_varies_is_read(tmp_path: Path) -> None:
    bag = [
        scan(k / 10, np.full(N - 6 + k % 7, 2.0), angle_min=-np.pi, increment=2 * np.pi / N)
        for k in range(30)
    ]
    assert read(tmp_path, with_angles(bag, angle_max=np.pi)).n_scans == 30
