"""Several sensors are read as one: sonars of many topics or frames, and lasers at the front and at the rear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import (
    RING,
    pose,
    read,
    ring,
    scan,
    transform,
    write_bag2,
)

import logs
import logs.motion
import sensorgraph as sg
from sensorgraph.cli import run as cli


@pytest.mark.parametrize("one_topic", [False, True])
def test_sonars_of_several_topics_or_frames_are_one_sensor_with_a_mount_for_each_ray(
    one_topic: bool, tmp_path: Path
) -> None:
    run = read(tmp_path, ring(one_topic=one_topic))
    order = [3, 0, 1, 2]  # by bearing: -90, 0, 90, 180 degrees
    np.testing.assert_allclose(run.sensor.bearings, np.radians([-90, 0, 90, 180]), atol=1e-6)
    np.testing.assert_allclose(run.sensor.origins, np.array(RING)[order, :2], atol=1e-6)
    np.testing.assert_allclose(run.sensor.cones, 0.1 * (np.array(order) + 1), atol=1e-6)
    np.testing.assert_array_equal(run.sensor.mount, 0)
    assert (run.sensor.rate, run.sensor.range_max) == (pytest.approx(20), 8.0)
    for column, k in enumerate(order):
        mine = np.isfinite(run.ranges[:, column])
        np.testing.assert_allclose(run.stamps[mine], 0.05 * (k + 1) * np.arange(8), atol=1e-9)
        np.testing.assert_allclose(run.ranges[mine, column], 1 + k + np.arange(8) / 10, atol=1e-6)
    assert np.isnan(run.ranges[~np.isfinite(run.ranges)]).all(), "a sensor that did not measure says nothing"
    assert run.pose_frame == "base_link" and len(run.poses) == 5
    for name in ("run.mcap", "run.csv"):
        logs.write(run, tmp_path / name)
        again = logs.read(tmp_path / name)
        for field in ("bearings", "origins", "cones", "mount"):
            np.testing.assert_array_equal(getattr(again.sensor, field), getattr(run.sensor, field))
        np.testing.assert_array_equal(again.ranges, run.ranges)


def test_sonars_without_transforms_sit_where_robot_yaml_says(tmp_path: Path) -> None:
    path = write_bag2(tmp_path / "bag", [m for m in ring() if m[0] != "/tf_static"])
    with pytest.raises(
        logs.LogError, match=r"the mounts of /sonar/0 in sonar_0, .* are unknown; record /tf_static"
    ):
        logs.read(path)
    entries = [
        f"  - {{name: {name}, mount: [{x}, {y}, {yaw}]}}"
        for name, (x, y, yaw) in zip(["/sonar/0", "sonar_1", "/sonar/2", "sonar_3"], RING, strict=True)
    ]  # by topic or by frame
    (tmp_path / "robot.yaml").write_text("\n".join(["sensors:", *entries]))
    run = sg.read(path, robot=tmp_path / "robot.yaml")
    np.testing.assert_allclose(run.sensor.origins, np.array(RING)[[3, 0, 1, 2], :2], atol=1e-12)
    assert cli(["inspect", str(path), "--robot", str(tmp_path / "robot.yaml")]) == 0
    assert cli(["inspect", str(path)]) == 0, "what cannot be a run is still described"


def test_some_sonars_are_chosen_by_name_or_pattern(tmp_path: Path) -> None:
    path = write_bag2(tmp_path / "bag", ring())
    one = logs.read(path, topics={"scan": "/sonar/2"})
    np.testing.assert_allclose(one.sensor.mount, [-0.2, 0, np.pi], atol=1e-6)
    assert one.ranges.shape == (8, 1) and one.sensor.cones.tolist() == [pytest.approx(0.3)]
    assert logs.read(path, topics={"scan": "/sonar/[01]"}).sensor.n_rays == 2
    assert logs.read(path, topics={"scan": "sonar/1,sonar/3"}).sensor.n_rays == 2
    with pytest.raises(logs.LogError, match=r"scan=/sonar/9 is not a topic"):
        logs.read(path, topics={"scan": "/sonar/9"})


def test_front_and_rear_laser_are_chosen_or_read_as_one(tmp_path: Path) -> None:
    bag = [
        transform(0, "base_link", "front", 0.3, 0, 0, static=True),
        transform(0, "base_link", "rear", -0.3, 0, np.pi, static=True),
    ]
    for i in range(5):
        bag.append(scan(0.1 * i, [1, 2, 3, 4, 5], topic="/front", frame="front"))
        bag.append(scan(0.1 * i + 0.03, [6, 7, 8, 9, 9.5], topic="/rear", frame="rear"))
        bag.append(pose(0.1 * i, 0.1 * i, 0, 0))
    path = write_bag2(tmp_path / "bag", bag)
    with pytest.raises(logs.LogError, match=r"2 scan topics; select one with .*scan=/front,/rear"):
        logs.read(path)
    front = logs.read(path, topics={"scan": "/front"})
    assert front.ranges.shape == (5, 5)
    both = logs.read(path, topics={"scan": "/front,/rear"})
    assert both.ranges.shape == (10, 10), "each scan at its own time"
    np.testing.assert_allclose(both.stamps[:3], [0, 0.03, 0.1], atol=1e-9)
    ahead = np.abs(both.sensor.bearings) < 1
    np.testing.assert_allclose(both.sensor.origins[:, 0], np.where(ahead, 0.3, -0.3), atol=1e-6)
    np.testing.assert_allclose(both.sensor.bearings[ahead], front.sensor.bearings, atol=1e-6)
    np.testing.assert_array_equal(both.ranges[::2][:, ahead], front.ranges)
    assert np.isnan(both.ranges[::2][:, ~ahead]).all() and np.isnan(both.ranges[1::2][:, ahead]).all()
    back = np.flatnonzero(~ahead)
    at = both.sensor.bearings[back] % (2 * np.pi) - np.pi  # in the rear laser's frame
    np.testing.assert_allclose(
        both.ranges[1][back], np.interp(at, [-0.5, -0.25, 0, 0.25, 0.5], [6, 7, 8, 9, 9.5]), atol=1e-5
    )


def test_rays_of_several_sweeping_lasers_keep_their_times(tmp_path: Path) -> None:
    bag = [
        transform(0, "base_link", "front", 0.3, 0, 0, static=True),
        transform(0, "base_link", "rear", -0.3, 0, np.pi, static=True),
    ]
    for i in range(5):
        bag.append(scan(0.1 * i, [1, 2, 3, 4, 5], topic="/front", frame="front", time_increment=0.01))
        rear = scan(0.1 * i, [6, 7, 8, 9, 9], topic="/rear", frame="rear", time_increment=-0.02)
        bag += [rear, pose(0.1 * i, 0.5 * i, 0, 0)]
    run = read(tmp_path, bag, scan="/front,/rear")
    ahead = np.abs(run.sensor.bearings) < 1
    place = np.where(
        ahead, run.sensor.bearings, run.sensor.bearings % (2 * np.pi) - np.pi
    )  # -0.5 to 0.5 in each
    index = np.rint((place + 0.5) / 0.25)
    delays = np.where(ahead, 0.01, -0.02) * index
    np.testing.assert_allclose(run.sensor.ray_delays, delays, atol=1e-8)
    assert run.sensor.scan_duration == pytest.approx(0.12)
    paired = logs.pair(run)
    starts = logs.motion.ray_poses(run, paired, np.array([2]))
    np.testing.assert_allclose(starts[0, :, 0], 1 + 5 * delays + np.where(ahead, 0.3, -0.3), atol=1e-6)
    some = run.sensor.take(np.flatnonzero(ahead))
    np.testing.assert_allclose(some.ray_delays, delays[ahead], atol=1e-8)
    for name in ("run.mcap", "run.csv"):
        logs.write(run, tmp_path / name)
        np.testing.assert_array_equal(logs.read(tmp_path / name).sensor.delays, run.sensor.delays)


def test_driver_that_was_started_again_with_another_frame_is_one_laser(tmp_path: Path) -> None:
    bag = [
        transform(0, "base_link", frame, 0.3, 0.1, yaw, static=True)
        for frame, yaw in (("laser", 0.2), ("laser_link", 0.2), ("rear", np.pi))
    ]
    for i in range(8):
        frame = "laser" if i < 5 else "laser_link"
        bag.append(scan(0.1 * i, [1 + i, 2, 3, 4, 5], frame=frame, time_increment=0.01))
    run = read(tmp_path, bag)
    assert not run.sensor.is_composite and run.sensor.sweep_time == pytest.approx(0.05)
    np.testing.assert_allclose(run.sensor.mount, [0.3, 0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(run.ranges[:, 0], 1 + np.arange(8), atol=1e-6)
    assert "/scan in laser_link is the same laser under another name" in run.meta["notes"]
    bag.append(
        scan(0.9, [1, 2, 3, 4, 5], frame="rear", time_increment=0.01)
    )  # at the same place, but it looks back
    both = logs.read(write_bag2(tmp_path / "both", bag))
    assert both.sensor.is_composite and both.sensor.n_rays == 10


@pytest.mark.parametrize("first", [-2.0, -90.0, 0.0])
def test_bearings_in_degrees_are_converted(tmp_path: Path, first: float) -> None:
    n = 60
    bag = [scan(0.1 * i, np.arange(1, n + 1) / 10, angle_min=first, increment=1.5) for i in range(4)]
    run = read(tmp_path, bag)
    np.testing.assert_allclose(run.sensor.bearings, np.radians(first + 1.5 * np.arange(n)), atol=1e-6)
    assert f"/scan: the bearings are in degrees, from {first:g} to {first + 88.5:g}" in run.meta["notes"]
    turns = [
        scan(0.1 * i, np.ones(300), angle_min=0, increment=0.025) for i in range(4)
    ]  # 1.2 turns in radians
    assert "degrees" not in logs.read(write_bag2(tmp_path / "turns", turns)).meta["notes"]
