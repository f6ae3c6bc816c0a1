"""Frames of a log: poses between any two of them, odometry and reference from /tf, several lasers, several robots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import Message, message, odometry, pose, read, scan, transform, write_bag2

import logs
from logs import stream
from logs.inspection import inspect
from logs.notes import assumptions_of
from logs.ros.recording import ODOMETRY_TYPE, TF_TYPE
from logs.ros.transform_tree import TransformTree
from logs.transforms import compose, invert, to_translation_quaternion
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import check_ranges

T = np.arange(40) / 10
MOUNT = transform(0, "base_link", "laser", 0.2, 0, 0, static=True)
PATH = np.column_stack([2.5 * np.sin(0.2 * T), 2.5 * (1 - np.cos(0.2 * T)), 0.2 * T])
"""(40, 3) the true path in map: an arc at 0.5 m/s and 0.2 rad/s."""
DRIFT = np.column_stack([1 - 0.01 * T, 0.02 * T, np.pi / 2 + 0.005 * T])
"""(40, 3) odom in map."""


def scans(topic: str = "/scan", frame: str = "laser") -> list[Message]:
    return [scan(t, [1, 2, 3], topic=topic, frame=frame) for t in T]


def moving(parent: str, child: str, poses: np.ndarray, topic: str = "/tf") -> list[Message]:
    return [transform(t, parent, child, *row, topic=topic) for t, row in zip(T, poses.tolist(), strict=True)]


def in_order(*parts: Sequence[Message]) -> list[Message]:
    return sorted((message for part in parts for message in part), key=lambda message: message[2])


def edge(tree: TransformTree, parent: str, child: str, poses: np.ndarray, at: np.ndarray) -> None:
    tree.add(parent, child, (at * 1e9).astype(np.int64), to_translation_quaternion(poses), is_static=False)


@pytest.mark.parametrize("pair", [("a", "d"), ("d", "a"), ("c", "d"), ("d", "e"), ("root", "c"), ("e", "b")])
def test_pose_between_any_two_frames_is_the_chain_through_their_common_root(pair: tuple[str, str]) -> None:
    """root has the children a and b, a has c, b has d, and d has e; place(x, y) = (root -> x)⁻¹ (root -> y)."""
    rng = np.random.default_rng(3)
    at = np.arange(50) / 10
    tree, above = TransformTree(), {"a": "root", "b": "root", "c": "a", "d": "b", "e": "d"}
    in_root = {"root": np.zeros((50, 3))}
    for child, parent in above.items():
        poses = np.cumsum(rng.normal(scale=0.1, size=(50, 3)), axis=0)
        edge(tree, parent, child, poses, at)
        in_root[child] = compose(in_root[parent], poses)
    found = tree.place(*pair)
    assert found is not None
    want = compose(invert(in_root[pair[0]]), in_root[pair[1]])
    np.testing.assert_allclose(found.poses[:, :2], want[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * found.poses[:, 2]), np.exp(1j * want[:, 2]), atol=1e-9)
    assert tree.place("root", "elsewhere") is None


def test_reference_is_found_if_map_is_below_odom_or_beside_it(tmp_path: Path) -> None:
    driven = compose(invert(DRIFT), PATH)  # odom -> base_link
    world = np.tile([3.0, -2.0, 0.7], (len(T), 1))  # some root -> map
    trees = {
        "below": [*moving("odom", "map", invert(DRIFT)), *moving("odom", "base_link", driven)],
        "beside": [
            *moving("earth", "map", world), *moving("earth", "odom", compose(world, DRIFT)),
            *moving("odom", "base_link", driven),
        ],
        "base above": [*moving("odom", "map", invert(DRIFT)), *moving("base_link", "odom", invert(driven))],
    }  # fmt: skip
    for name, tree in trees.items():
        run = read(tmp_path / name, in_order([MOUNT], tree, scans()))
        assert run.meta["pose_source"] == "/tf map -> base_link", name
        np.testing.assert_allclose(run.poses, PATH, atol=1e-6)
        assert run.meta["odom_topic"] == "/tf odom -> base_link"
        np.testing.assert_allclose(run.odometry, driven, atol=1e-6)
        assert logs.pair(run).paired.all()


@pytest.mark.parametrize(
    ("odom", "base", "laser"),
    [
        ("odom", "base_link", "laser"),
        ("odom_combined", "base_footprint", "laser"),
        ("amr7/odom", "amr7/base_link", "amr7/laser"),
        ("amr7/wheel_odom", "amr7/chassis", "amr7/laser"),
        ("robot_odom", "robot_base", "robot_laser"),
    ],
)
def test_odometry_is_read_from_tf_alone(odom: str, base: str, laser: str, tmp_path: Path) -> None:
    mount = transform(0, base, laser, 0.2, 0.1, 0.3, static=True)
    run = read(tmp_path, in_order([mount], moving(odom, base, PATH), scans(frame=laser)))
    assert run.meta["odom_topic"] == f"/tf {odom} -> {base}"
    assert run.meta["pose_source"] == f"odometry /tf {odom} -> {base}"
    np.testing.assert_allclose(run.odometry, PATH, atol=1e-9)
    np.testing.assert_allclose(run.sensor.mount, [0.2, 0.1, 0.3], atol=1e-9)
    np.testing.assert_allclose(run.odom_twists, [[0.5, 0.2]] * len(T), atol=1e-2)  # chords of the arc


def test_topic_of_odometry_counts_before_tf_unless_tf_is_selected(tmp_path: Path) -> None:
    wheels = [odometry(t, -1, 0, 0) for t in T]
    path = write_bag2(tmp_path / "bag", in_order([MOUNT], moving("odom", "base_link", PATH), wheels, scans()))
    assert logs.read(path).meta["odom_topic"] == "/odom"
    run = logs.read(path, topics={"odom": "/tf"})
    assert run.meta["odom_topic"] == "/tf odom -> base_link"
    np.testing.assert_allclose(run.odometry, PATH, atol=1e-9)


def test_transform_that_never_changes_is_odometry_only_if_it_is_selected(tmp_path: Path) -> None:
    bag = in_order([MOUNT], moving("odom", "base_link", 0 * PATH), scans())
    assert "odom_topic" not in read(tmp_path, bag).meta
    assert logs.read(tmp_path / "bag", topics={"odom": "/tf"}).meta["odom_topic"] == "/tf odom -> base_link"


@pytest.mark.parametrize("role", ["odom", "pose"])
def test_transform_that_tf_lacks_is_refused_if_it_is_selected(role: str, tmp_path: Path) -> None:
    path = write_bag2(tmp_path / "bag", in_order([MOUNT], moving("base_link", "wheel", PATH), scans()))
    with pytest.raises(logs.LogError, match=f"{role}=/tf: it has no transform over time from"):
        logs.read(path, topics={role: "/tf"})


def test_tf_poses_whose_correction_never_changes_are_odometry(tmp_path: Path) -> None:
    fixed = transform(0, "map", "odom", 1, 2, 0, static=True)
    path = write_bag2(tmp_path / "bag", in_order([MOUNT, fixed], moving("odom", "base_link", PATH), scans()))
    run = logs.read(path)
    assert run.meta["pose_source"] == "odometry /tf odom -> base_link"
    assert "/tf map -> base_link is odometry and no reference: map -> odom never changes" in assumptions_of(
        run
    )
    assert logs.read(path, topics={"pose": "/tf"}).meta["pose_source"] == "/tf map -> base_link"


def test_each_robot_of_a_log_has_its_own_transforms_and_topics(tmp_path: Path) -> None:
    bag: list[Sequence[Message]] = []
    for k in (1, 2):
        bag += [moving("odom", "base_link", k * PATH, topic=f"/robot{k}/tf"), scans(f"/robot{k}/scan")]
        bag += [[pose(t, k, 0, 0, topic=f"/robot{k}/truth") for t in T]]
    path = write_bag2(tmp_path / "bag", in_order([MOUNT], *bag))
    for k in (1, 2):
        run = logs.read(path, topics={"scan": f"/robot{k}/scan"})
        np.testing.assert_allclose(run.odometry[:, 0], k * PATH[:, 0], atol=1e-9)
        assert run.meta["pose_source"] == f"/robot{k}/truth" and run.poses[0, 0] == k


def test_two_parents_of_a_frame_give_reference_and_odometry(tmp_path: Path) -> None:
    driven = compose(invert(DRIFT), PATH)
    tree = in_order([MOUNT], moving("odom", "base_link", driven), moving("map", "base_link", PATH), scans())
    run = read(tmp_path, tree)
    np.testing.assert_allclose(run.odometry, driven, atol=1e-6)
    np.testing.assert_allclose(run.poses, PATH, atol=1e-6)
    assert "frames with two parents: base_link (under odom and map)" in assumptions_of(run)


def test_of_two_transforms_with_one_stamp_the_last_counts(tmp_path: Path) -> None:
    """A filter publishes its estimate again when another measurement with the same stamp comes."""
    first = moving("odom", "base_link", PATH + [0.1, 0, 0])
    run = read(tmp_path, in_order([MOUNT], scans(), first, moving("odom", "base_link", PATH)))
    np.testing.assert_allclose(run.odometry, PATH, atol=1e-9)
    twice = in_order([MOUNT], scans(), first, first)
    write_bag2(tmp_path / "twice", twice)
    assert "odom -> base_link (40 samples, 40 repeated)" in inspect(tmp_path / "twice").transforms


def test_two_publishers_of_the_odometry_are_reported(tmp_path: Path) -> None:
    wheels = [odometry(t, x, 0, 0) for t, x in zip(T, PATH[:, 0].tolist(), strict=True)]
    filtered = [odometry(t + 0.01, x + 0.3, 0, 0) for t, x in zip(T, PATH[:, 0].tolist(), strict=True)]
    notes = assumptions_of(read(tmp_path, in_order(scans(), wheels, filtered)))
    assert any("/odom jumps at" in note and "by up to 0.30 m: two publishers" in note for note in notes)


def test_odometry_frame_next_to_the_base_is_that_of_the_wheels(tmp_path: Path) -> None:
    tree = [*moving("odom", "odom_source", DRIFT), *moving("odom_source", "base_link", PATH)]
    run = read(tmp_path, in_order([MOUNT], tree, scans()))
    assert run.meta["odom_topic"] == "/tf odom_source -> base_link"
    np.testing.assert_allclose(run.odometry, PATH, atol=1e-9)


def test_several_pose_topics_are_listed_and_none_is_needed(tmp_path: Path) -> None:
    wishes = [pose(t, 1, 1, 0, topic=name) for t in T for name in ("/ground_truth", "/control/wish")]
    path = write_bag2(tmp_path / "bag", in_order([MOUNT], moving("odom", "base_link", PATH), wishes, scans()))
    run = logs.read(path)
    assert run.meta["pose_source"] == "odometry /tf odom -> base_link"
    note = "several topics could be the reference pose, none was used: `topics` pose=/ground_truth, `topics` pose=/control/wish"
    assert note in assumptions_of(run)
    assert logs.read(path, topics={"pose": "/ground_truth"}).meta["pose_source"] == "/ground_truth"


def two_on_one(*, mounts: bool = True) -> list[Message]:
    tree = [
        transform(0, "base_link", "front", 0.3, 0, 0, static=True),
        transform(0, "base_link", "rear", -0.3, 0, np.pi, static=True),
    ]
    front = [scan(t, [1, 2, 3], frame="front") for t in T]
    rear = [scan(t + 0.03, [4, 5, 6, 7], frame="rear") for t in T[:-1]]
    return in_order(tree if mounts else [], front, rear, [odometry(t, t, 0, 0) for t in T])


def test_two_frames_on_one_topic_are_two_sensors(tmp_path: Path) -> None:
    path = write_bag2(tmp_path / "bag", two_on_one())
    run = logs.read(path)
    assert run.ranges.shape == (79, 7)
    ahead = run.sensor.origins[:, 0] > 0
    np.testing.assert_array_equal(run.ranges[0][ahead], [1, 2, 3])
    np.testing.assert_array_equal(np.sort(run.ranges[1][~ahead]), [4, 5, 6, 7])
    assert np.isnan(run.ranges[0][~ahead]).all() and np.isnan(run.ranges[1][ahead]).all()
    for frame, n, first in (("front", 40, [1, 2, 3]), ("rear", 39, [4, 5, 6, 7])):
        one = logs.read(path, topics={"scan": f"/scan@{frame}"})
        assert one.n_scans == n and one.meta["scan_topic"] == f"/scan@{frame}"
        np.testing.assert_array_equal(one.ranges[0], first)
        assert one.sensor.mount[0] == pytest.approx(0.3 if frame == "front" else -0.3)
        assert any("range sensors that were not used: /scan@" in note for note in assumptions_of(one))
    with pytest.raises(logs.LogError, match="no scans in this frame; it has /scan@front, /scan@rear"):
        logs.read(path, topics={"scan": "/scan@side"})


def test_two_frames_without_mounts_ask_for_a_choice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bag2(tmp_path / "bag", two_on_one(mounts=False))
    words = r"/scan holds scans of 2 frames \(40 of front, 39 of rear\) with unknown mounts; select one with `topics` scan=/scan@"
    with pytest.raises(logs.LogError, match=words):
        logs.read(path)
    mounts = {"front": np.array([0.3, 0, 0]), "rear": np.array([-0.3, 0, np.pi])}
    assert logs.read(path, mounts=mounts).sensor.is_composite
    assert cli(["locate", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_second_laser_is_always_mentioned(tmp_path: Path) -> None:
    bag = in_order([MOUNT], scans(), scans("/rear_scan", "rear"), scans("/top_scan", "top"))
    run = read(tmp_path, bag)
    note = "range sensors that were not used: /rear_scan (40 scans), /top_scan (40 scans)"
    assert any(each.startswith(note) for each in assumptions_of(run))
    assert run.ranges.shape == (40, 3)


def test_log_in_pieces_takes_the_sources_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot stands at first and at last, and another laser and a wish are there; every piece has the odometry."""
    still = np.vstack([np.tile(PATH[:1], (10, 1)), PATH[:20], np.tile(PATH[19:20], (10, 1))])
    wishes = [pose(t, 1, 1, 0, topic=name) for t in T for name in ("/truth", "/wish")]
    tree = [
        moving("odom", "base_link", still),
        moving("map", "odom", np.where(T[:, None] > 2, DRIFT, DRIFT[:1])),
    ]
    bag = in_order([MOUNT], *tree, scans(), scans("/rear", "rear"), wishes)
    path = next(file for file in write_bag2(tmp_path / "bag", bag).iterdir() if file.suffix == ".mcap")
    for name, value in {"PIECE": 5, "AHEAD": 2, "FIRST_MESSAGES": 4, "SAMPLE_EVERY": 7}.items():
        monkeypatch.setattr(stream, name, value)
    log, whole = stream.open_log(path), logs.read(path)
    pieces = list(log.pieces())
    assert len(pieces) > 5
    assert log.head.meta["pose_source"] == whole.meta["pose_source"] == "/tf map -> base_link"
    for piece in pieces:
        assert piece.meta["pose_source"] == "/tf map -> base_link"
        assert piece.meta["odom_topic"] == "/tf odom -> base_link"
        assert len(piece.poses) and any("not used: /rear" in note for note in assumptions_of(piece))
    assert sum(int(logs.pair(piece).paired.sum()) for piece in pieces) == int(logs.pair(whole).paired.sum())


