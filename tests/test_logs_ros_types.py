"""Message types beyond the usual: several echoes, and each type that states a pose or a command, in ROS 1 and 2."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from bag1_samples import Sample, bag20, header
from rosbag_samples import (
    HUMBLE,
    Message,
    message,
    ns,
    odometry,
    quaternion,
    read,
    scan,
    transform,
    write_bag1,
    write_bag2,
)

import logs
from logs import stream
from logs.notes import assumptions_of
from logs.ros.laser_messages import first_echoes
from logs.ros.recording import (
    MULTI_ECHO_TYPE,
    ODOMETRY_TYPE,
    POSE_COVARIANCE_TYPE,
    POSE_TYPE,
    TRANSFORM_TYPE,
    TWIST_STAMPED_TYPE,
    TWIST_TYPE,
    Topic,
)

Echoes = list[list[float]]


def echoes_of(rng: np.random.Generator, n_rays: int) -> Echoes:
    """No, one or up to three echoes a ray, the nearest first."""
    return [
        np.sort(rng.uniform(1, 5, n)).astype(np.float32).tolist() for n in rng.choice([0, 1, 1, 2, 3], n_rays)
    ]


def multi_echo(
    stamp: float, echoes: Echoes, *, with_intensities: bool = True, frame: str = "laser"
) -> Message:
    """A message that rosbags writes; an intensity is ten times its range."""
    types, at = HUMBLE.types, ns(stamp)
    echo = types["sensor_msgs/msg/LaserEcho"]
    head = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9), frame_id=frame
    )
    last = -0.5 + 0.01 * (len(echoes) - 1)
    value = types[MULTI_ECHO_TYPE](
        header=head, angle_min=-0.5, angle_max=last, angle_increment=0.01, time_increment=0.0, scan_time=0.1,
        range_min=0.1, range_max=20.0, ranges=[echo(echoes=np.float32(ray)) for ray in echoes],
        intensities=[echo(echoes=10 * np.float32(ray)) for ray in echoes] if with_intensities else [],
    )  # fmt: skip
    return "/echoes", MULTI_ECHO_TYPE, at, bytes(HUMBLE.serialize_cdr(value, MULTI_ECHO_TYPE))


def first_of(echoes: Echoes) -> np.ndarray:
    return np.array([ray[0] if ray else np.inf for ray in echoes])


@pytest.mark.parametrize("kind", ["MCAP", "SQLITE3", "ROS 1", "pieces"])
@pytest.mark.parametrize("with_intensities", [True, False])
def test_the_first_echo_of_each_ray_is_read(kind: str, with_intensities: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    every = [echoes_of(rng, 61) for _ in range(12)]
    bag = [multi_echo(0.1 * i, rays, with_intensities=with_intensities) for i, rays in enumerate(every)]
    if kind == "ROS 1":
        run = logs.read(write_bag1(tmp_path / "a.bag", bag))
    else:
        path = write_bag2(tmp_path / "bag", bag, "MCAP" if kind == "pieces" else kind)
        if kind == "pieces":
            (run,) = stream.open_log(next(path.glob("*.mcap"))).pieces()
        else:
            run = logs.read(path)
    want = np.array([first_of(rays) for rays in every])
    np.testing.assert_array_equal(run.ranges, want)
    if with_intensities:
        np.testing.assert_allclose(run.intensities, np.where(np.isfinite(want), 10 * want, np.nan), rtol=1e-6)
    else:
        assert run.intensities.shape == (0, 61)
    n_more = sum(len(ray) > 1 for rays in every for ray in rays)
    note = f"/echoes: the first echo of each ray was used ({n_more} rays have further echoes)"
    assert note in assumptions_of(run)
    n_none = sum(not ray for rays in every for ray in rays)
    assert f"/echoes: {n_none} rays without an echo are missing returns, +inf" in assumptions_of(run)


def test_scans_of_several_lengths_and_frames_keep_their_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    every = [echoes_of(rng, 40 if i % 3 else 41) for i in range(9)]
    run = read(tmp_path, [multi_echo(0.1 * i, rays) for i, rays in enumerate(every)])
    assert run.ranges.shape == (9, 40)
    for i in (1, 2, 4, 5, 7, 8):
        np.testing.assert_array_equal(run.ranges[i], first_of(every[i]))


def test_a_multi_echo_message_that_is_cut_is_refused() -> None:
    topic, kind, at, data = multi_echo(0.0, echoes_of(np.random.default_rng(2), 30), with_intensities=False)
    broken = Topic(topic, kind, n_messages=1, log_times=[at])
    broken.payloads.append(data[:-120])
    with pytest.raises(logs.LogError, match="states more echoes than it holds"):
        first_echoes(broken)


def test_a_ros_1_header_of_any_length_is_no_obstacle(tmp_path: Path) -> None:
    """ROS 1 does not align: the arrays start at any byte."""
    for frame in ("a", "ab", "abc", "abcd"):
        echoes = struct.pack("<I", 2) + struct.pack("<If", 1, 1.5) + struct.pack("<Iff", 2, 2.5, 9.0)
        data = (
            header(0, 1e9, frame)
            + struct.pack("<7f", 0, 0.1, 0.1, 0, 0.1, 0.1, 20)
            + echoes
            + struct.pack("<I", 0)
        )
        path = tmp_path / f"{frame}.bag"
        path.write_bytes(bag20([Sample("/scan", "sensor_msgs/MultiEchoLaserScan", 1e9, data)]))
        np.testing.assert_array_equal(logs.read(path).ranges, [[1.5, 2.5]])


def stated(kind: str, stamp: float, x: float) -> Message:
    """A pose at x in the map, in one of the types."""
    strings = {"frame_id": "map", "child_frame_id": "base_link"}
    return message("/reference", kind, stamp, strings, pose=[x, 0.5, 0, *quaternion(0.3)])


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("kind", [POSE_TYPE, POSE_COVARIANCE_TYPE, TRANSFORM_TYPE, ODOMETRY_TYPE])
def test_every_type_of_pose_is_a_reference(kind: str, ros: int, tmp_path: Path) -> None:
    bag = [scan(0.1 * i, [1, 2, 3]) for i in range(5)]
    bag += [stated(kind, 0.1 * i, 0.2 * i) for i in range(5)]
    bag += [odometry(0.1 * i, 9.0, 9.0, 0.0) for i in range(5)]
    path = write_bag1(tmp_path / "a.bag", bag) if ros == 1 else write_bag2(tmp_path / "bag", bag)
    topics = {"pose": "/reference", "odom": "/odom"} if kind == ODOMETRY_TYPE else None
    run = logs.read(path, topics=topics)
    assert "/reference" in run.meta["pose_source"]
    np.testing.assert_allclose(run.poses, [[0.2 * i, 0.5, 0.3] for i in range(5)], atol=1e-9)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("kind", [TWIST_TYPE, TWIST_STAMPED_TYPE])
def test_both_types_of_command_are_read(kind: str, ros: int, tmp_path: Path) -> None:
    strings = {} if kind == TWIST_TYPE else {"frame_id": "base_link"}
    tree = [transform(0, "base_link", "laser", 0, 0, 0, static=True)]
    bag = [*tree, *(scan(0.1 * i, [1, 2, 3]) for i in range(5))]
    bag += [message("/drive", kind, 0.1 * i, strings, twist=[0.1 * i, 0, 0, 0, 0, -0.2]) for i in range(5)]
    path = write_bag1(tmp_path / "a.bag", bag) if ros == 1 else write_bag2(tmp_path / "bag", bag)
    run = logs.read(path)
    np.testing.assert_allclose(run.commands, [[0.1 * i, -0.2] for i in range(5)], atol=1e-12)
    np.testing.assert_allclose(run.cmd_stamps, 0.1 * np.arange(5), atol=1e-6)
