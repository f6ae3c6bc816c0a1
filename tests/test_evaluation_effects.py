"""`evaluate --effects`: the simulator beside the graph, on the same rays, as mapped and amended."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effects_samples import arena, motion, strong

import logs
from logs import pair
from planners.maps import geojson
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.effects import EFFECTS as LIBRARY
from sensorgraph.effects.effects_file import write
from sensorgraph.evaluation.evaluate import evaluate
from sensorgraph.evaluation.raycast_baseline import compare, predict
from sensorgraph.recording.record import Commands, record
from sensorgraph.world.robot import default_robot

pytestmark = pytest.mark.usefixtures("trusted_scans")

ROOM, ROBOT = arena(), default_robot()
EFFECTS = [strong(name) for name in ("glass", "max_range", "latency", "random_outliers", "people")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record an amended drive, build a graph from it, write its effects."""
    path = tmp_path_factory.mktemp("amended")
    stamps = np.arange(0, 40.0, 0.05)
    twists = np.column_stack([np.full(len(stamps), 0.2), 0.5 * np.sin(0.3 * stamps) + 0.2])
    commands = Commands(stamps=stamps, twists=twists, start=motion(np.zeros(1))[0])
    run = record(path / "run.mcap", ROOM, ROBOT, commands, effects=EFFECTS, seed=4)
    build([run], arena=ROOM, model="polynomial", degree=2, harmonics=2).save(path / "g.sensorgraph")
    write(EFFECTS, path / "effects.yaml")
    return path


def test_the_amended_simulator_predicts_what_the_mapped_one_misses(folder: Path) -> None:
    out = folder / "e.json"
    arguments = [str(folder / "g.sensorgraph"), str(folder / "run.mcap"), "--json", str(out)]
    assert cli(["evaluate", *arguments]) == 0
    plain = json.loads(out.read_text())
    assert cli(["evaluate", *arguments, "--effects", str(folder / "effects.yaml")]) == 0
    result = json.loads(out.read_text())
    simulator = result.pop("simulator")
    assert result == plain
    assert set(simulator) == {"nominal", "amended"}
    assert set(simulator["amended"]) == set(result["all"])
    nominal, amended = simulator["nominal"], simulator["amended"]
    stray = 0.1 + 0.05  # outliers and people
    assert amended["within_3sigma"] > 1 - 1.5 * stray
    assert amended["median_m"] < 0.01
    assert nominal["within_3sigma"] < amended["within_3sigma"] - 0.2
    assert amended["no_return_recall"] > 0.9
    assert amended["no_return_precision"] > 0.8


def test_a_prediction_is_the_cast_of_the_poses_whatever_frame_they_are_of(folder: Path) -> None:
    run = logs.read(folder / "run.mcap")
    scans = np.flatnonzero(pair(run).paired)[::7]
    base = predict(run, ROOM, ROBOT.sensor, scans, [])
    c, s = np.cos(run.poses[:, 2]), np.sin(run.poses[:, 2])
    laser = run.poses + 0.10 * np.column_stack([c, s, 0 * c])
    there = predict(replace(run, poses=laser, pose_frame="laser"), ROOM, ROBOT.sensor, scans, [])
    np.testing.assert_allclose(base.mode, there.mode, atol=0.02)  # the laser's path between two poses is bent
    assert np.median(np.abs(base.mode - there.mode)) < 1e-4
    assert base.answered.all()
    assert (base.p_off < 1e-3).all()


def test_people_and_outliers_are_said_as_a_chance_of_being_off(folder: Path) -> None:
    run = logs.read(folder / "run.mcap")
    some = [a for a in EFFECTS if a.name in ("people", "random_outliers")]
    said = predict(run, ROOM, ROBOT.sensor, np.arange(5, 9), some)
    np.testing.assert_allclose(said.p_off, 1 - 0.9 * 0.95, atol=1e-3)


def test_without_effects_of_the_scan_channel_both_are_the_same(folder: Path) -> None:
    run = logs.read(folder / "run.mcap")
    result = evaluate(build([run], model="polynomial", degree=1, harmonics=1), run)
    shown: list[tuple[int, int]] = []
    both = compare(
        result,
        run,
        ROOM,
        ROBOT.sensor,
        [LIBRARY["wheel_base"](s=0.1)],
        progress=lambda done, total: shown.append((done, total)),
    )
    assert both["nominal"] == both["amended"]
    assert shown == sorted(shown) and shown[-1] == (100, 100) and (50, 100) in shown


def test_a_run_that_keeps_no_arena_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = logs.read(folder / "run.mcap")
    logs.write(
        replace(run, attachments={"arena.geojson": geojson.dumps(ROOM).encode()}), tmp_path / "bare.mcap"
    )
    capsys.readouterr()
    arguments = [str(folder / "g.sensorgraph"), str(tmp_path / "bare.mcap")]
    assert cli(["evaluate", *arguments, "--effects", str(folder / "effects.yaml")]) == 2
    assert "keeps arena and robot" in capsys.readouterr().err
