"""Files that cannot be read, of every kind: one clear line and exit code 2, and nothing left behind."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from logs_samples import some_run

import logs
from logs.mcap.records import MAGIC
from logs.ros.messages import scan_messages
from sensorgraph.cli import run as command

N_SCANS = 60


ORIGINAL = some_run(N_SCANS, 361, seed=3)  # several chunks


def _bag2(path: Path, storage: str) -> None:
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(path, version=8, storage_plugin=StoragePlugin[storage]) as writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        rows = scan_messages(ORIGINAL.sensor, np.arange(60, dtype=np.int64) * 10**8 + 10**18, ORIGINAL.ranges)
        for i, row in enumerate(rows):
            writer.write(connection, 10**18 + i * 10**8, row.tobytes())


def _make_text(path: Path) -> None:
    path.write_text("hello, this is no log\n" * 20)


def _make_png(path: Path) -> None:
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(300))


def _make_binary(path: Path) -> None:
    path.write_bytes(np.random.default_rng(0).bytes(5000))


def _make_folder(path: Path) -> None:
    path.mkdir()
    (path / "something.txt").write_text("x")


def _make_bad_metadata(path: Path) -> None:
    path.mkdir()
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: [1, 2")


def _make_foreign_metadata(path: Path) -> None:
    path.mkdir()
    (path / "metadata.yaml").write_text("name: x\n")


def _make_lost_file(path: Path) -> None:
    _bag2(path, "MCAP")
    next(path.glob("*.mcap")).unlink()


def _make_cut_sqlite(path: Path) -> None:
    _bag2(path, "SQLITE3")
    base = next(path.glob("*.db3"))
    base.write_bytes(base.read_bytes()[:20000])


def _make_cut_bag_mcap(path: Path) -> None:
    _bag2(path, "MCAP")
    file = next(path.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-3000])


def _make_cut_ros1(path: Path) -> None:
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(200))


def _make_cut_gzip(path: Path) -> None:
    line = "FLASER 3 1.00 2.00 3.00 0 0 0 0 0 0 1.0 host 1.0\n"
    noise = "# " + np.random.default_rng(0).bytes(3000).hex() + "\n"
    path.write_bytes(gzip.compress((line * 50 + noise + line * 50).encode(), mtime=0)[:-900])


def _make_flipped_gzip(path: Path) -> None:
    data = bytearray(gzip.compress(b"FLASER 3 1.00 2.00 3.00 0 0 0 0 0 0 1.0 host 1.0\n" * 50, mtime=0))
    data[-6] ^= 0xFF
    path.write_bytes(data)


def _make_broken_carmen(path: Path) -> None:
    path.write_text("FLASER 180 1.0 2.0\n" * 5)


def _make_carmen_without_scans(path: Path) -> None:
    path.write_text("PARAM a b\nODOM 0 0 0 0 0 0 1.0 h 1.0\n")


def _make_cut_table(path: Path) -> None:
    logs.write(some_run(), path.with_suffix(".csv"))
    path.write_bytes(path.with_suffix(".csv").read_bytes()[:-40])


def _make_short_table(path: Path) -> None:
    logs.write(some_run(), path.with_suffix(".csv"))
    lines = path.with_suffix(".csv").read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))


def _make_unreadable_number(path: Path) -> None:
    path.write_text("# bearings: -1 to 1 in 2\nt,r0,r1\n0.0,1.0,two\n")


def _make_odd_json(path: Path) -> None:
    path.write_text("{}")


UNREADABLE: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": _make_text,
    "png": _make_png,
    "random bytes": _make_binary,
    "json": _make_odd_json,
    "missing": lambda path: None,
    "folder without metadata.yaml": _make_folder,
    "folder with broken metadata.yaml": _make_bad_metadata,
    "folder with other metadata.yaml": _make_foreign_metadata,
    "bag whose file is gone": _make_lost_file,
    "cut sqlite bag": _make_cut_sqlite,
    "bag with cut mcap": _make_cut_bag_mcap,
    "broken ROS 1 bag": _make_cut_ros1,
    "cut gzip": _make_cut_gzip,
    "flipped gzip": _make_flipped_gzip,
    "one byte of gzip": lambda path: path.write_bytes(b"\x1f\x8b"),
    "carmen with broken lines only": _make_broken_carmen,
    "carmen without scans": _make_carmen_without_scans,
    "table cut in a row": _make_cut_table,
    "table that lacks a row": _make_short_table,
    "table with a word": _make_unreadable_number,
    "magic only": lambda path: path.write_bytes(MAGIC),
    "magic twice": lambda path: path.write_bytes(MAGIC * 2),
}


def one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    code = command(arguments)
    captured = capsys.readouterr()
    assert code == 2, captured
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1, captured.err
    assert captured.out == ""
    return captured.err


@pytest.mark.parametrize("kind", UNREADABLE)
def test_unreadable_file_gives_one_line_and_exit_2(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.mcap"
    UNREADABLE[kind](path)
    with pytest.raises((logs.LogError, FileNotFoundError)):
        logs.read(path)
    assert "log" in one_line(["inspect", str(path)], capsys)
    out = tmp_path / "out.mcap"
    one_line(["recover", str(path), "-o", str(out)], capsys)
    assert not out.exists() and not list(tmp_path.glob("*.part"))


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_file_without_permission_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC)
    path.chmod(0)
    one_line(["inspect", str(path)], capsys)