def test_log_whose_clocks_differ_is_not_read_in_pieces(tmp_path: Path) -> None:
    wheels = [odometry(t - 50, t, 0, 0, log=t) for t in T]
    for name, bag in (
        ("clock", in_order([MOUNT], scans(), wheels)),
        ("frames", two_on_one()),
        ("copies", in_order([MOUNT], scans(), scans())),
    ):
        path = write_bag2(tmp_path / name, bag)
        file = next(each for each in path.iterdir() if each.suffix == ".mcap")
        log = stream.open_log(file)
        assert isinstance(log, stream.WholeRun), name
        assert log.n_scans == logs.read(file).n_scans


def test_inspection_shows_the_sources(tmp_path: Path) -> None:
    lines = inspect(
        write_bag2(tmp_path / "bag", in_order([MOUNT], moving("odom", "base_link", PATH), scans()))
    ).lines()
    assert "  40 odometry poses and twists from /tf odom -> base_link" in lines


@pytest.mark.parametrize(
    ("turns", "is_refused"),
    [(0.01 * np.sin(3 * T), False), (0.5 * (T == 2.0), False), (0.5 * np.sin(3 * T), True)],
    ids=["trembles", "one wrong transform", "pans"],
)
def test_a_laser_that_pans_on_the_robot_is_refused_and_one_that_trembles_is_not(
    turns: np.ndarray, is_refused: bool, tmp_path: Path
) -> None:
    pan = np.column_stack([np.full(len(T), 0.1), np.zeros(len(T)), turns])
    run = read(
        tmp_path, in_order(moving("base_link", "laser", pan), moving("odom", "base_link", PATH), scans())
    )
    assert any("the laser moves on the robot" in note for note in assumptions_of(run))
    if not is_refused:
        check_ranges(run, "pan.bag")
        return
    with pytest.raises(SensorgraphError, match=r"pan\.bag: .*moves on the robot by up to 0\.00 m and \d\d°"):
        check_ranges(run, "pan.bag")


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, np.pi])
def test_odometry_of_a_camera_is_converted_to_that_of_the_base(yaw: float, tmp_path: Path) -> None:
    """A camera 0.3 m behind the base, looking elsewhere: where the base turns by φ, it moves on a circle about the base."""
    camera = np.array([-0.3, 0.1, yaw])
    seen = compose(PATH, np.broadcast_to(camera, PATH.shape))  # the camera in a frame of the world
    bag = [
        message("/odom", ODOMETRY_TYPE, t, {"frame_id": "odom", "child_frame_id": "camera"},
                pose=to_translation_quaternion(row[None])[0], twist=[0.5, 0, 0, 0, 0, 0.2])
        for t, row in zip(T, seen, strict=True)
    ]  # fmt: skip
    on_base = transform(0, "base_link", "camera", *camera, static=True)
    run = read(tmp_path, in_order([MOUNT, on_base], scans(), bag))
    np.testing.assert_allclose(run.odometry[:, :2], PATH[:, :2], atol=1e-6)
    np.testing.assert_allclose(np.exp(1j * run.odometry[:, 2]), np.exp(1j * PATH[:, 2]), atol=1e-6)
    np.testing.assert_allclose(run.odom_twists[1:-1], [[0.5, 0.2]] * 38, atol=0.01)  # m/s, rad/s of PATH
    assert "/odom is the odometry of camera" in run.meta["notes"]
    (tmp_path / "unknown").mkdir()
    unknown = read(
        tmp_path / "unknown", in_order([MOUNT], scans(), bag)
    )  # nothing states where the camera is
    np.testing.assert_allclose(unknown.odometry[:, :2], seen[:, :2], atol=1e-6)


def test_scans_in_an_optical_frame_look_ahead(tmp_path: Path) -> None:
    """REP 103: x of an optical frame points to the right of the camera, y down and z ahead."""
    optical = message(
        "/tf_static", TF_TYPE, 0.0, {"0.frame_id": "camera", "0.child_frame_id": "camera_depth_optical_frame"}, parts=1,
        **{"0__transform": [0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5]},
    )  # fmt: skip
    camera = transform(0, "base_link", "camera", 0.2, 0.1, 0.7, z=0.4, static=True)
    run = read(tmp_path, in_order([camera, optical], scans(frame="camera_depth_optical_frame")))
    np.testing.assert_allclose(run.sensor.mount, [0.2, 0.1, 0.7], atol=1e-6)
    np.testing.assert_allclose(run.ranges[0], [1, 2, 3])
    assert "optical frame" in run.meta["notes"] and "tilted" not in run.meta["notes"]
