"""Files that are not what their names say, texts of spreadsheets, and messages that are not those of ROS."""

from __future__ import annotations

import io
import lzma
import os
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbag_samples import trip, write_bag2

import logs
from logs.inspection import inspect
from sensorgraph.cli import run as command_line

ROWS = "# bearings: -1 to 1 in 3\n# range_max: 8.0\nt,x,y,phi,r0,r1,r2\n0,0,0,0,1.25,2,3\n0.5,1,0,0.5,1,2,\n"


def archive(kind: str) -> bytes:
    out = io.BytesIO()
    if kind == "zip":
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
        (archive("w"), "is a tar archive; unpack it"),
        (archive("w:gz"), "is a tar archive; unpack it"),
        (lzma.compress(b"a log"), "is compressed with xz"),
        (b"<!DOCTYPE html><html>Quota exceeded</html>", "is a web page and not the log"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n", "is a pointer of Git LFS"),
        (b"/annex/objects/MD5E-s111--abcdef.bag\n", "is a pointer of git-annex"),
        (b"\xd4\xc3\xb2\xa1" + bytes(20), "is a capture of network packets"),
    ],
    ids=["zip", "tar", "tar.gz", "xz", "web page", "git lfs", "git annex", "pcap"],  # gzip holds the time
)
def test_a_file_that_is_given_for_a_log_is_named(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    path.write_bytes(data)
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
