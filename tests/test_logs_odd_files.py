"""Files that are not what their names say, texts of spreadsheets, and messages that are not those of ROS."""

from __future__ import annotations

import io
import lzma
import os
import sqlite3
import tarfile
import zipfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbag_samples import trip, write_bag2

import logs
from logs.inspection import inspect
from sensorgraph.cli import run as command_line
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.graph_file import write_members

ROWS = "# bearings: -1 to 1 in 3\n# range_max: 8.0\nt,x,y,phi,r0,r1,r2\n0,0,0,0,1.25,2,3\n0.5,1,0,0.5,1,2,\n"


def archive(kind: str) -> bytes:
    out = io.BytesIO()
    if kind == "npz":
        np.savez(out, ranges=np.ones((2, 3)))
    elif kind == "zip":
        with zipfile.ZipFile(out, "w") as packed:
            packed.writestr("run.mcap", b"nothing")
    else:
        with tarfile.open(fileobj=out, mode=kind) as bundle:  # type: ignore[call-overload]
            bundle.addfile(tarfile.TarInfo("run.mcap"), io.BytesIO())
    return out.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (archive("zip"), "is a zip archive; unpack it"),
        (archive("npz"), r"is a numpy archive \(npz\); give the log from"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(90), "is a MATLAB file; give the log from"),
        (b"PAR1" + bytes(20) + b"PAR1", "is a Parquet table"),
        (archive("w"), "is a tar archive; unpack it"),
        (archive("w:gz"), "is a tar archive; unpack it"),
        (lzma.compress(b"a log"), "is compressed with xz"),
        (b"<!DOCTYPE html><html>Quota exceeded</html>", "is a web page and not the log"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n", "is a pointer of Git LFS"),
        (b"/annex/objects/MD5E-s111--abcdef.bag\n", "is a pointer of git-annex"),
        (b"\xd4\xc3\xb2\xa1" + bytes(20), "is a capture of network packets"),
        (b"<?xml version='1.0'?><gazebo_log><header/></gazebo_log>", "is a log of Gazebo's states"),
        (b"<robot name='a'/>", "is an XML file"),
        (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b" + bytes(20), "is a map of Cartographer .pbstream.; give the log from"),
        (b"\x16" + bytes(7) + b"serialization::archive", "is a pose graph of slam_toolbox"),
        (b"# stamp x y z\n" + 3 * b"1.5 1 2 0 0 0 0.6 0.8\n", "is a trajectory .TUM: stamp x y z"),
        (3 * b"1 0 0 5 0 1 0 6 0 0 1 0\n", "is a trajectory .KITTI: 3 x 4 matrices"),
        (b"VERTEX_SE2 0 1 2 0.5\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", "is a pose graph .g2o or TORO., without scans"),
        (b"t,x,y,phi\n0,1,2,3\n1,1,2,3\n", "is a table without ranges .its columns are t, x, y, phi."),
        (b"__time,/scan/ranges[0],/scan/ranges[1]\n0.1,2,3\n0.2,2,3\n", "is a table of a LaserScan topic .with the column /scan/ranges.0.."),
        (b"Time,angle_min,ranges_0,ranges_1\n0.1,-1,2,3\n0.2,-1,2,3\n", "is a table of a LaserScan topic .with the column ranges_0."),
        (b"header:\n  stamp:\nangle_min: -1\n", "is a text printed by `ros2 topic echo`"),
        (b'{"type": "FeatureCollection"}', "is an arena .GeoJSON.; give a log here, and the arena with --arena"),
        (b"image: a.pgm\nresolution: 0.05\n", "is a map of map_server; give a log here, and the map with --arena"),
    ],
    ids=[
        "zip", "npz", "mat", "parquet", "tar", "tar.gz", "xz", "web page", "git lfs", "git annex", "pcap", "gazebo", "xml", "pbstream", "posegraph",
        "tum", "kitti", "g2o", "table", "plotjuggler", "bagpy", "echo", "geojson", "map",
    ],  # gzip holds the time
)  # fmt: skip
def test_a_file_that_is_given_for_a_log_is_named(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    path.write_bytes(data)
    with pytest.raises(logs.LogError, match=words):
        logs.read(path)


@pytest.mark.parametrize("text", [b"hello, world, all\n", b"1 2 3 4\n5 6 7 8\n", b"8 9 9 9 9 9 9 9\n" * 3])
def test_other_texts_are_not_taken_for_tables_or_trajectories(text: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(text)
    with pytest.raises(logs.LogError, match="is not a known log"):
        logs.read(tmp_path / "a.txt")


def test_a_database_of_another_program_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "state.tlog"
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE topics (id INTEGER, name TEXT, message_type_id INTEGER)")
        base.execute("CREATE TABLE messages (id INTEGER, time_recv INTEGER, message BLOB)")
        base.execute("CREATE VIEW all_topics AS SELECT * FROM topics")
    with pytest.raises(
        logs.LogError, match=r"of another program than rosbag2 .its tables are messages, topics."
    ):
        logs.read(path)


def test_the_logs_in_a_folder_of_folders_are_listed(tmp_path: Path) -> None:
    for name in ("monday", "friday"):
        write_bag2(tmp_path / name, trip()[:3])
    with pytest.raises(logs.LogError, match="with the logs friday, monday; give one of them"):
        logs.read(tmp_path)


def test_a_sensorgraph_and_a_log_that_are_exchanged_are_named(tmp_path: Path) -> None:
    graph = tmp_path / "a.sensorgraph"
    write_members(graph, {"format": "sensorgraph"}, {})
    with pytest.raises(
        logs.LogError, match="is a sensorgraph; give a log here, and the sensorgraph where --help says GRAPH"
    ):
        logs.read(graph)
    (bag,) = write_bag2(tmp_path / "bag", trip()[:3]).glob("*.mcap")
    with pytest.raises(SensorgraphError, match=r"is a log .mcap. and no sensorgraph; build one from it"):
        Sensorgraph.load(bag)


@pytest.mark.parametrize(
    ("kind", "n", "words"),
    [
        (
            "sensor_msgs/msg/PointCloud",
            1,
            "sensor_msgs/msg/PointCloud is not read: replay the log, let a node",
        ),
        ("velodyne_msgs/msg/VelodyneScan", 1, "let velodyne_pointcloud publish a PointCloud2"),
        ("livox_ros_driver2/msg/CustomMsg", 1, "let a converter of Livox messages publish a PointCloud2"),
        ("sensor_msgs/msg/LaserScan", 0, "/scan .sensor_msgs/msg/LaserScan, no messages."),
    ],
)
def test_range_sensors_that_are_not_read_are_named(kind: str, n: int, words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/scan", "cdr", writer.register_schema(kind, "ros2msg", b""))
        for i in range(n):
            writer.add_message(channel, i, bytes(40), i)
        writer.finish()
    with pytest.raises(logs.LogError, match=words):
        logs.read(path)


def test_the_metadata_of_a_bag_and_a_pipe_are_refused_with_what_to_give(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag2(tmp_path / "bag", trip())
    assert command_line(["inspect", str(bag / "metadata.yaml")]) == 2
    assert f"give the folder: {bag}" in capsys.readouterr().err
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(logs.LogError, match="is a pipe, and a log is read more than once"):
        logs.read(pipe)


@pytest.mark.parametrize(
    ("separator", "decimal", "encoding", "end"),
    [
        (",", ".", "utf-8-sig", "\r\n"),
        (";", ".", "utf-8", "\n"),
        (";", ",", "utf-8-sig", "\r\n"),
        ("\t", ",", "utf-16", "\r\n"),
    ],
)
def test_a_table_of_a_spreadsheet_is_read(
    separator: str, decimal: str, encoding: str, end: str, tmp_path: Path
) -> None:
    (tmp_path / "plain.csv").write_text(ROWS)
    comments, rows = ROWS.splitlines()[:2], ROWS.splitlines()[2:]
    table = [",".join(f'"{cell}"' for cell in row.split(",")) for row in rows] if separator == "," else rows
    table = [row.replace(",", separator).replace(".", decimal) if separator != "," else row for row in table]
    text = end.join([*(line + 3 * separator for line in comments), *table]) + end
    (tmp_path / "sheet.csv").write_bytes(text.encode(encoding))
    plain, sheet = logs.read(tmp_path / "plain.csv"), logs.read(tmp_path / "sheet.csv")
    np.testing.assert_array_equal(sheet.ranges, plain.ranges)
    np.testing.assert_array_equal(sheet.poses, plain.poses)
    np.testing.assert_array_equal(sheet.sensor.bearings, plain.sensor.bearings)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_carmen_log_with_a_byte_order_mark_is_read(encoding: str, tmp_path: Path) -> None:
    lines = [f"FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 {i / 10} host {i / 10}" for i in range(5)]
    (tmp_path / "a.log").write_bytes("\n".join(lines).encode(encoding))
    assert logs.read(tmp_path / "a.log").n_scans == 5


@pytest.mark.parametrize("kind", ["foxglove.LaserScan", "sensor_msgs/msg/LaserScan"])
def test_messages_in_an_encoding_that_is_not_read_are_named(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(kind, "jsonschema", b"{}")
        channel = writer.register_channel("/scan", "json", schema)
        writer.add_message(channel, 1, b'{"ranges": [1, 2, 3]}', 1)
        writer.finish()
    said = " ".join(inspect(path).missing)
    assert f"/scan ({kind} (json))" in said
    assert "messages in json are not read" in said
