"""What others record: bags of every kind, other names, other mounts, other habits with missing returns."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbag_samples import (
    EPOCH,
    HUMBLE,
    Message,
    odometry,
    pose,
    read,
    scan,
    to_ros1,
    transform,
    trip,
    write_bag1,
    write_bag2,
)
from rosbags.typesys import Stores, get_typestore

import logs
from logs import stream
from logs.ros.recording import (
    POSE_COVARIANCE_TYPE,
)


@pytest.mark.parametrize(
    "kind", ["mcap folder", "sqlite folder", "compressed folder", "bare mcap", "db3", "ROS 1"]
)
def test_bag_of_any_kind_gives_the_same_run(tmp_path: Path, kind: str) -> None:
    if kind == "ROS 1":
        path = write_bag1(tmp_path / "trip.bag", trip())
    else:
        storage = "SQLITE3" if kind in ("sqlite folder", "db3", "compressed folder") else "MCAP"
        path = write_bag2(
            tmp_path / "trip", trip(), storage, mode="MESSAGE" if kind.startswith("compressed") else None
        )
        if kind in ("bare mcap", "db3"):
            path = next(p for p in path.iterdir() if p.suffix != ".yaml")
    run = logs.read(path)
    assert run.n_scans == 10
    np.testing.assert_allclose(run.stamps, np.arange(10) / 10, atol=1e-9)
    np.testing.assert_array_equal(run.ranges[3], np.float32([1, 2, 3, 4, 5.3]))
    np.testing.assert_allclose(run.sensor.bearings, [-0.5, -0.25, 0, 0.25, 0.5], atol=1e-6)
    np.testing.assert_allclose(run.sensor.mount, [0.2, 0.1, 0.3], atol=1e-12)
    assert run.sensor.height == pytest.approx(0.4)
    assert run.sensor.rate == pytest.approx(10)
    np.testing.assert_allclose(run.poses[:, 0], np.arange(10) / 10, atol=1e-12)
    np.testing.assert_allclose(run.odom_twists, np.tile([1.0, 0.5], (10, 1)))
    np.testing.assert_allclose(run.commands, np.tile([1.0, 0.1], (10, 1)))
    assert run.meta["pose_source"] == "/pose"
    assert run.epoch_ns == EPOCH


@pytest.mark.parametrize("is_root", [True, False])
def test_height_counts_from_the_floor(tmp_path: Path, is_root: bool) -> None:
    """REP 120: base_footprint is on the floor, above or below base_link in the tree; that may be at the axle's height."""
    ends = ("base_footprint", "base_link") if is_root else ("base_link", "base_footprint")
    tree = [
        transform(0, *ends, 0, 0, 0, z=0.06 if is_root else -0.06, static=True),
        transform(0, "base_link", "laser", 0.1, 0, 0, z=0.2, static=True),
    ]
    run = read(tmp_path, [*tree, scan(0, [1.0, 2.0, 3.0, 4.0, 5.0])])
    assert run.sensor.height == pytest.approx(0.26)


def test_frames_of_one_robot_of_several_bear_its_name(tmp_path: Path) -> None:
    """The transforms count that share the laser's namespace; another robot's, and one without a namespace, do not."""
    tree = [transform(t, "amr7/map", "amr7/base_link", t, 0, 0.1) for t in (0.0, 0.1)]
    tree += [transform(t, "map", "base_link", 5.0 + t, 0, 0.1) for t in (0.0, 0.1)]
    tree += [
        transform(0, "amr7/base_link", "amr7/base_footprint", 0, 0, 0, z=-0.06, static=True),
        transform(0, "amr7/base_link", "amr7/front/laser", 0.3, 0, 0, z=0.2, static=True),
    ]
    run = read(tmp_path, [*tree, *(scan(t, [1, 1, 1], frame="amr7/front/laser") for t in (0.0, 0.1))])
    assert run.meta["pose_source"] == "/tf amr7/map -> amr7/base_link"
    np.testing.assert_allclose(run.poses, [[0, 0, 0.1], [0.1, 0, 0.1]], atol=1e-12)
    np.testing.assert_allclose(run.sensor.mount, [0.3, 0, 0], atol=1e-12)
    assert run.sensor.height == pytest.approx(0.26)


