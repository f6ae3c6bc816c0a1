"""A point cloud as a laser: the right points, at the right bearings and times, whatever the driver writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloud_samples import KINDS, ROOM, Spinner, cloud, spin, sweep, wall_distance
from rosbag_samples import EPOCH, Message, message, odometry, pose, scan, transform, write_bag1, write_bag2

import logs
import sensorgraph as sg
from logs import stream
from logs.errors import LogError
from logs.notes import notes_of
from logs.ros.recording import SCAN_TYPE
from sensorgraph.cli import run as command

MOUNT = transform(0.0, "base_link", "velodyne", 0.2, 0.1, 0.3, z=0.4, static=True)


def read(tmp_path: Path, messages: list[Message], **options: Any) -> logs.Run:
    path = tmp_path / "bag"
    return logs.read(path if path.exists() else write_bag2(path, messages), **options)


def error_of(run: logs.Run, laser: Spinner) -> np.ndarray:
    """Measured minus true range of each ray, at the time of each ray."""
    at = (run.epoch_ns - EPOCH) / 1e9 + run.stamps[:, None] + run.sensor.ray_delays
    return run.ranges - wall_distance(laser.v * at, 0.0, run.sensor.bearings)


def assert_exact(run: logs.Run, laser: Spinner, *, share: float = 0.99) -> None:
    """Every ray returns; only at the corners of the room may the wall between two points be another."""
    assert np.isfinite(run.ranges).all()
    assert (np.abs(error_of(run, laser)) < 2e-3).mean() > share


@pytest.mark.parametrize(
    "laser",
    [
        Spinner(),
        Spinner(sign=1, v=1.0),
        Spinner(drift=0.2),
        Spinner(drift=-0.15, v=1.0),
        Spinner(drift=0.05, v=1.0, sign=1),
    ],
    ids=["clockwise", "counter-clockwise, driving", "more than a turn", "less than a turn, driving", "drifting"],
)  # fmt: skip
def test_turns_are_put_together_with_the_time_of_each_ray(laser: Spinner, tmp_path: Path) -> None:
    run = read(tmp_path, [MOUNT, *spin(laser, 20)])
    assert run.sensor.n_rays == laser.n
    assert run.sensor.sweep_time == pytest.approx(-laser.sign * -1 * laser.period, rel=1e-3)
    np.testing.assert_allclose(np.diff(run.stamps), laser.period, atol=1e-5)
    np.testing.assert_allclose(run.sensor.mount, [0.2, 0.1, 0.3], atol=1e-9)
    assert run.sensor.height == pytest.approx(0.4)
    assert_exact(run, laser)
    np.testing.assert_allclose(run.intensities, 10 * run.ranges, rtol=0.05)  # that of the nearest point
    assert any("ring 2 at an elevation of 1.0°" in note for note in notes_of(run))


@pytest.mark.parametrize(
    ("name", "kind", "unit"),
    [
        ("t", "u4", 1e-9),
        ("t", "u4", 1e-6),
        ("time", "f4", 1.0),
        ("timestamp", "f8", 1.0),
        ("timestamp", "f8", 1e-9),
    ],
)
def test_times_of_points_have_the_names_and_units_of_every_driver(
    name: str, kind: str, unit: float, tmp_path: Path
) -> None:
    """A `timestamp` is absolute."""
    laser = Spinner(v=1.0)
    kinds = {"x": "f4", "y": "f4", "z": "f4", "ring": "u1", name: kind}
    bag = []
    for k in range(10):
        columns = sweep(laser, k)
        after = columns["t"] + (EPOCH / 1e9 + k * laser.period if name == "timestamp" else 0.0)
        columns[name] = after / unit
        bag.append(cloud(k * laser.period, columns, kinds))
    assert_exact(read(tmp_path, [MOUNT, *bag]), laser)


@pytest.mark.parametrize("change", ["big-endian", "padded", "rows", "columns", "row_step 0", "ROS 1"])
def test_bytes_may_be_laid_out_in_any_way(change: str, tmp_path: Path) -> None:
    laser = Spinner(n=360)
    options: dict[str, Any] = {
        "big-endian": {"big": True}, "padded": {"pad": 7, "row_pad": 5}, "row_step 0": {"row_step": 0}
    }.get(change, {})  # fmt: skip
    bag = [MOUNT, *spin(laser, 4, **options)]
    if change in ("rows", "columns"):  # an organised cloud without a field for its rings
        kinds = {name: kind for name, kind in KINDS.items() if name != "ring"}
        bag = [MOUNT]
        for k in range(4):
            columns, height = sweep(laser, k), 360
            if change == "rows":
                columns = {name: values.reshape(-1, 4).T.ravel() for name, values in columns.items()}
                height = 4
            columns["t"] = columns["t"] * 1e9
            bag.append(cloud(0.1 * k, columns, kinds, height=height, row_pad=3))
    path = write_bag1(tmp_path / "a.bag", bag) if change == "ROS 1" else write_bag2(tmp_path / "bag", bag)
    run = logs.read(path)
    assert run.sensor.n_rays == 360
    assert_exact(run, laser, share=0.97)


def test_points_without_rings_or_times_are_taken_by_elevation(tmp_path: Path) -> None:
    laser = Spinner(n=360, rings=(-5, -3, -1.2, 0.8, 3), start=0.0)
    run = read(tmp_path, [MOUNT, *spin(laser, 4, kinds={"x": "f4", "y": "f4", "z": "f4"})])
    assert run.sensor.sweep_time == 0
    assert_exact(run, Spinner(), share=0.97)
    words = "; ".join(notes_of(run))
    assert "points at elevations from -0.2° to 1.8°" in words and "points have no times" in words


def tilted(columns: dict[str, np.ndarray], roll: float, pitch: float) -> dict[str, np.ndarray]:
    """The same points in the frame of a laser that is turned about x, then y."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    turn = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    x, y, z = turn.T @ np.stack([columns[name] for name in "xyz"])
    return {**columns, "x": x, "y": y, "z": z}


