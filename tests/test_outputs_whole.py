"""An output is whole or not there: on a full disk, beside another writer, after a mistake, and for one run named twice."""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import logs
from logs.files import atomic_file
from logs.formats.mcap_file import RosFile
from logs.run import RangeSensor, Run
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.files import atomic_folder
from sensorgraph.show.rerun_file import DISPLAYS, open_viewer

pytestmark = pytest.mark.usefixtures("trusted_scans")


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """Let no file grow beyond `size` [bytes], as a disk with so much room left."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    "command",
    [
        "record {made}/plan --arena square -o {out}/a.mcap",
        "build {made}/run.mcap --no-calibrate -o {out}/a.sensorgraph",
        "evaluate {made}/g.sensorgraph {made}/run.mcap --json {out}/a.json",
        "predict {made}/g.sensorgraph --poses {made}/poses.csv -o {out}/a.npz",
        "review {made}/run.mcap --graph {made}/g.sensorgraph -o {out}/a.rrd",
        "inspect {made}/run.mcap --json {out}/a.json",
        "recover {made}/run.mcap -o {out}/a.mcap",
        "identify {made}/run.mcap --output v --inputs cmd_v --lags 1 -o {out}/a.json",
    ],
)
def test_a_full_disk_is_one_line_and_leaves_nothing(
    command: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command.format(made=made, out=tmp_path).split()
    assert cli(words) == 0
    sizes = []
    for written in tmp_path.iterdir():  # identify draws a picture beside its model
        sizes.append(written.stat().st_size)
        written.unlink()
    capsys.readouterr()
    for room in (0, min(sizes) // 2):
        with full_disk(room):
            code = cli(words)
        *_, line = lines = capsys.readouterr().err.strip().splitlines()
        errors = [said for said in lines if said.startswith("error: ")]  # the others tell of progress
        assert (code, errors) == (2, [line]), (room, lines)
        assert not list(tmp_path.iterdir()), room


def test_a_plan_is_saved_whole_or_not_at_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["plan", "square", "--planner", "random_bounce", "--duration", "10", "-o"]
    with full_disk(5000):
        assert cli([*words, str(tmp_path / "new" / "plan")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_table_that_cannot_be_written_leaves_nothing(made: Path, tmp_path: Path) -> None:
    run = logs.read(made / "run.mcap")
    with full_disk(100), pytest.raises(OSError, match=r"large|space"):
        logs.write(run, tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "command",
    [
        "diagnose {made}/nothing.mcap --arena square -o {out}/new/report",
        "diagnose {made}/run.mcap --arena nowhere -o {out}/new/report",
        "plan nowhere -o {out}/new/plan",
        "plan square --start 0,0,0 -o {out}/new/plan",
    ],
)
def test_a_command_that_fails_leaves_no_folder(command: str, made: Path, tmp_path: Path) -> None:
    assert cli(command.format(made=made, out=tmp_path).split()) == 2
    assert not list(tmp_path.iterdir())


def test_a_folder_is_removed_after_a_failure_only_if_it_was_made_for_it(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    for folder in (tmp_path / "old", tmp_path / "old" / "deep" / "new"):
        with pytest.raises(RuntimeError), atomic_folder(folder) as part:
            (part / "a").write_text("half")
            raise RuntimeError
    assert [p.name for p in tmp_path.rglob("*")] == ["old"]


def test_two_writers_of_one_file_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with atomic_file(path) as first, atomic_file(path) as second:
        first.write_text("first")
        second.write_text("second")
    assert path.read_text() in ("first", "second")
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_of_one_folder_do_not_mix(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "a") as first:
        (first / "x").write_text("first")
        with pytest.raises(RuntimeError), atomic_folder(tmp_path / "a") as second:
            (second / "y").write_text("second")
            raise RuntimeError
    assert [(p.name, p.read_text()) for p in (tmp_path / "a").iterdir()] == [("x", "first")]


def test_two_recordings_under_one_name_are_whole_and_one_that_was_killed_stays(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    (tmp_path / "run.mcap.part").write_bytes(b"of a killed recorder")
    sensor = RangeSensor(bearings=np.linspace(-1, 1, 5), range_min=0.1, range_max=8.0)
    run = Run(sensor=sensor, stamps=np.arange(20) / 10.0, ranges=np.ones((20, 5)))
    with RosFile(path) as idle, RosFile(path) as busy:
        assert idle.part != busy.part
        logs.write(run, path)
        busy.describe("x", {})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mcap", "run.mcap.part"]
    assert (tmp_path / "run.mcap.part").read_bytes() == b"of a killed recorder"


@pytest.mark.slow
def test_two_commands_at_once_leave_a_whole_output(made: Path, tmp_path: Path) -> None:
    code = "import sys; from sensorgraph.cli import main; main()"
    words = [sys.executable, "-c", code, "record", str(made / "plan"), "--arena", "square"]
    both = [subprocess.Popen([*words, "-o", str(tmp_path / "a.mcap")], stdout=subprocess.PIPE) for _ in "12"]
    for process in both:
        process.communicate()
    assert [process.returncode for process in both] == [0, 0]
    assert (tmp_path / "a.mcap").read_bytes() == (made / "run.mcap").read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_a_run_is_fitted_once(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, out = str(made / "run.mcap"), str(tmp_path / "a.sensorgraph")
    assert cli(["build", run, run, "-o", out]) == 2
    assert "given twice" in capsys.readouterr().err
    copy = shutil.copy(run, tmp_path / "copy.mcap")
    assert cli(["build", run, str(copy), "-o", out]) == 2
    assert "holds the same scans as run.mcap" in capsys.readouterr().err
    with pytest.raises(SensorgraphError, match="same scans"):
        import sensorgraph as sg

        sg.build([run, run])
    assert [p.name for p in tmp_path.iterdir()] == ["copy.mcap"]


def test_the_viewer_is_the_one_of_this_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_folder = tmp_path / "env" / "bin"
    bin_folder.mkdir(parents=True)
    monkeypatch.setattr(sys, "executable", str(bin_folder / "python"))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("DISPLAY", ":0")
    with pytest.raises(SensorgraphError, match=r"no viewer: .*env/bin/rerun"):
        open_viewer(tmp_path / "a.rrd")
    viewer = bin_folder / "rerun"
    viewer.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/seen\n')
    viewer.chmod(0o755)
    open_viewer(tmp_path / "a.rrd").wait()
    assert (tmp_path / "seen").read_text() == f"--bind 127.0.0.1 {tmp_path}/a.rrd\n"
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(SensorgraphError, match=r"needs a display; .*a\.rrd is written: .*--serve"):
        open_viewer(tmp_path / "a.rrd")


def test_a_review_holds_the_same_data_each_time(made: Path, tmp_path: Path) -> None:
    for name in "ab":
        assert cli(["review", str(made / "run.mcap"), "-o", str(tmp_path / f"{name}.rrd")]) == 0
    rerun = Path(sys.executable).with_name("rerun")
    said = subprocess.run(
        [rerun, "rrd", "compare", tmp_path / "a.rrd", tmp_path / "b.rrd"], capture_output=True
    )
    assert said.returncode == 0, said.stderr.decode()