def test_missing_returns_follow_rep_117(tmp_path: Path) -> None:
    run = read(
        tmp_path, [scan(0, [0.0, 0.05, 11.0, np.inf, -np.inf]), scan(0.1, [np.nan, 10.0, 0.1, -1.0, 5.0])]
    )
    want = [[np.nan, -np.inf, np.inf, np.inf, -np.inf], [np.nan, 10.0, np.float32(0.1), np.nan, 5.0]]
    np.testing.assert_array_equal(run.ranges, want)
    for words in (
        "1 ranges are exactly 0",
        "1 ranges are below range_min",
        "1 ranges are above",
        "1 ranges are neg",
    ):
        assert words in run.meta["notes"]


def test_transforms_compose_to_the_reference(tmp_path: Path) -> None:
    """map -> odom turns by 90° and lags; odom -> base_link drives along x; so the robot climbs along y."""
    bag = [transform(0.0, "base_link", "laser", 0.5, 0, 0, static=True)]
    bag += [transform(t, "map", "odom", 1.0, t, np.pi / 2) for t in (0.0, 1.0)]
    bag += [transform(t, "odom", "base_link", 2 * t, 0, 0.0) for t in np.arange(11) / 10]
    bag += [scan(t, [1, 1, 1]) for t in np.arange(11) / 10]
    run = read(tmp_path, bag)
    assert run.meta["pose_source"] == "/tf map -> base_link"
    want = np.stack([np.ones(11), 3 * run.pose_stamps, np.full(11, np.pi / 2)], axis=-1)
    np.testing.assert_allclose(run.poses, want, atol=1e-9)
    assert logs.pair(run).paired.all()


def test_map_to_laser_without_a_base_is_the_lasers_pose(tmp_path: Path) -> None:
    bag = [transform(t, "map", "laser", t, 0, 0.1) for t in (0.0, 0.1)] + [
        scan(t, [1, 1, 1]) for t in (0.0, 0.1)
    ]
    run = read(tmp_path, bag)
    assert run.pose_frame == "laser"
    assert run.meta["pose_source"] == "/tf map -> laser"
    np.testing.assert_allclose(run.poses, [[0, 0, 0.1], [0.1, 0, 0.1]], atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 0.4, np.pi])
def test_laser_upside_down_is_mirrored(tmp_path: Path, yaw: float) -> None:
    """A ray at bearing b of a laser rolled by 180° points to yaw - b in the robot."""
    mount = transform(0.0, "base_link", "laser", 0, 0, yaw, roll=np.pi, static=True)
    run = read(tmp_path, [mount, scan(0, [1, 2, 3, 4], angle_min=-0.2, increment=0.3)])
    got = np.exp(1j * (run.sensor.mount[2] + run.sensor.bearings))
    want = np.exp(1j * (yaw - (-0.2 + 0.3 * np.arange(4))))
    np.testing.assert_allclose(got, want[::-1], atol=1e-6)
    np.testing.assert_array_equal(run.ranges[0], [4, 3, 2, 1])
    assert "upside down" in run.meta["notes"]


def test_clockwise_laser_is_reversed_and_every_ray_keeps_its_time(tmp_path: Path) -> None:
    run = read(tmp_path, [scan(0, [1, 2, 3], angle_min=0.5, increment=-0.5, time_increment=0.01)])
    np.testing.assert_allclose(run.sensor.bearings, [-0.5, 0, 0.5], atol=1e-6)
    np.testing.assert_array_equal(run.ranges[0], [3, 2, 1])
    times = run.epoch_ns / 1e9 + run.stamps[0] + run.sensor.sweep_time * np.arange(3) / 3
    np.testing.assert_allclose(times - EPOCH / 1e9, [0.02, 0.01, 0.0], atol=1e-6)


@pytest.mark.parametrize("time_increment", [0.0, 0.01], ids=["at once", "sweeping"])
def test_rays_of_a_full_turn_from_zero_keep_their_index(tmp_path: Path, time_increment: float) -> None:
    ranges = 1.0 + np.arange(8)
    turn = scan(0, ranges, angle_min=0.0, increment=np.pi / 4, time_increment=time_increment)
    run = read(
        tmp_path, [turn, scan(1, ranges, angle_min=0.0, increment=np.pi / 4, time_increment=time_increment)]
    )
    np.testing.assert_array_equal(run.ranges[0], ranges)
    np.testing.assert_allclose(run.sensor.bearings, np.pi / 4 * np.arange(8), atol=1e-6)


