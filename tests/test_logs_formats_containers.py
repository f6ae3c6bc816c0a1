"""Folders and databases that are whole but not as expected: read with one warning, and nothing left next to them."""

from __future__ import annotations

import bz2
import gzip
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag1_samples import bag20, drive
from rosbag_samples import trip, write_bag1, write_bag2

import logs
from logs.inflation import ZSTD_MAGIC
from logs.notes import notes_of
from sensorgraph.cli import run as command


def edit(folder: Path, **changes: object) -> Path:
    """Change entries of the metadata.yaml of a folder."""
    path = folder / "metadata.yaml"
    about = yaml.safe_load(path.read_text())
    about["rosbag2_bagfile_information"] |= changes
    path.write_text(yaml.safe_dump(about))
    return folder


def data_file(folder: Path) -> Path:
    return next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))


def without_metadata(folder: Path) -> str:
    (folder / "metadata.yaml").unlink()
    return "metadata.yaml is missing"


def broken_metadata(folder: Path) -> str:
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [1, 2")
    return "metadata.yaml is not a file of rosbag2"


def renamed(folder: Path) -> str:
    data_file(folder).rename(folder / f"kitchen{data_file(folder).suffix}")
    return "which is missing, so the files in the folder were read: kitchen"


def counted(n: int) -> object:
    def change(folder: Path) -> str:
        edit(folder, message_count=n)
        return f"metadata.yaml states {n} messages, the files hold 41"

    return change


def stored_as(name: str) -> object:
    def change(folder: Path) -> str:
        edit(folder, storage_identifier=name)
        return f"metadata.yaml states the storage '{name}', the files are "

    return change


def without_files(folder: Path) -> str:
    edit(folder, relative_file_paths=[])
    return "metadata.yaml lists no files"


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize(
    "change",
    [
        without_metadata, broken_metadata, renamed, counted(3), counted(50), stored_as(""), stored_as("my_plugin"),
        without_files,
    ],
)  # fmt: skip
def test_a_whole_folder_with_wrong_metadata_is_read_with_one_warning(
    change: object, storage: str, tmp_path: Path
) -> None:
    whole = logs.read(write_bag2(tmp_path / "whole", trip(), storage))
    folder = write_bag2(tmp_path / "bag", trip(), storage)
    words = change(folder)  # type: ignore[operator]
    run = logs.read(folder)
    np.testing.assert_array_equal(run.ranges, whole.ranges)
    np.testing.assert_array_equal(run.poses, whole.poses)
    found = [note for note in notes_of(run) if "metadata.yaml" in note]
    assert len(found) == 1 and words in found[0]
    assert not any("metadata.yaml" in note for note in notes_of(whole))


def split(tmp_path: Path, storage: str) -> tuple[Path, list[Path]]:
    """Eleven parts whose order by number differs from their order by name."""
    folder = tmp_path / "parts"
    folder.mkdir()
    messages, files = trip(), []
    for k in range(11):
        part = write_bag2(tmp_path / f"one{k}", messages[4 * k : 4 * k + 4], storage)
        files.append(data_file(part).rename(folder / f"drive_{k}{data_file(part).suffix}"))
    return folder, files


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_parts_are_read_in_the_order_of_their_numbers(storage: str, tmp_path: Path) -> None:
    folder, files = split(tmp_path, storage)
    whole = logs.read(write_bag2(tmp_path / "whole", trip(), storage))
    run = logs.read(folder)
    np.testing.assert_array_equal(run.stamps, whole.stamps)
    np.testing.assert_array_equal(run.ranges, whole.ranges)
    assert not any("go back" in note for note in notes_of(run))
    # metadata.yaml of the first parts alone: the others belong to the same log
    about = {"relative_file_paths": [file.name for file in files[:2]], "message_count": 8}
    about["storage_identifier"] = "mcap" if storage == "MCAP" else "sqlite3"
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    run = logs.read(folder)
    np.testing.assert_array_equal(run.ranges, whole.ranges)
    assert any("does not list drive_2" in note for note in notes_of(run))


def test_names_with_the_folder_of_the_recorder_are_found(tmp_path: Path) -> None:
    """Early recorders listed `folder/file`, and the folder was renamed since."""
    folder = write_bag2(tmp_path / "bag", trip(), "SQLITE3")
    edit(folder, relative_file_paths=[f"rosbag2_2021/{data_file(folder).name}"])
    run = logs.read(folder)
    assert run.n_scans == 10
    assert not any("metadata.yaml" in note for note in notes_of(run))


def test_a_part_that_is_missing_is_not_passed_over(tmp_path: Path) -> None:
    folder, files = split(tmp_path, "MCAP")
    about = {"relative_file_paths": [file.name for file in files], "storage_identifier": "mcap"}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    files[5].unlink()
    with pytest.raises(
        logs.LogError, match=r"lists drive_5\.mcap, which is missing; copy the complete folder"
    ):
        logs.read(folder)


def test_unrelated_logs_in_a_folder_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_bag2(tmp_path / "bag", trip())
    (folder / "metadata.yaml").unlink()
    data_file(folder).rename(folder / "monday.mcap")
    data_file(write_bag2(tmp_path / "other", trip())).rename(folder / "tuesday.mcap")
    assert command(["inspect", str(folder)]) == 2
    assert "holds 2 unrelated logs: monday.mcap, tuesday.mcap; give one of them" in capsys.readouterr().err
    assert logs.read(folder / "tuesday.mcap").n_scans == 10
    (folder / "tuesday.mcap").rename(folder / "monday.mcap.located.mcap")  # made from the other
    assert logs.read(folder).n_scans == 10


def test_a_folder_of_ros_1_bags_that_were_split_is_one_log(tmp_path: Path) -> None:
    folder = tmp_path / "bags"
    folder.mkdir()
    samples = drive()
    for k, name in enumerate(("run_2026-01-02-10-59-58_0", "run_2026-01-02-11-03-00_1")):
        (folder / f"{name}.bag").write_bytes(bag20(samples[26 * k : 26 * k + 26]))
    run = logs.read(folder)
    np.testing.assert_array_equal(run.ranges[:, 0], np.float32(1 + np.arange(25) / 100))


def test_compressed_files_and_messages_are_seen_without_metadata(tmp_path: Path) -> None:
    for mode in ("FILE", "MESSAGE"):
        folder = write_bag2(tmp_path / mode, trip(), "SQLITE3", mode=mode)
        (folder / "metadata.yaml").unlink()
        assert logs.read(folder).n_scans == 10
    assert data_file(tmp_path / "MESSAGE").read_bytes().count(ZSTD_MAGIC) > 10
    assert logs.read(data_file(tmp_path / "MESSAGE")).n_scans == 10


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_an_empty_last_part_is_no_damage(storage: str, tmp_path: Path) -> None:
    folder, files = split(tmp_path, storage)
    last = folder / f"drive_11{files[0].suffix}"
    last.write_bytes(b"")
    assert logs.read(folder).n_scans == 10
    about = {"relative_file_paths": [file.name for file in (*files, last)]}
    about["storage_identifier"] = "mcap" if storage == "MCAP" else "sqlite3"
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    run = logs.read(folder)
    assert run.n_scans == 10
    assert f"{last.name} is empty" in notes_of(run)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress], ids=["gzip", "bzip2"])
