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
from planners.maps.no_go import without, zones
from planners.trajectory import read_csv
from planners.vehicle import Vehicle
from sensorgraph.cli import run as cli
from sensorgraph.cli.plan import _least, _place

pytestmark = pytest.mark.usefixtures("narrow_search")

COARSE = ("--cell", "0.5", "--headings", "8")
KEYS = {
    "grid", "start", "coverage", "core_coverage", "reachable_cells", "covered_cells", "drive_time_s", "t_ref_s",
    "ratio", "path_m", "planning_s", "seed", "min_clearance_m", "limit_violations", "joins", "margin_m",
    "share_of_bare_footprint", "lower_bound_s",
}  # fmt: skip


FILES = {
    "arena.geojson", "cmd_vel.csv", "headings.png", "holes.csv", "plan.json", "timing.json", "plan.mcap", "plan.png", "reach.png",
    "robot.yaml", "trajectory.csv", "waypoints.yaml",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plans") / "new" / "square"
    assert cli(["plan", "square", *COARSE, "--seed", "4", "-o", str(out)]) == 0
    return out


def test_the_folder_holds_every_promised_file_and_nothing_half_written(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == FILES
    assert not [name for name in names if name.endswith(".part")]
    assert [path.name for path in folder.parent.iterdir()] == ["square"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in folder.glob("*.png"))
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
    assert check(trajectory, shipped("square"), Vehicle()).count == 0


@pytest.mark.slow
def test_same_seed_same_bytes(folder: Path, tmp_path: Path) -> None:
    assert cli(["plan", "square", *COARSE, "--seed", "4", "-o", str(tmp_path)]) == 0
    names = {path.name for path in folder.iterdir()}
    assert "timing.json" in names and names == {path.name for path in tmp_path.iterdir()}
    for name in names - {"timing.json"}:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name
    assert json.loads((folder / "timing.json").read_text())["planning_s"] > 0


def test_a_plan_recorded_and_resumed_leaves_little_to_do(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run.mcap"
    assert cli(["record", str(folder), "--arena", "square", "-o", str(run)]) == 0
    capsys.readouterr()
    code = cli(
        ["plan", *COARSE, "--resume", str(run), "-o", str(tmp_path / "rest")]
    )  # the arena that the run keeps
    said = capsys.readouterr()
    if code == 0:
        report = json.loads((tmp_path / "rest" / "plan.json").read_text())
        assert report["coverage_before"] > 0.9
        assert report["coverage"] >= 0.999
    else:
        assert code == 2
        assert "nothing is left to plan" in said.err


@pytest.mark.parametrize(
    ("other", "said"),
    [({}, " (turns on the spot and straight moves take at least 0 h 02 min)"),
     ({"covered_cells": 1001}, " (turns on the spot and straight moves take longer)"),
     ({"interrupted": True}, ""), ({"budget_s": 9.0}, ""),
     ({"robot": {"drive": "dubins"}}, ""), ({"planner": "views"}, ""), ({"coverage_before": 0.9}, "")],
)  # fmt: skip
def test_only_a_plan_that_covers_all_by_turning_is_compared_with_the_bound(
    other: dict[str, object], said: str
) -> None:
    report = {
        "lower_bound_s": 100.0,
        "drive_time_s": 120.0,
        "planner": "coverage",
        "robot": {"drive": "diff"},
        "coverage_before": 0.0,
        "covered_cells": 900,
        "rate": 10.0,
    }
    assert _least(report | other) == said


def test_without_an_arena_the_graph_says_where_walls_are_else_one_line_asks_for_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _place(None, [], [], tmp_path / "lab.sensorgraph") == str(tmp_path / "lab.sensorgraph")
    assert _place("square", [], [], tmp_path / "lab.sensorgraph") == "square"
    assert cli(["plan", *COARSE, "-o", str(tmp_path / "none")]) == 2
    assert "no arena given" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
def test_a_battery_makes_a_folder_for_each_run_that_can_be_recorded(tmp_path: Path) -> None:
    out, options = (
        tmp_path / "out",
        ["--battery", "3", "--dock", "0.5,0.5,0", "--cell", "0.5", "--headings", "4"],
    )
    zone = "2.6,2.6,3.6,2.6,3.6,3.6,2.6,3.6"
    assert cli(["plan", "square", *options, "--no-go", zone, "-o", str(out)]) == 0
    report = json.loads((out / "plan.json").read_text())
    runs = sorted(path for path in out.iterdir() if path.is_dir())
    assert [run.name for run in runs] == [f"run_{k + 1}" for k in range(len(report["sessions"]))]
    assert len(runs) > 1
    less = without(shipped("square"), zones(zone))
    for run, told in zip(runs, report["sessions"], strict=True):
        trajectory = read_csv(run / "trajectory.csv")
        assert trajectory.duration <= 180.0 + 0.02  # the last sample stands still
        assert check(trajectory, less, Vehicle()).count == 0
        assert json.loads((run / "plan.json").read_text())["coverage"] == told["coverage"]
    assert report["no_go"] == [[[2.6, 2.6], [3.6, 2.6], [3.6, 3.6], [2.6, 3.6]]]
    run = tmp_path / "run.mcap"
    assert cli(["record", str(runs[0]), "--arena", "square", "-o", str(run)]) == 0
    assert cli(["plan", "square", *COARSE, "--budget", "2", "-o", str(out)]) == 0
    assert not [path for path in out.iterdir() if path.is_dir()]  # the older plan's runs are gone
    assert json.loads((out / "plan.json").read_text())["drive_time_s"] <= 120.02


@pytest.mark.usefixtures("no_pictures")
def test_a_budget_is_driven_in_the_order_anytime_unless_fast_is_asked(tmp_path: Path) -> None:
    for options, order in ([], "anytime"), (["--order", "fast"], "fast"):
        out = tmp_path / order
        assert cli(["plan", "square", *COARSE, "--budget", "1", *options, "-o", str(out)]) == 0
        report = json.loads((out / "plan.json").read_text())
        assert report.get("order", "fast") == order
        assert report["drive_time_s"] <= 60.0 + 1e-6


@pytest.mark.usefixtures("no_pictures")
def test_a_margin_costs_reach_and_the_plan_says_how_much(tmp_path: Path, folder: Path) -> None:
    options = ["--margin", "0.12", "--budget", "1", "-o", str(tmp_path)]
    assert cli(["plan", "square", *COARSE, *options]) == 0
    wide, usual = (json.loads((path / "plan.json").read_text()) for path in (tmp_path, folder))
    assert (wide["margin_m"], usual["margin_m"]) == (0.12, 0.02)
    assert wide["min_clearance_m"] > 0.3
    assert wide["coverage"] < 0.5 < wide["share_of_bare_footprint"] < usual["share_of_bare_footprint"] <= 1.0
    assert 0.0 < usual["lower_bound_s"] < usual["drive_time_s"] < 1.2 * usual["lower_bound_s"]


@pytest.mark.usefixtures("no_pictures")
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
        (["square", "--start", "0.1,2,0"], "0.100 m from a wall"),
        (["square", "--margin", "3"], "the robot does not fit: use a smaller --margin or footprint_radius"),
        (["square", "--end", "1,2"], "--end is '1,2', expected X,Y,PHI"),
        (["square", "--end", "0.1,2,0"], "end (0.1, 2) is 0.100 m from a wall"),
        (["square", "--dock", "1,1"], "--dock is '1,1', expected X,Y,PHI"),
        (["square", "--dock", "0.5,0.5,0"], "give --battery too, or use --start and --end"),
        (["square", "--battery", "0.01", "--dock", "0.5,0.5,0"], "battery of 0.01 min is too small"),
        (["square", "--battery", "3", "--dock", "9,9,0"], "dock (9, 9) is 7.07 m inside a wall or outside"),
        (["square", "--battery", "-5"], "--battery is -5 min"),
        (["square", "--budget", "0"], "--budget is 0 min"),
        (["square", "--planner", "views"], "give --views"),
        (
            ["square", "--views", "5", "--planner", "random_bounce"],
            "--views excludes --planner random_bounce",
        ),
        (["square", "--views", "5", "--resume", "run.mcap"], "--views excludes --resume"),
        (["square", "--views", "5000"], "less than or equal to 1000"),
        (["square", "--no-go", "1,1,2,2,2,1,1,2"], "crosses or touches itself"),
        (["square", "--no-go", "10,10,11,10,11,11"], "outside the arena"),
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


@pytest.mark.usefixtures("no_pictures")
def test_a_log_too_slow_is_said_in_one_line_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.yaml").write_text("sensor: {rate: 2.0}\n")
    options = [
        "--planner",
        "random_bounce",
        "--duration",
        "20",
        "--robot",
        str(tmp_path / "robot.yaml"),
        *COARSE,
    ]
    assert cli(["plan", "square", *options, "-o", str(tmp_path / "out")]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "log of 2 Hz" in line]
    assert line.startswith("warning: at ")
    assert "log at 2.6 Hz or more" in line
    assert [line.removeprefix("warning: ")] == json.loads((tmp_path / "out" / "plan.json").read_text())[
        "warnings"
    ]


@pytest.mark.usefixtures("no_pictures")
def test_a_plan_without_a_robot_says_for_which_robot_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.yaml").write_text("footprint_radius: 0.15\n")
    options = ["--planner", "random_bounce", "--duration", "20", *COARSE]
    assert cli(["plan", "square", *options, "-o", str(tmp_path / "out")]) == 0
    assert "the shipped robot radix, a disc of 0.2 m" in capsys.readouterr().out
    own = ["--robot", str(tmp_path / "robot.yaml")]
    assert cli(["plan", "square", *options, *own, "-o", str(tmp_path / "out")]) == 0
    assert "shipped robot" not in capsys.readouterr().out


def test_a_file_is_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out"
    path.write_text("")
    assert cli(["plan", "square", "-o", str(path)]) == 2
    assert "is a file" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("after", [1.5, 8.0])
def test_an_interrupt_leaves_a_whole_shorter_plan_or_nothing(after: float, tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from sensorgraph.cli import main; main()"]
    with subprocess.Popen([*command, "plan", "office", "-o", str(tmp_path / "out")]) as process:
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == 130
    assert {path.name for path in tmp_path.iterdir()} <= {"out"}
    if (tmp_path / "out").exists():
        report = json.loads((tmp_path / "out" / "plan.json").read_text())
        assert report["interrupted"]
        assert report["coverage"] < 1.0
        assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
        assert check(read_csv(tmp_path / "out" / "trajectory.csv"), shipped("office"), Vehicle()).count == 0