def test_last_ray_that_repeats_the_first_is_dropped(tmp_path: Path) -> None:
    run = read(tmp_path, [scan(0, np.arange(1, 10), angle_min=-np.pi, increment=np.pi / 4)])
    assert run.sensor.n_rays == 8
    assert "repeat others" in run.meta["notes"]


def test_two_lasers_ask_for_a_choice(tmp_path: Path) -> None:
    bag = [scan(0, [1, 2], topic="/front/scan"), scan(0, [3, 4], topic="/rear/scan")]
    with pytest.raises(logs.LogError, match="`topics` scan=/front/scan, `topics` scan=/rear/scan"):
        read(tmp_path, bag)
    path = tmp_path / "bag"
    np.testing.assert_array_equal(logs.read(path, topics={"scan": "/rear/scan"}).ranges, [[3, 4]])
    with pytest.raises(logs.LogError, match=r"scan=/side is not a topic .* /front/scan"):
        logs.read(path, topics={"scan": "/side"})
    with pytest.raises(logs.LogError, match="no role"):
        logs.read(path, topics={"lidar": "/rear/scan"})


def test_file_without_scans_says_what_it_has(tmp_path: Path) -> None:
    with pytest.raises(logs.LogError, match=r"no LaserScan; it has /odom \(nav_msgs/msg/Odometry\)"):
        read(tmp_path, [odometry(0, 0, 0, 0)])


@pytest.mark.parametrize(
    ("extra", "source"),
    [
        ([pose(0, 1, 2, 0.5, topic="/goal_pose"), odometry(0, 7, 8, 0)], "odometry /odom"),
        ([pose(0, 1, 2, 0.5, topic="/ground_truth"), odometry(0, 7, 8, 0)], "/ground_truth"),
        (
            [pose(0, 1, 2, 0.5, topic="/amcl_pose", kind=POSE_COVARIANCE_TYPE), odometry(0, 7, 8, 0)],
            "/amcl_pose",
        ),
        ([odometry(0, 7, 8, 0)], "odometry /odom"),
        ([], "none"),
    ],
)
def test_pose_source_is_the_best_there_is_and_said(tmp_path: Path, extra: list[Message], source: str) -> None:
    run = read(tmp_path, [scan(0, [1, 2, 3]), *extra])
    assert run.meta["pose_source"] == source
    want = {"o": [[7, 8, 0]], "/": [[1, 2, 0.5]], "n": np.zeros((0, 3))}[source[0]]
    np.testing.assert_allclose(run.poses, want, atol=1e-12)


def test_odometry_stands_in_for_poses_in_a_file_of_ours_too(tmp_path: Path) -> None:
    with_poses = read(tmp_path, trip())
    alone = dataclasses.replace(with_poses, pose_stamps=np.zeros(0), poses=np.zeros((0, 3)), meta={})
    logs.write(alone, tmp_path / "ours.mcap")
    run = logs.read(tmp_path / "ours.mcap")
    assert run.meta["pose_source"] == "odometry /odom"
    np.testing.assert_array_equal(run.poses, run.odometry)
    np.testing.assert_array_equal(run.pose_stamps, run.odom_stamps)


def test_odometry_chosen_as_the_pose_is_said_whatever_it_is_called(tmp_path: Path) -> None:
    wheels = [odometry(0.1 * i, 0.1 * i, 0, 0, topic="/wheel/state") for i in range(3)]
    run = read(tmp_path, [scan(0, [1, 2, 3]), pose(0, 9, 9, 0), *wheels], pose="/wheel/state")
    assert run.meta["pose_source"] == "odometry /wheel/state"
    np.testing.assert_allclose(run.poses[:, 0], [0, 0.1, 0.2], atol=1e-12)


def test_stamps_that_are_zero_take_the_log_time_and_disorder_is_sorted(tmp_path: Path) -> None:
    first = scan(-EPOCH / 1e9, [1, 2, 3], log=0.5)
    run = read(tmp_path, [first, scan(0.3, [4, 5, 6]), scan(0.3, [7, 8, 9])])
    np.testing.assert_allclose(run.stamps, [0.0, 0.0, 0.2], atol=1e-6)
    np.testing.assert_array_equal(run.ranges[:, 0], [4, 7, 1])
    for words in ("1 messages have stamp 0", "go back 1 times", "1 stamps are duplicates"):
        assert words in run.meta["notes"]


