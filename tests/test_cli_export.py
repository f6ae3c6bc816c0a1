"""`sensorgraph export` and the script in an exported folder say in one line what is wrong, and leave nothing behind."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from logs_samples import some_run

import logs
from planners.maps import geojson
from sensorgraph.cli import run as cli
from sensorgraph.cli.twin import run_script
from sensorgraph.exporting.export import TARGETS
from sensorgraph.loading import load_arena
from sensorgraph.world.robot import load_robot

BROKEN = "broken.yaml"
ROBOT = "{name: mover, footprint_radius: 0.31}"


def test_a_script_says_what_it_lacks_before_it_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def script(*arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", ["drive.py", *arguments])
        with pytest.raises(SystemExit, match="2"):
            run_script(tmp_path, lambda: pytest.fail("it drove"), "scene.xml")
        return capsys.readouterr().err

    assert "scene.xml is missing; export the world again" in script("plan")
    for name in ("scene.xml", "arena.geojson", "robot.yaml"):
        (tmp_path / name).touch()
    assert "does not exist; create it" in script("plan", "-o", str(tmp_path / "nowhere" / "run.mcap"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["square", "--to", "mujco"], "did you mean mujoco?"),
        (["square", "--to", "isaac"], ", ".join(TARGETS)),
        (["nowhere", "--to", "irsim"], "nowhere does not exist"),
        (["square", "--to", "irsim", "--no-go", "1,1,2,1,2,2"], "require --to nav2"),
        (["square", "--to", "nav2", "--no-go", "91,91,92,91,92,92"], "no no-go zone lies in the arena"),
        (["square", "--to", "gazebo", "--wall-height", "-1"], "expected a height"),
        (["square", "--to", "mujoco", "--effects", "nowhere.yaml"], "nowhere.yaml does not exist"),
        (["square", "--to", "mujoco", "--effects", BROKEN], "not YAML"),
        ([BROKEN, "--to", "mujoco"], "broken.yaml"),
        (["square", "--to", "nav2", "--run", "nowhere.mcap"], "nowhere.mcap: No such file"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(BROKEN).write_text(": [\n")
    assert cli(["export", *arguments, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert words in said[0]
    assert not (tmp_path / "out").exists()


def test_the_robot_kept_in_a_log_is_exported_with_its_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = {"arena.geojson": geojson.dumps(load_arena("square")).encode(), "robot.yaml": ROBOT.encode()}
    log = tmp_path / "run.mcap"
    logs.write(replace(some_run(), attachments=kept), log)
    for source, text in (
        (str(log), f"mover is the robot kept in {log}; --robot gives another\n"),
        ("square", "radix is the shipped robot; --robot gives another\n"),
    ):
        assert cli(["export", source, "--to", "irsim", "-o", str(tmp_path / text[:5])]) == 0
        assert text in capsys.readouterr().out
    assert load_robot(tmp_path / "mover" / "robot.yaml").footprint_radius == 0.31


def test_an_output_that_is_a_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert cli(["export", "square", "--to", "nav2", "-o", str(tmp_path / "file")]) == 2
    assert "is a file; give the name of a folder" in capsys.readouterr().err
