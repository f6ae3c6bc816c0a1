"""`plan` as a user runs it: files of INTERFACE.md, same seed same bytes, mistakes in one line."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from planners_samples import shipped

from planners.check import check
from planners.robot import Robot
from planners.trajectory import read_csv
from sensorgraph.cli import run as cli

COARSE = ("--cell", "0.5", "--headings", "8")
KEYS = {
    "grid", "start", "coverage", "core_coverage", "reachable_cells", "covered_cells", "drive_time_s", "t_ref_s",
    "ratio", "path_m", "planning_s", "seed", "min_clearance_m", "limit_violations", "joins",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plans") / "new" / "square"
    assert cli(["plan", "square", *COARSE, "--seed", "4", "-o", str(out)]) == 0
    return out


def test_the_folder_holds_every_promised_file_and_nothing_half_written(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert {"trajectory.csv", "waypoints.yaml", "plan.json", "plan.png", "plan.mcap"} <= names
    assert not [name for name in names if name.endswith(".part")]
    assert [path.name for path in folder.parent.iterdir()] == ["square"]
    assert (folder / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert yaml.safe_load((folder / "waypoints.yaml").read_text())["frame_id"] == "map"


def test_plan_json_keeps_its_keys_and_agrees_with_the_trajectory(folder: Path) -> None:
    report = json.loads((folder / "plan.json").read_text())
    assert set(report) >= KEYS
    assert report["grid"] == {"origin": [0.0, 0.0], "cell": 0.5, "headings": 8}
    assert set(report["joins"]) >= {"direct", "planned", "failed", "planned_m"}
    trajectory = read_csv(folder / "trajectory.csv")
    assert report["drive_time_s"] == pytest.approx(trajectory.duration)
    assert report["path_m"] == pytest.approx(trajectory.length, rel=1e-3)
    np.testing.assert_allclose(report["start"][:2], trajectory.poses[0, :2], atol=1e-6)
    assert np.cos(report["start"][2] - trajectory.poses[0, 2]) == pytest.approx(1.0, abs=1e-11)
    assert report["ratio"] == pytest.approx(report["drive_time_s"] / report["t_ref_s"])
    assert report["seed"] == 4
    assert report["arena"] == "square"
    assert np.diff(trajectory.stamps).max() <= 0.02 + 1e-9
    assert check(trajectory, shipped("square"), Robot()).count == 0


def test_same_seed_same_bytes(folder: Path, tmp_path: Path) -> None:
    assert cli(["plan", "square", *COARSE, "--seed", "4", "-o", str(tmp_path)]) == 0
    for name in ("trajectory.csv", "waypoints.yaml"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    one, other = (json.loads((at / "plan.json").read_text()) for at in (folder, tmp_path))
    assert one | {"planning_s": 0} == other | {"planning_s": 0}


def test_a_plan_recorded_and_resumed_leaves_little_to_do(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run.mcap"
    assert cli(["record", str(folder), "--arena", "square", "-o", str(run)]) == 0
    capsys.readouterr()
    code = cli(["plan", "square", *COARSE, "--resume", str(run), "-o", str(tmp_path / "rest")])
    said = capsys.readouterr()
    if code == 0:
        report = json.loads((tmp_path / "rest" / "plan.json").read_text())
        assert report["coverage_before"] > 0.9
        assert report["coverage"] >= 0.999
    else:
        assert code == 2
        assert "nothing is left to plan" in said.err


def test_baselines_take_a_duration(tmp_path: Path) -> None:
    options = ["--planner", "random_bounce", "--duration", "60", "--start", "0.5,0.5,0.1", *COARSE]
    assert cli(["plan", "square", *options, "-o", str(tmp_path)]) == 0
    trajectory = read_csv(tmp_path / "trajectory.csv")
    assert 60.0 <= trajectory.duration < 80.0
    np.testing.assert_allclose(trajectory.poses[0], [0.5, 0.5, 0.1], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["nowhere.geojson"], "nowhere.geojson"),
        (["square", "--planner", "greedy"], "expected one of coverage, random_bounce, wall_following"),
        (["square", "--cell", "0"], "cell is 0"),
        (["square", "--headings", "0"], "headings is 0"),
        (["square", "--start", "1,2"], "expected X,Y,PHI"),
        (["square", "--start", "0.1,2,0"], "0.10 m from a wall"),
        (["square", "--robot", "none.yaml"], "none.yaml"),
        (["square", "--resume", "none.mcap"], "none.mcap"),
    ],
)
def test_mistakes_are_one_line(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli(["plan", *options, "-o", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert says in lines[0]
    assert not (tmp_path / "out").exists()


def test_a_file_is_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out"
    path.write_text("")
    assert cli(["plan", "square", "-o", str(path)]) == 2
    assert "is a file" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("after", [1.5, 4.0])
def test_an_interrupt_leaves_nothing_behind(after: float, tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from sensorgraph.cli import main; main()"]
    with subprocess.Popen([*command, "plan", "office", "-o", str(tmp_path / "out")]) as process:
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130
    assert not list(tmp_path.iterdir())