def test_scans_that_begin_elsewhere_each_time_have_no_known_ray_times(tmp_path: Path) -> None:
    bag = [scan(0.1 * k, [1.0, 2.0, 3.0, 4.0], angle_min=-0.5 + 0.1 * k, increment=0.25) for k in range(5)]
    said = "/scan: scans begin at 5 bearings, so that the times of their rays are not known"
    assert said in read(tmp_path, bag).meta["notes"]


def test_scans_of_another_geometry_are_resampled_and_counted(tmp_path: Path) -> None:
    bag = [scan(0.1 * i, [1, 2, 3]) for i in range(5)] + [
        scan(0.6, [1, 2, 3, 4]),
        scan(0.7, [5, 5, 5], increment=0.125),
        scan(0.8, []),
    ]
    run = read(tmp_path, bag)
    assert run.ranges.shape == (8, 3)
    np.testing.assert_array_equal(run.ranges[5], [1, 2, 3])
    np.testing.assert_array_equal(run.ranges[6], [5, 5, np.nan])
    np.testing.assert_array_equal(run.ranges[7], [np.nan] * 3)
    assert (
        "/scan: scans have 0 to 4 rays: 3 of 8 were resampled to the bearings of most scans (3 rays), none was dropped"
        in run.meta["notes"]
    )


