"""`sensorgraph diagnose` from the command line: what it writes, what it accepts, and what it says of bad input."""

from __future__ import annotations

import io
import json
import re
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import further, without_pictures
from scan_samples import ROOM_ROBOT, drive_in_room

import logs
from logs.run import Run
from planners.arena import Arena
from planners.maps import geojson
from sensorgraph.cli import run as cli
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.report import files as figures
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.effects_file import write as write_effects
from sensorgraph.loading import load_arena
from sensorgraph.world.drive import ExecutedDrive
from sensorgraph.world.robot import load_robot, parse_robot
from sensorgraph.world.simulate import simulate

ROBOT = "sensor: {n_rays: 61, rate: 5.0}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with robot.yaml and two runs whose sensor reads 4 cm long."""
    folder = tmp_path_factory.mktemp("diagnose")
    (folder / "robot.yaml").write_text(ROBOT)
    for k, name in enumerate(("run", "second")):
        logs.write(driven_run(k), folder / f"{name}.mcap")
    return folder


@cache
def driven_run(seed: int) -> Run:
    """Turn to and fro on the spot at a few places of the shipped square."""
    arena, robot = load_arena("square"), parse_robot(ROBOT)
    t = np.arange(0, 30.0, 0.01)
    x0, y0, x1, y1 = arena.bounds
    path = np.column_stack(
        [
            x0 + 0.5 * (x1 - x0) + 0.25 * np.sin(0.3 * t + seed),
            y0 + 0.3 * (y1 - y0) + 0.2 * np.cos(0.2 * t),
            2.5 * np.sin(0.25 * t + seed),
        ]
    )
    twists = np.column_stack([np.zeros(len(t)), np.gradient(path[:, 2], t)])
    driven = ExecutedDrive(
        stamps=t, poses=path, twists=twists, cmd_stamps=t[::5] - 0.1, commands=twists[::5], contacts=0
    )
    attachments = {"arena.geojson": geojson.dumps(arena).encode(), "robot.yaml": ROBOT.encode()}
    return simulate(
        driven, arena, robot, rng=np.random.default_rng(seed), effects=[EFFECTS["range_bias"](b=0.04)],
        seed=seed, attachments=attachments,
    )  # fmt: skip


@pytest.mark.usefixtures("no_pictures")
def test_it_finds_what_is_hidden_and_writes_a_model_that_knows_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    runs = [str(folder / "run.mcap"), str(folder / "second.mcap")]
    assert cli(["diagnose", *runs, "-o", str(out), "--why", "range_bias"]) == 0
    said = capsys.readouterr().out
    assert "range bias" in said and "of 35 effects are not observable in this run" in said
    assert cli(["why", str(out), "range_bias"]) == 0
    assert said.endswith(f"\n\n{capsys.readouterr().out}")  # the paragraph comes last
    report = json.loads((out / "report.json").read_text())
    (bias,) = [e for e in report["effects"] if e["name"] == "range_bias"]
    assert abs(bias["parameters"]["b"] - 0.04) < 0.006
    assert report["gap_second_run"]["after"]["rmse_m"] < report["gap_second_run"]["before"]["rmse_m"]
    assert (out / "next_run" / "trajectory.csv").is_file()
    monkeypatch.setattr("sensorgraph.diagnosis.diagnose._planned", lambda *_: None)
    again = tmp_path / "again"
    known = ["--effects", str(out / "effects.yaml")]
    assert cli(["diagnose", str(folder / "run.mcap"), *known, "-o", str(again)]) == 0
    left = json.loads((again / "report.json").read_text())
    assert "range_bias" not in [e["name"] for e in left["effects"]]


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.slow
def test_the_same_seed_writes_the_same_report_with_and_without_attachments(
    folder: Path, tmp_path: Path
) -> None:
    assert {"arena.geojson", "robot.yaml"} <= set(logs.read(folder / "run.mcap").attachments)
    stripped = tmp_path / "run.mcap"
    logs.write(replace(driven_run(0), attachments={}), stripped)
    assert not logs.read(stripped).attachments
    given = ["--arena", "square", "--robot", str(folder / "robot.yaml"), "--seed", "3"]
    texts = []
    for name, path in (("a", folder / "run.mcap"), ("b", stripped)):
        assert cli(["diagnose", str(path), *given, "-o", str(tmp_path / name)]) == 0
        texts.append((tmp_path / name / "report.json").read_text())
        assert json.loads((tmp_path / name / "timing.json").read_text())["cpu_s"]
    assert texts[0] == texts[1]
    settings = json.loads(texts[0])["settings"]
    assert settings["robot_yaml"] == (folder / "robot.yaml").read_text()
    assert (settings["poses"], settings["topics"], settings["no_return"]) == (None, [], None)
    assert (tmp_path / "a" / "effects.yaml").read_bytes() == (tmp_path / "b" / "effects.yaml").read_bytes()