def attitude(roll: float, pitch: float, z: float) -> Message:
    cr, sr, cp, sp = np.cos(roll / 2), np.sin(roll / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    turn = [sr * cp, cr * sp, -sr * sp, cr * cp]  # of pitch, then roll
    strings = {"0.frame_id": "base_link", "0.child_frame_id": "velodyne"}
    return message(
        "/tf_static", "tf2_msgs/msg/TFMessage", 0.0, strings, parts=1, **{"0__transform": [0, 0, z, *turn]}
    )


@pytest.mark.parametrize(("roll", "pitch"), [(np.pi, 0.0), (0.0, 0.2), (0.15, -0.1)])
def test_a_tilted_or_hanging_laser_is_levelled(roll: float, pitch: float, tmp_path: Path) -> None:
    laser = Spinner(rings=tuple(np.arange(-15, 16, 0.5)), n=360)
    bag = [attitude(roll, pitch, 0.4)]
    for k in range(4):
        columns = tilted(sweep(laser, k), roll, pitch)
        columns["t"] = columns["t"] * 1e9
        bag.append(cloud(0.1 * k, columns, KINDS))
    run = read(tmp_path, bag)
    np.testing.assert_allclose(run.sensor.mount, 0, atol=1e-9)
    error = error_of(run, laser)
    assert np.isfinite(error).mean() > 0.99
    assert np.nanquantile(np.abs(error), 0.95) < 0.01
    assert not any("tilted" in note for note in notes_of(run))


def test_a_slice_takes_the_nearest_point_between_two_heights(tmp_path: Path) -> None:
    """A table top at 0.7 to 0.75 m is seen by the slice that holds it, and by no other."""
    laser = Spinner(rings=tuple(np.arange(-15, 16, 1.0)), n=360, height=0.5)
    bag = [transform(0.0, "base_link", "velodyne", 0, 0, 0, z=0.5, static=True)]
    bag.append(transform(0.0, "base_link", "base_footprint", 0, 0, 0, z=-0.1, static=True))  # the floor
    for k in range(4):
        columns = sweep(laser, k)
        columns["t"] = columns["t"] * 1e9
        bearing = np.arctan2(columns["y"], columns["x"])
        table = (np.abs(bearing) < 0.1) & (columns["ring"] == 20)  # 5°
        nearer = np.where(table, 1.5 / np.hypot(columns["x"], columns["y"]), 1.0)
        columns |= {"x": columns["x"] * nearer, "y": columns["y"] * nearer}
        columns["z"] = np.where(table, 1.5 * np.tan(np.radians(5)), columns["z"])  # 0.73 m above the floor
        bag.append(cloud(0.1 * k, columns, KINDS))
    low, high = read(tmp_path, bag, slice=(0.4, 0.65)), read(tmp_path, bag, slice=(0.7, 0.76))
    ahead = np.abs((low.sensor.bearings + np.pi) % (2 * np.pi) - np.pi) < 0.08
    assert (np.abs(low.ranges[:, ahead] - ROOM[1]) < 0.05).all()
    assert np.isfinite(low.ranges).mean() > 0.99 and low.sensor.height == pytest.approx(0.525)
    near = high.ranges[:, np.abs((high.sensor.bearings + np.pi) % (2 * np.pi) - np.pi) < 0.08]
    np.testing.assert_allclose(near, 1.5, atol=1e-3)
    assert not np.isposinf(high.ranges).any()  # no point in a slice is no missing return
    assert "points from 0.7 to 0.76 m above base_footprint" in high.meta["notes"]
    assert sg.read(tmp_path / "bag", slice=(0.4, 0.65)).n_scans == low.n_scans


def test_a_direction_without_a_point_is_a_missing_return_of_a_ring(tmp_path: Path) -> None:
    laser = Spinner(n=360)
    bag = [MOUNT]
    for k in range(6):
        columns = sweep(laser, k)
        columns["t"] = columns["t"] * 1e9
        bearing = np.arctan2(columns["y"], columns["x"])
        gone = (columns["ring"] == 2) & (bearing > 0.5) & (bearing < 0.9) & (k % 2 == 1)
        columns = {name: values[~gone] for name, values in columns.items()}
        if k % 3 == 0:
            for name in "xyz":  # some drivers keep a point without a return, at the origin
                columns[name][:3] = 0.0
        bag.append(cloud(0.1 * k, columns, KINDS))
    run = read(tmp_path, bag)
    bearings = (run.sensor.bearings + np.pi) % (2 * np.pi) - np.pi
    inside = (bearings > 0.53) & (bearings < 0.87)
    assert np.isposinf(run.ranges[1::2][:, inside]).all()
    assert np.isfinite(run.ranges[::2][:, inside]).all()


def test_a_planar_cloud_is_taken_whole(tmp_path: Path) -> None:
    """The points of a 2-D laser, in its frame and far from level with the base."""
    laser = Spinner(n=360, rings=(0.0,))
    bag = [transform(0.0, "base_link", "velodyne", 0, 0, 0, z=0.2, static=True)]
    for k in range(3):
        columns = sweep(laser, k)
        columns["z"] = columns["z"] + 0.31
        bag.append(cloud(0.1 * k, columns, {"x": "f4", "y": "f4", "z": "f4"}))
    run = read(tmp_path, bag)
    assert_exact(run, Spinner(), share=0.97)
    assert "all points, which lie in one plane" in run.meta["notes"]


def test_uneven_bearings_and_noise_cost_no_returns(tmp_path: Path) -> None:
    """With a jitter of 5% of a step, as many returns are missing as were left out."""
    rng, n = np.random.default_rng(3), 720
    bag = [MOUNT]
    for k in range(12):
        columns = sweep(Spinner(n=n), k)
        bearing = np.arctan2(columns["y"], columns["x"]) + 0.05 * 2 * np.pi / n * rng.normal(size=4 * n)
        distance = wall_distance(0.0, 0.0, bearing) + 0.02 * rng.normal(size=4 * n)
        columns |= {"x": distance * np.cos(bearing), "y": distance * np.sin(bearing), "t": columns["t"] * 1e9}
        kept = rng.random(4 * n) > 0.03
        bag.append(cloud(0.1 * k, {name: values[kept] for name, values in columns.items()}, KINDS))
    run = read(tmp_path, bag)
    assert run.sensor.n_rays == n
    assert np.isposinf(run.ranges).mean() == pytest.approx(0.03, abs=0.01)  # 3 standard errors of 3%
    error = error_of(run, Spinner())
    assert np.nanmedian(np.abs(error[np.isfinite(error)])) * 1.48 < 0.021  # no more than the noise


def test_a_sensor_that_looks_ahead_alone_has_rays_ahead_alone(tmp_path: Path) -> None:
    laser = Spinner(n=720, start=np.pi, sign=-1)
    bag = [MOUNT]
    for k in range(4):
        columns = sweep(laser, k)
        ahead = np.abs(np.arctan2(columns["y"], columns["x"])) < np.radians(45.2)  # between two firings
        columns = {name: values[ahead] for name, values in columns.items()}
        bag.append(cloud(0.1 * k, columns, {"x": "f4", "y": "f4", "z": "f4", "ring": "u2"}))
    run = read(tmp_path, bag)
    np.testing.assert_allclose(np.degrees(run.sensor.bearings[[0, -1]]), [-45, 45], atol=0.6)
    assert np.isfinite(run.ranges).all()


def test_a_cloud_is_read_only_where_no_laser_is_and_by_choice(tmp_path: Path) -> None:
    laser = Spinner(n=360)
    bag = [MOUNT, *spin(laser, 4), *(scan(0.1 * i, [1, 2, 3]) for i in range(4))]
    run = read(tmp_path, bag)
    assert run.sensor.n_rays == 3
    assert "range sensors that were not used: /points (4 scans)" in run.meta["notes"]
    assert read(tmp_path, bag, topics={"scan": "/points"}).sensor.n_rays == 360
    assert read(tmp_path, bag, slice=(0.0, 1.0)).meta["scan_topic"] == "/points"
    with pytest.raises(
        LogError, match=r"`slice` selects heights of a PointCloud2, but /scan is sensor_msgs/msg/LaserScan"
    ):
        read(tmp_path, bag, topics={"scan": "/scan"}, slice=(0.0, 1.0))
    with pytest.raises(LogError, match="no point is in the plane"):
        read(tmp_path, bag, slice=(50.0, 51.0))


def test_two_clouds_ask_for_a_choice_and_a_registered_one_is_refused(tmp_path: Path) -> None:
    laser = Spinner(n=90)
    two = [*spin(laser, 3, topic="/a"), *spin(laser, 3, topic="/b", frame="map")]
    with pytest.raises(
        LogError, match=r"has 2 scan topics; select one with `topics` scan=/a, `topics` scan=/b"
    ):
        read(tmp_path, two)
    assert read(tmp_path, two, topics={"scan": "/a"}).n_scans == 3
    with pytest.raises(LogError, match="/b is in the frame map, which does not move with the robot"):
        read(tmp_path, two, topics={"scan": "/b"})


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("mode", [None, "FILE", "MESSAGE"])
def test_the_second_reading_of_the_file_works_for_every_container(
    storage: str, mode: str | None, tmp_path: Path
) -> None:
    path = write_bag2(tmp_path / "bag", [MOUNT, *spin(Spinner(n=180), 3)], storage, mode=mode)
    assert_exact(logs.read(path), Spinner(), share=0.95)
    file = next(file for file in path.iterdir() if file.suffix != ".yaml")
    if mode is None:
        log = stream.open_log(file)
        (piece,) = log.pieces()
        assert piece.n_scans == log.n_scans == 3


def damaged(kind: str) -> Message:
    columns = sweep(Spinner(n=90), 0)
    topic, msgtype, at, data = cloud(0.0, columns, {"x": "f4", "y": "f4", "z": "f4"})
    if kind == "no z":
        return cloud(0.0, columns, {"x": "f4", "y": "f4"})
    if kind == "short":
        return topic, msgtype, at, data[:-800]
    if kind == "empty":
        return cloud(0.0, {name: values[:0] for name, values in columns.items()}, KINDS)
    return topic, msgtype, at, data[:30]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("no z", "a point has the fields x, y; expected x, y and z"),
        ("short", "is not a valid sensor_msgs/msg/PointCloud2"),
        ("empty", "no point is in the plane"),
        ("cut", "is not a valid sensor_msgs/msg/PointCloud2"),
    ],
)
def test_a_cloud_that_cannot_be_read_is_one_line(
    kind: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bag2(tmp_path / "bag", [damaged(kind)])
    with pytest.raises(LogError, match=words):
        logs.read(tmp_path / "bag")
    assert command(["locate", str(tmp_path / "bag")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_commands_take_the_slice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    laser = Spinner(rings=tuple(np.arange(-15, 16, 2.0)), n=180, v=0.5)
    bag = [MOUNT, *spin(laser, 12)]
    bag += [pose(0.05 * i, 0.025 * i, 0, 0) for i in range(30)] + [
        odometry(0.05 * i, 0.025 * i, 0, 0, 0.5) for i in range(30)
    ]
    path = str(write_bag2(tmp_path / "bag", bag))
    assert command(["inspect", path, "--slice", "0.3,0.6"]) == 0
    assert "points from 0.3 to 0.6 m above base_link" in capsys.readouterr().out
    for words in (["--slice", "0.6,0.3"], ["--slice", "a"], ["--slice", "1"]):
        assert command(["inspect", path, *words]) == 2
        assert "expected" in capsys.readouterr().err
    assert command(["inspect", path, "--topic", "scan=/points", "--slice", "9,10"]) == 2
    assert "choose other heights with --slice" in capsys.readouterr().err


def test_a_cloud_survives_as_a_run_of_ours(tmp_path: Path) -> None:
    run = read(tmp_path, [MOUNT, *spin(Spinner(n=180), 3)])
    logs.write(run, tmp_path / "run.mcap")
    again = logs.read(tmp_path / "run.mcap")
    np.testing.assert_array_equal(again.ranges, run.ranges)
    np.testing.assert_array_equal(again.intensities, run.intensities)
    assert again.sensor.sweep_time == pytest.approx(run.sensor.sweep_time)
    with pytest.raises(LogError, match=r"but /scan is sensor_msgs/msg/LaserScan"):
        logs.read(tmp_path / "run.mcap", slice=(0.0, 1.0))
    assert SCAN_TYPE == "sensor_msgs/msg/LaserScan"