def test_a_log_read_by_pieces_has_the_bearings_of_most_scans_and_loses_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first look sees scans of 37 rays alone, with returns of 0 for nothing seen; most have 36."""
    rng = np.random.default_rng(0)
    bag = []
    for i in range(60):
        n = 37 if i < 20 else 36
        ranges = np.where(rng.random(n) < 0.2, 0.0, rng.uniform(2, 3, n))
        bag += [scan(0.1 * i, ranges, angle_min=0.1, increment=2 * np.pi / n), pose(0.1 * i, 0.1 * i, 0, 0)]
    path = next(file for file in write_bag2(tmp_path / "bag", bag).iterdir() if file.suffix == ".mcap")
    for name, value in {"PIECE": 7, "AHEAD": 2, "FIRST_MESSAGES": 5}.items():
        monkeypatch.setattr(stream, name, value)
    log = stream.open_log(path)
    pieces = list(log.pieces())
    whole = logs.read(path)
    assert len(pieces) > 5 and log.n_scans == 60
    np.testing.assert_allclose(log.head.sensor.bearings, whole.sensor.bearings, atol=1e-6)
    ranges = np.concatenate([piece.ranges for piece in pieces])
    assert ranges.shape == (60, 36)
    np.testing.assert_array_equal(np.isposinf(ranges), np.isposinf(whole.ranges))
    np.testing.assert_allclose(ranges[np.isfinite(ranges)], whole.ranges[np.isfinite(ranges)], atol=1e-5)
    assert (
        "20 of 60 were resampled to the bearings of most scans (36 rays), none was dropped"
        in log.head.meta["notes"]
    )


@pytest.mark.parametrize("mode", [None, "FILE", "MESSAGE"])
@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_split_and_compressed_folders_give_the_whole_run(
    storage: str, mode: str | None, tmp_path: Path
) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    messages, about, names = trip(), {}, []
    for k, part in enumerate((messages[:20], messages[20:])):
        one = write_bag2(tmp_path / f"part{k}", part, storage, mode=mode)
        mine = yaml.safe_load((one / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        (file,) = (path for path in one.iterdir() if path.suffix != ".yaml")
        names.append(f"split_{k}{''.join(file.suffixes)}")
        file.rename(folder / names[-1])
        counts = {
            entry["topic_metadata"]["name"]: entry for entry in about.get("topics_with_message_count", [])
        }
        for entry in mine["topics_with_message_count"]:
            known = counts.setdefault(entry["topic_metadata"]["name"], {**entry, "message_count": 0})
            known["message_count"] += entry["message_count"]
        about = {**mine, "topics_with_message_count": list(counts.values())}
    about |= {"relative_file_paths": names, "message_count": len(messages), "files": []}
    about["compression_mode"] = mode or ""  # capitals, as ros2 bag writes it
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    run, whole = logs.read(folder), logs.read(write_bag2(tmp_path / "whole", messages))
    np.testing.assert_array_equal(run.ranges, whole.ranges)
    np.testing.assert_array_equal(run.poses, whole.poses)
    if mode == "FILE":
        with pytest.raises(logs.LogError, match="give the rosbag2 folder"):
            logs.read(folder / names[0])


@pytest.mark.parametrize(
    ("code", "named", "want", "words"),
    [
        (
            10.0,
            None,
            np.inf,
            "ranges of exactly range_max 10 m are missing returns: 80 rays (10.0 %) are +inf",
        ),
        (0.0, None, np.inf, "ranges of 0 are missing returns: 80 rays (10.0 %) are +inf"),
        (10.0, "inf", 10.0, ""),
        (0.0, "range_max", np.nan, "80 ranges are exactly 0, an invalid reading: nan"),
        (0.0, "zero", np.inf, "ranges of 0 are missing returns"),
        (np.nan, None, np.nan, "80 ranges (10.0 %) are nan and count as invalid readings"),
        (np.nan, "nan", np.inf, "ranges of nan are missing returns: 80 rays (10.0 %) are +inf"),
    ],
)
def test_a_missing_return_is_noticed_by_its_frequency_or_named(
    code: float, named: str | None, want: float, words: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    ranges = rng.uniform(1.0, 9.9, (40, 20))
    missing = np.zeros(800, dtype=bool)
    missing[rng.permutation(800)[:80]] = True
    ranges[missing.reshape(40, 20)] = code
    bag = [scan(0.1 * i, row, increment=0.05) for i, row in enumerate(ranges)]
    run = logs.read(write_bag2(tmp_path / "bag", bag), no_return=named)
    np.testing.assert_array_equal(run.ranges[missing.reshape(40, 20)], want)
    assert words in run.meta.get("notes", "")


def test_a_name_that_is_no_way_to_log_a_missing_return_is_refused(tmp_path: Path) -> None:
    with pytest.raises(logs.LogError, match="expected one of range_max, zero, inf, nan"):
        logs.read(write_bag2(tmp_path / "bag", trip()), no_return="81.83")


def test_missing_mount_is_said(tmp_path: Path) -> None:
    meta = read(tmp_path, [scan(0, [1, 2])]).meta
    assert "no transform base_link -> laser" in meta["notes"] and meta["mount"] == "unknown"


def test_mcap_that_holds_ros_1_messages_is_read_too(tmp_path: Path) -> None:
    from mcap.writer import Writer

    store = get_typestore(Stores.ROS1_NOETIC)
    with (tmp_path / "old.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros1", "test")
        schema = writer.register_schema("sensor_msgs/LaserScan", "ros1msg", b"")
        channel = writer.register_channel("/scan", "ros1", schema)
        for topic, msgtype, at, data in (scan(0.1 * i, [1, 2, 3 + i]) for i in range(4)):
            old = to_ros1(store, HUMBLE.deserialize_cdr(data, msgtype))
            assert topic == "/scan"
            writer.add_message(channel, at, bytes(store.serialize_ros1(old, msgtype)), at)
        writer.finish()
    run = logs.read(tmp_path / "old.mcap")
    np.testing.assert_array_equal(run.ranges, [[1, 2, 3], [1, 2, 4], [1, 2, 5], [1, 2, 6]])
    np.testing.assert_allclose(run.stamps, [0, 0.1, 0.2, 0.3], atol=1e-9)


def test_the_first_scan_may_state_other_times_than_the_rest(tmp_path: Path) -> None:
    """As of a driver that measures the duration of a scan, while its motor starts."""
    first = scan(0.0, [1, 2, 3], time_increment=0.27, scan_time=0.8, range_max=0.0)
    rest = [scan(t, [1, 2, 3], time_increment=0.03, scan_time=0.09) for t in np.arange(1, 12) / 10]
    run = read(tmp_path, [first, *rest])
    assert run.sensor.sweep_time == pytest.approx(0.09) and run.sensor.range_max == 10.0
    assert "notes" not in run.meta or "time_increment" not in run.meta["notes"]