MENDED = "/scan: stamps go back 3 times, sorted"
"""What a reader has noted of a log, and is not usual."""


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Diagnose a mended log whose poses stop early and are of another place; return the report's folder and what was said."""
    folder, run = tmp_path_factory.mktemp("elsewhere"), driven_run(0)
    early = run.pose_stamps < 18.0
    meta = {**run.meta, "source": "off.mcap", "notes": f"{MENDED}; 3 ranges are above range_max 8 m: +inf"}
    off = replace(
        run, pose_stamps=run.pose_stamps[early], poses=run.poses[early] + [4.0, 1.0, 0.0], meta=meta
    )
    logs.write(off, folder / "off.mcap")
    said, warned = io.StringIO(), io.StringIO()
    with without_pictures(), redirect_stdout(said), redirect_stderr(warned):
        assert cli(["diagnose", str(folder / "off.mcap"), "-o", str(folder / "out")]) == 0
    return folder / "out", said.getvalue(), warned.getvalue()


def test_poses_that_stop_early_are_counted(elsewhere: tuple[Path, str, str]) -> None:
    folder, said, _ = elsewhere
    intake = json.loads((folder / "report.json").read_text())["intake"]
    assert intake["dropped"]["after the last pose"] > 50
    assert intake["used"] < 0.65 * intake["scans"]
    assert f"used {intake['used']} of {intake['scans']} scans; dropped: " in said
    assert "after the last pose" in said


def test_an_arena_of_another_place_is_said_first(elsewhere: tuple[Path, str, str]) -> None:
    report = json.loads((elsewhere[0] / "report.json").read_text())
    assert report["effects"] == []
    assert "does not fit" in report["unknown"]["statement"]
    assert "moved by (-" in report["unknown"]["statement"]


