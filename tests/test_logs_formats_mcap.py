"""MCAP: a run written is the run read, and ROS tools open the file unconfigured."""

from __future__ import annotations

import gc
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from logs_samples import assert_same_run, some_run
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import logs
from logs import OccupancyMap, RangeSensor, Run
from logs.stream import open_log
from logs.transforms import compose, interpolate

OCCUPANCY = OccupancyMap(
    data=np.array([[0, 100, -1], [0, 0, 100]], dtype=np.int8),
    resolution=0.05,
    origin=np.array([-1.0, 2.0, 0.0]),
)


def messages(path: Path) -> list[tuple[str, int, object]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(log_time_order=False)
        return [(channel.topic, message.log_time, decoded) for _, channel, message, decoded in found]


@pytest.mark.parametrize("pose_frame", ["base_link", "laser"])
@pytest.mark.parametrize("with_odometry", [True, False])
def test_run_written_is_run_read(tmp_path: Path, pose_frame: str, with_odometry: bool) -> None:
    run = some_run(pose_frame=pose_frame, with_odometry=with_odometry)
    logs.write(run, tmp_path / "run.mcap", occupancy=OCCUPANCY)
    assert_same_run(logs.read(tmp_path / "run.mcap"), run)


@pytest.mark.parametrize("epoch_ns", [0, 1, -5_000_000_000, 2_000_000_000_000_000_000])
def test_any_epoch_and_negative_stamps_come_back(tmp_path: Path, epoch_ns: int) -> None:
    run = some_run(epoch_ns=epoch_ns)
    shifted = Run(
        **{
            **{name: getattr(run, name) for name in run.__dataclass_fields__},
            **{
                name: getattr(run, name) - 3.0
                for name in ("stamps", "pose_stamps", "odom_stamps", "cmd_stamps")
            },
        }
    )
    logs.write(shifted, tmp_path / "run.mcap")
    assert_same_run(logs.read(tmp_path / "run.mcap"), shifted)


def test_uneven_bearings_and_a_run_without_anything_come_back(tmp_path: Path) -> None:
    uneven = Run(
        sensor=RangeSensor(bearings=np.array([-1.0, -0.3, 0.0, 0.9])),
        stamps=np.zeros(2),
        ranges=np.ones((2, 4)),
    )
    empty = some_run(0, with_odometry=False)
    for run in (uneven, empty):
        logs.write(run, tmp_path / "run.mcap")
        assert_same_run(logs.read(tmp_path / "run.mcap"), run)


def test_same_run_gives_same_bytes_and_leaves_no_part(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        logs.write(some_run(), tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]


def test_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    run = some_run(epoch_ns=2**62)
    with pytest.raises(logs.LogError, match="ROS time ends"):
        logs.write(run, tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_latched_topics_come_first_and_time_never_goes_back(tmp_path: Path) -> None:
    logs.write(some_run(), tmp_path / "run.mcap", occupancy=OCCUPANCY)
    found = messages(tmp_path / "run.mcap")
    assert [topic for topic, _, _ in found[:2]] == ["/tf_static", "/map"]
    times = [time for _, time, _ in found]
    assert times == sorted(times)
    first = {}
    for topic, time, message in found:
        first.setdefault(topic, time)
        if hasattr(message, "header"):
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
    assert first["/tf"] <= first["/scan"]


def test_channels_carry_quality_of_service_with_integer_policies(tmp_path: Path) -> None:
    logs.write(some_run(), tmp_path / "run.mcap", occupancy=OCCUPANCY)
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        (quality,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        latched = channel.topic in ("/tf_static", "/map")
        assert quality["durability"] == (1 if latched else 2)
        assert all(
            isinstance(quality[name], int) for name in ("history", "reliability", "durability", "liveliness")
        )
        assert channel.message_encoding == "cdr"
        assert summary.schemas[channel.schema_id].encoding == "ros2msg"


def test_mcap_ros2_decodes_what_we_packed(tmp_path: Path) -> None:
    run = some_run()
    logs.write(run, tmp_path / "run.mcap", occupancy=OCCUPANCY)
    by_topic: dict[str, list] = {}
    for topic, _, message in messages(tmp_path / "run.mcap"):
        by_topic.setdefault(topic, []).append(message)
    scan = by_topic["/scan"][3]
    np.testing.assert_array_equal(np.float32(scan.ranges), run.ranges[3].astype(np.float32))
    assert scan.header.frame_id == "laser"
    assert scan.angle_min == np.float32(run.sensor.bearings[0])
    n = run.sensor.n_rays
    assert scan.angle_increment * (n - 1) == pytest.approx(
        scan.angle_max - scan.angle_min, abs=1e-6
    )  # float32
    assert scan.time_increment == np.float32(run.sensor.sweep_time / n)
    assert (scan.range_min, scan.range_max) == (np.float32(0.05), np.float32(8.0))
    grid = by_topic["/map"][0]
    assert (grid.info.width, grid.info.height) == (3, 2)
    assert list(grid.data) == OCCUPANCY.data.ravel().tolist()
    assert grid.info.origin.position.x == -1.0
    assert by_topic["/odom"][5].twist.twist.angular.z == run.odom_twists[5, 1]
    assert by_topic["/odom"][5].child_frame_id == "base_link"
    assert by_topic["/cmd_vel"][5].twist.linear.x == run.commands[5, 0]
    static = by_topic["/tf_static"][0].transforms[0]
    assert (static.header.frame_id, static.child_frame_id) == ("base_link", "laser")
    assert static.transform.translation.z == run.sensor.height


@pytest.mark.parametrize("pose_frame", ["base_link", "laser"])
@pytest.mark.parametrize("with_odometry", [True, False])
def test_transform_tree_agrees_with_the_reference(
    tmp_path: Path, pose_frame: str, with_odometry: bool
) -> None:
    run = some_run(pose_frame=pose_frame, with_odometry=with_odometry)
    logs.write(run, tmp_path / "run.mcap")
    recording = logs.formats.mcap_file.load(tmp_path / "run.mcap")
    from logs.ros.recording import transform_tree

    tree = transform_tree(recording)
    found = tree.place("map", "base_link" if pose_frame == "base_link" else "laser")
    assert found is not None and tree.conflicts == []
    want = interpolate(run.stamps, run.pose_stamps, run.poses)
    np.testing.assert_allclose(found.stamps, run.epoch_ns + np.rint(run.stamps * 1e9))
    np.testing.assert_allclose(found.poses[:, :2], want[:, :2], atol=1e-9)
    off = np.angle(np.exp(1j * (found.poses[:, 2] - want[:, 2])))
    np.testing.assert_allclose(off, 0, atol=1e-9)
    mount = tree.place("base_link", "laser")
    assert mount is not None
    np.testing.assert_allclose(mount.poses[0], run.sensor.mount, atol=1e-12)
    np.testing.assert_allclose(compose(want, np.zeros(3)), want, atol=1e-12)


def with_covariances(run: Run) -> Run:
    roots = np.random.default_rng(5).normal(0, 0.01, (len(run.poses), 3, 3))
    return replace(run, pose_covariances=roots @ roots.transpose(0, 2, 1))


def test_pose_covariances_come_back_and_stand_where_ros_has_them(tmp_path: Path) -> None:
    run = with_covariances(some_run())
    logs.write(run, tmp_path / "run.mcap")
    assert_same_run(logs.read(tmp_path / "run.mcap"), run)
    np.testing.assert_array_equal(logs.read(tmp_path / "run.mcap").pose_covariances, run.pose_covariances)
    foreign = logs.read(tmp_path / "run.mcap", topics={"pose": "/pose_with_covariance"})
    np.testing.assert_allclose(foreign.poses, run.poses, atol=1e-12)
    np.testing.assert_array_equal(foreign.pose_covariances, run.pose_covariances)
    found = [m for topic, _, m in messages(tmp_path / "run.mcap") if topic == "/pose_with_covariance"]
    assert len(found) == len(run.poses)
    six = np.reshape(found[4].pose.covariance, (6, 6))
    assert six[0, 5] == run.pose_covariances[4, 0, 2] and six[1, 1] == run.pose_covariances[4, 1, 1]
    assert (six[2:5] == 0).all()
    pieces = list(open_log(tmp_path / "run.mcap").pieces())
    np.testing.assert_array_equal(pieces[0].pose_covariances, run.pose_covariances)


def test_run_refuses_covariances_of_another_count() -> None:
    run = some_run()
    with pytest.raises(ValueError, match="pose_covariances has shape"):
        replace(run, pose_covariances=np.zeros((len(run.poses) - 1, 3, 3)))


def test_foreign_reader_of_our_topics_finds_the_same_run(tmp_path: Path) -> None:
    """Naming any topic but ours makes our own file a foreign one: only messages count then, not our metadata."""
    run = some_run()
    logs.write(run, tmp_path / "run.mcap")
    got = logs.read(tmp_path / "run.mcap", topics={"pose": "/tf"})
    assert got.meta["pose_source"] == "/tf map -> base_link"
    np.testing.assert_array_equal(got.ranges, run.ranges.astype(np.float32))
    np.testing.assert_allclose(got.sensor.bearings, run.sensor.bearings, atol=1e-5)  # float32 increments
    np.testing.assert_allclose(got.sensor.mount, run.sensor.mount, atol=1e-12)
    np.testing.assert_allclose(got.stamps - got.stamps[0], run.stamps - run.stamps[0], atol=1e-9)


def test_rosbags_opens_our_file_with_nothing_but_the_file(tmp_path: Path) -> None:
    run = some_run()
    logs.write(run, tmp_path / "run.mcap", occupancy=OCCUPANCY)
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert counts["/scan"] == run.n_scans
        scans = [c for c in reader.connections if c.topic == "/scan"]
        for i, (connection, _, raw) in enumerate(reader.messages(scans)):
            message = reader.deserialize(raw, connection.msgtype)
            np.testing.assert_array_equal(message.ranges, run.ranges[i].astype(np.float32))


def test_evo_reads_reference_and_odometry(tmp_path: Path) -> None:
    run = some_run()
    logs.write(run, tmp_path / "run.mcap")
    code = (
        "import sys, numpy as np\n"
        "from evo.tools import file_interface\n"
        "from rosbags.rosbag2 import Reader\n"
        "with Reader(sys.argv[1]) as reader:\n"
        "    for topic in ('/pose', '/odom'):\n"
        "        path = file_interface.read_bag_trajectory(reader, topic)\n"
        "        x, y, _ = path.positions_xyz[7]\n"
        "        print(topic, path.num_poses, repr(float(x)), repr(float(y)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "run.mcap")], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    rows = {
        words[0]: words[1:] for words in map(str.split, done.stdout.splitlines()) if words[0].startswith("/")
    }
    for topic, stamps, poses in (
        ("/pose", run.pose_stamps, run.poses),
        ("/odom", run.odom_stamps, run.odometry),
    ):
        count, x, y = rows[topic]
        assert int(count) == len(stamps)
        assert (float(x), float(y)) == tuple(poses[7, :2])


def test_reader_tells_progress_to_the_end(tmp_path: Path) -> None:
    said: list[tuple[int, int]] = []
    logs.write(some_run(), tmp_path / "run.mcap", progress=lambda done, total: said.append((done, total)))
    assert said[-1][0] == said[-1][1]
    said.clear()
    logs.read(tmp_path / "run.mcap", progress=lambda done, total: said.append((done, total)))
    assert said[-1][0] == said[-1][1] == (tmp_path / "run.mcap").stat().st_size


def test_reading_keeps_nothing_but_the_run(tmp_path: Path) -> None:
    n = 1500
    t, still = np.arange(n) / 10, np.zeros((n, 3))
    sensor = logs.RangeSensor(bearings=np.linspace(-1, 1, 31))
    run = logs.Run(
        sensor=sensor, stamps=t, ranges=np.ones((n, 31)), pose_stamps=t, poses=still,
        odom_stamps=t, odometry=still, odom_twists=still[:, :2],
    )  # fmt: skip
    path = tmp_path / "run.mcap"
    logs.write(run, path)
    logs.read(path)  # imports and caches
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        got = logs.read(path)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        gc.enable()
    own = sum(value.nbytes for value in vars(got).values() if isinstance(value, np.ndarray))
    assert held < own + 300_000  # no circle of objects holds the messages until they are collected