@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_a_binary_log_that_is_compressed_as_a_whole_is_named(
    kind: str, pack: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    if kind == "bag":
        data = write_bag1(tmp_path / "a.bag", trip()).read_bytes()
    else:
        data = data_file(
            write_bag2(tmp_path / "bag", trip(), "MCAP" if kind == "mcap" else "SQLITE3")
        ).read_bytes()
    path = tmp_path / f"a.{kind}.packed"
    path.write_bytes(pack(data))
    with pytest.raises(logs.LogError, match=r"compressed as a whole; decompress it: (gunzip|bunzip2) -k"):
        logs.read(path)


def in_wal_mode(file: Path, *, n_pending: int = 0) -> Path:
    """Set a database to WAL mode as ROS 2 does; leave the last messages in its -wal file, as a crash does."""
    base = sqlite3.connect(file)
    base.execute("PRAGMA journal_mode=WAL")
    if n_pending:
        rows = base.execute("SELECT * FROM messages ORDER BY id DESC LIMIT ?", (n_pending,)).fetchall()
        base.execute("DELETE FROM messages WHERE id > (SELECT max(id) FROM messages) - ?", (n_pending,))
        base.commit()
        base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        base.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(rows[0]))})", rows)
        base.commit()
        copies = {
            path: path.read_bytes() for path in file.parent.iterdir() if path.name.startswith(file.name)
        }
        base.close()
        for path, data in copies.items():
            path.write_bytes(data)
        file.with_name(file.name + "-shm").unlink()
    else:
        base.close()
    assert file.read_bytes()[18:20] == b"\x02\x02"
    return file


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


@pytest.mark.parametrize("pending", ["none", "messages", "empty wal and old shm"])
def test_a_database_in_wal_mode_is_read_and_nothing_is_written_next_to_it(
    pending: str, tmp_path: Path
) -> None:
    file = data_file(write_bag2(tmp_path / "bag", trip(), "SQLITE3"))
    in_wal_mode(file, n_pending=12 if pending == "messages" else 0)
    if pending.startswith("empty"):
        file.with_name(file.name + "-wal").write_bytes(b"")
        file.with_name(file.name + "-shm").write_bytes(bytes(32768))
    before = contents(file.parent)
    for path in (file, file.parent):
        assert logs.read(path).n_scans == 10
    assert contents(file.parent) == before


def test_a_folder_without_logs_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(logs.LogError, match=r"is a folder without a log .it holds notes\.txt.; expected"):
        logs.read(tmp_path)


def test_a_bag_written_by_others_has_the_same_values(tmp_path: Path) -> None:
    run, other = (
        logs.read(write_bag1(tmp_path / "a.bag", trip())),
        logs.read(write_bag2(tmp_path / "b", trip())),
    )
    np.testing.assert_array_equal(run.ranges, other.ranges)
    np.testing.assert_array_equal(run.poses, other.poses)
    np.testing.assert_array_equal(run.commands, other.commands)