def test_what_was_taken_for_granted_of_a_log_is_said_on_all_channels(
    elsewhere: tuple[Path, str, str],
) -> None:
    folder, _, warned = elsewhere
    assert f"warning: off.mcap: {MENDED}\n" in warned
    report = json.loads((folder / "report.json").read_text())
    assert report["intake"]["log_notes"] == [f"off.mcap: {MENDED}"]
    assert f"Warning: off.mcap: {MENDED}" in (folder / "report.html").read_text()


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("scale", [0.7, *further(1.3)])
def test_an_arena_of_another_scale_is_said_first(
    scale: float, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arena = json.loads(geojson.dumps(load_arena("square")))
    for feature in arena["features"]:
        rings = feature["geometry"]["coordinates"]
        feature["geometry"]["coordinates"] = [[[scale * x, scale * y] for x, y in ring] for ring in rings]
    (tmp_path / "scaled.geojson").write_text(json.dumps(arena))
    options = ["--arena", str(tmp_path / "scaled.geojson"), "-o", str(tmp_path / "out")]
    assert cli(["diagnose", str(folder / "run.mcap"), *options]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    found = re.fullmatch(
        r"The arena does not fit the run, because it is (\d\.\d\d) times as large as the place\.", first
    )
    assert found is not None
    assert (
        abs(float(found[1]) - scale) < 0.03 * scale
    )  # the sensor reads 4 cm long, 2 % of the way to the walls
    assert json.loads((tmp_path / "out" / "report.json").read_text())["effects"] == []


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
def test_an_arena_that_lacks_obstacles_is_said_and_they_are_no_people(tmp_path: Path, folder: Path) -> None:
    arena = json.loads(geojson.dumps(load_arena("square")))
    arena["features"] = [f for f in arena["features"] if f["properties"]["kind"] == "arena"]
    (tmp_path / "bare.geojson").write_text(json.dumps(arena))
    run = driven_run(0)
    short = run.stamps < 20.0  # of longer runs the places give it away
    logs.write(replace(run, stamps=run.stamps[short], ranges=run.ranges[short]), tmp_path / "run.mcap")
    options = ["--arena", str(tmp_path / "bare.geojson"), "-o", str(tmp_path / "out")]
    assert cli(["diagnose", str(tmp_path / "run.mcap"), *options]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert "people" not in {e["name"] for e in report["effects"]}
    assert "something stands there" in report["unknown"]["statement"]


def test_a_folder_used_again_keeps_nothing_of_the_last_report(folder: Path, tmp_path: Path) -> None:
    run, out = driven_run(0), tmp_path / "out"
    (out / "next_run").mkdir(parents=True)
    old = ["gap.png", "ranking.png", "review.rrd", "next_run/plan.json"]
    for name in [*old, "notes.txt", "next_run/next.mcap"]:
        (out / name).write_text("of the last run")
    logs.write(replace(run, poses=run.poses + [4.0, 1.0, 0.0]), tmp_path / "off.mcap")
    assert cli(["diagnose", str(tmp_path / "off.mcap"), "-o", str(out)]) == 0
    assert not any((out / name).exists() for name in ("ranking.png", "review.rrd", "next_run/plan.json"))
    assert (out / "notes.txt").exists() and (out / "next_run/next.mcap").exists()  # not ours
    html = (out / "report.html").read_text()
    assert "of the last run" not in html


@pytest.mark.usefixtures("no_pictures")
def test_a_mirrored_scan_is_said_first(folder: Path, tmp_path: Path) -> None:
    run = driven_run(0)
    logs.write(replace(run, ranges=run.ranges[:, ::-1].copy()), tmp_path / "mirrored.mcap")
    assert cli(["diagnose", str(tmp_path / "mirrored.mcap"), "-o", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["effects"] == []
    assert "mirrored" in report["unknown"]["statement"]


@pytest.fixture(scope="module")
def mistaken(folder: Path) -> Path:
    """Return the folder with robots and runs that are not diagnosed."""
    (folder / "default.yaml").write_text("sensor: {n_rays: 181}\n")
    (folder / "near.yaml").write_text("sensor: {n_rays: 61, rate: 5.0, range_max: 1.0}\n")
    (folder / "exact.yaml").write_text("sensor: {n_rays: 61, rate: 5.0, sigma: 0}\n")
    run = driven_run(0)
    logs.write(replace(run, stamps=run.stamps[:20], ranges=run.ranges[:20]), folder / "short.mcap")
    logs.write(replace(run, ranges=np.full_like(run.ranges, np.inf)), folder / "blind.mcap")
    return folder


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.mcap"], "missing.mcap"),
        (["run.mcap", "--arena", "nowhere"], "nowhere does not exist"),
        (["run.mcap", "--robot", "missing.yaml"], "missing.yaml"),
        (["missing.mcap", "--why", "glas"], "did you mean glass?"),  # before any file is read
        (["run.mcap", "second.mcap", "run.mcap"], "expected one, or two"),
        (["run.mcap", "--effects", "robot.yaml"], "robot.yaml"),
        (
            ["run.mcap", "--robot", "default.yaml"],
            "default.yaml (61 rays from -90° to 90°, expected 181",
        ),
        (["short.mcap"], "50 or more"),
        (["run.mcap", "run.mcap"], "given twice"),
        (["run.mcap", "--simulation", "run.mcap"], "its own simulation"),
        (["run.mcap", "--commissioning", "run.mcap"], "its own commissioning run"),
        (["run.mcap", "--simulation", "missing.mcap"], "missing.mcap"),
        (["run.mcap", "--simulation", "short.mcap"], "short.mcap: the run has 20 scans"),
        (["run.mcap", "--simulation", "second.mcap", "--commissioning", "second.mcap"], "only one of them"),
        (["blind.mcap"], "no ray of the run ever returned"),
        (["run.mcap", "--robot", "near.yaml"], "beyond sensor.range_max"),
        (["run.mcap", "--robot", "exact.yaml"], "sensor.sigma of robot.yaml is 0"),
    ],
)
def test_bad_input_gets_one_line(
    mistaken: Path, tmp_path: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(mistaken / a) if a.endswith((".mcap", ".yaml")) else a for a in arguments]
    assert cli(["diagnose", *paths, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert words in said[0]
    assert not (tmp_path / "out" / "report.json").exists()


def test_effects_that_are_known_may_name_no_other_place(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_effects([EFFECTS["moved_wall"](d=0.1).at("kitchen/edge_0")], tmp_path / "e.yaml")
    known = ["--effects", str(tmp_path / "e.yaml")]
    assert cli(["diagnose", str(folder / "run.mcap"), *known, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "kitchen/edge_0" in said
    assert f"{tmp_path / 'e.yaml'}: effect 1 (moved_wall)" in said
    assert load_robot(None).name == "radix"


@pytest.mark.parametrize(
    "where", ["residuals_picture", pytest.param("next_run_picture", marks=pytest.mark.slow)]
)
def test_ctrl_c_leaves_the_last_report_as_it_was(
    where: str,
    folder: Path,
    room: Arena,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(*args: object, **kwargs: object) -> None:
        signal.raise_signal(signal.SIGINT)

    (tmp_path / "report.json").write_text("of the last run")
    planned = where == "next_run_picture"
    found = diagnose(drive_in_room(room, bias=0.03), room, parse_robot(ROOM_ROBOT), plan_next=planned)
    monkeypatch.setattr("sensorgraph.diagnosis.diagnose.diagnose", lambda *_, **__: found)
    monkeypatch.setattr(figures, where, interrupted)
    assert cli(["diagnose", str(folder / "run.mcap"), "-o", str(tmp_path)]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted"
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    assert (tmp_path / "report.json").read_text() == "of the last run"


@pytest.mark.slow
def test_ctrl_c_half_way_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    script = "from sensorgraph.cli import main, progress; progress.PLAIN_EVERY = 0.02; main()"
    options = ["diagnose", str(folder / "run.mcap"), "-o", str(tmp_path / "out")]
    command = [sys.executable, "-c", script, *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as work:
        assert work.stderr is not None
        assert any(
            line.startswith("aligning scans") for line in work.stderr
        )  # it is fitting, however fast it is
        work.send_signal(signal.SIGINT)
        out, err = work.communicate(timeout=60)
    assert (work.returncode, out, err.splitlines()[-1]) == (130, "", "interrupted")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("no_pictures", "no_next_run")
def test_the_command_writes_a_report_and_says_what_it_found(
    room: Arena, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = drive_in_room(room, bias=0.03)
    logs.write(run, tmp_path / "run.mcap")
    (tmp_path / "robot.yaml").write_text(ROOM_ROBOT)
    arena = {
        "type": "FeatureCollection",
        "features": [
            feature("w", "arena", [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]),
            feature("pillar", "obstacle", [[2.5, 1], [3, 1], [3, 1.5], [2.5, 1.5], [2.5, 1]]),
        ],
    }
    (tmp_path / "arena.geojson").write_text(json.dumps(arena))
    options = ["--arena", str(tmp_path / "arena.geojson"), "--robot", str(tmp_path / "robot.yaml")]
    assert cli(["diagnose", str(tmp_path / "run.mcap"), *options, "-o", str(tmp_path / "new" / "out")]) == 0
    out = capsys.readouterr().out
    assert out.startswith("Found: range bias, +")
    assert "report.html" in out
    report = json.loads((tmp_path / "new" / "out" / "report.json").read_text())
    for channel in ("odometry", "drive"):  # the run has neither odometry nor commands
        skipped = report["channels"][channel]["skipped"]
        assert skipped and f"{channel}: not evaluated, {skipped}" in out.splitlines()
    assert {path.name for path in (tmp_path / "new" / "out").iterdir()} >= {
        "report.json", "report.html", "effects.yaml", "review.rrd", "timing.json",
    }  # fmt: skip
    assert cli(["diagnose", str(tmp_path / "run.mcap"), *options, "-o", str(tmp_path / "robot.yaml")]) == 2
    assert "is a file; give the name of a folder" in capsys.readouterr().err
    assert cli(["diagnose", *[str(tmp_path / "run.mcap")] * 3, *options, "-o", str(tmp_path / "o")]) == 2
    assert "expected one, or two" in capsys.readouterr().err


def feature(name: str, kind: str, ring: list[list[float]]) -> dict[str, object]:
    return {
        "type": "Feature",
        "properties": {"name": name, "kind": kind},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
