"""build, evaluate, predict and show through the command line: one line for every mistake, files for the rest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import logs
from logs.run import RangeSensor, Run
from sensorgraph.cli import run as command

BUILD = ["build", "--model", "polynomial"]
BEARINGS = np.radians(np.arange(-90.0, 91.0, 10.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Hold a recording of a robot circling in a round world, its graph, and poses to ask for."""
    folder = tmp_path_factory.mktemp("cli")
    rng = np.random.default_rng(0)
    stamps = np.arange(400) * 0.1
    poses = np.column_stack([np.cos(stamps), np.sin(0.7 * stamps), np.pi * np.sin(0.31 * stamps)])
    ranges = (
        3 + 0.5 * np.sin(poses[:, 2:3] + BEARINGS) + 0.1 * poses[:, :1] + 0.01 * rng.normal(size=(400, 19))
    )
    sensor = RangeSensor(bearings=BEARINGS)
    run = Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    logs.write(run, folder / "run.mcap")
    (folder / "poses.csv").write_text("x,y,phi\n0.5,0.1,0.2\n30,30,0\n")
    arguments = [*BUILD, str(folder / "run.mcap"), "--split", "every10", "-o", str(folder / "g.sensorgraph")]
    assert command(arguments) == 0
    return folder


def test_build_says_what_was_paired_held_out_and_written(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "again.sensorgraph"
    arguments = [*BUILD, str(folder / "run.mcap"), "--split", "every10", "--degree", "2", "--harmonics", "1"]
    assert command([*arguments, "--terms", "8", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "400 of 400 scans paired with poses, 40 held out (every10); 360 fitted" in printed
    assert "8 to 8 terms" in printed and str(out) in printed
    assert not list(folder.glob("*.part"))


def test_same_command_gives_the_same_bytes(folder: Path) -> None:
    out = folder / "twin.sensorgraph"
    assert command([*BUILD, str(folder / "run.mcap"), "--split", "every10", "-o", str(out)]) == 0
    assert out.read_bytes() == (folder / "g.sensorgraph").read_bytes()


def test_evaluate_prints_a_table_and_writes_the_same_numbers(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "e.json"
    arguments = ["evaluate", str(folder / "g.sensorgraph"), str(folder / "run.mcap"), "--split", "every10"]
    assert command([*arguments, "--json", str(out)]) == 0
    printed, data = capsys.readouterr().out, json.loads(out.read_text())
    assert data["n_rays"] == 40 * 19
    assert data["scored"]["n_scans"] == 40
    assert f"{data['all']['mae_m']:.3f} m" in printed
    assert "none of these scans was trained on" in printed
    assert data["all"]["mae_m"] < 0.02


def test_predict_writes_all_arrays_for_each_pose_and_ray(folder: Path) -> None:
    out = folder / "p.npz"
    arguments = [
        "predict",
        str(folder / "g.sensorgraph"),
        "--poses",
        str(folder / "poses.csv"),
        "-o",
        str(out),
    ]
    assert command(arguments) == 0
    with np.load(out, allow_pickle=False) as data:
        assert {*data} >= {"ranges", "median", "mode", "mean", "sigma", "p_no_return", "answered"}
        assert all(data[name].shape == (2, 19) for name in data)
        expected = 3 + 0.5 * np.sin(0.2 + BEARINGS) + 0.05
        np.testing.assert_allclose(data["ranges"][0], expected, atol=0.03)
        assert not data["answered"][1].any()


def test_show_prints_origin_or_one_equation(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["show", str(folder / "g.sensorgraph")]) == 0
    printed = capsys.readouterr().out
    assert "run.mcap: 400 of 400 scans paired" in printed and "every10 held out" in printed
    assert command(["show", str(folder / "g.sensorgraph"), "--ray", "12"]) == 0
    printed = capsys.readouterr().out
    assert "bearing 30.00 deg" in printed and "r12 = " in printed and "ERR" in printed


BAD = {
    "no such run": (["build", "missing.mcap", "-o", "{tmp}/g.sensorgraph"], "missing.mcap"),
    "no such folder": (["build", "{folder}/run.mcap", "-o", "{tmp}/no/g.sensorgraph"], "does not exist"),
    "bad split": (
        ["build", "{folder}/run.mcap", "--split", "half", "-o", "{tmp}/g.sensorgraph"],
        "every10, block",
    ),
    "bad degree": (
        ["build", "{folder}/run.mcap", "--degree", "two", "-o", "{tmp}/g.sensorgraph"],
        "degree is 'two'",
    ),
    "degree of faces": (
        ["build", "{folder}/run.mcap", "--degree", "2", "-o", "{tmp}/g.sensorgraph"],
        "set --model to polynomial",
    ),
    "bad model": (
        ["build", "{folder}/run.mcap", "--model", "net", "-o", "{tmp}/g.sensorgraph"],
        "polynomial",
    ),
    "bad topic": (
        ["build", "{folder}/run.mcap", "--topic", "scan", "-o", "{tmp}/g.sensorgraph"],
        "ROLE=NAME",
    ),
    "not a graph": (["show", "{folder}/poses.csv"], "not a sensorgraph"),
    "a folder as graph": (["show", "{folder}"], "is a folder, expected a *.sensorgraph"),
    "no such ray": (["show", "{folder}/g.sensorgraph", "--ray", "19"], "rays 0 to 18"),
    "bad point": (
        ["evaluate", "{folder}/g.sensorgraph", "{folder}/run.mcap", "--point", "max"],
        "mode, median, mean",
    ),
    "no column": (
        ["predict", "{folder}/g.sensorgraph", "--poses", "{tmp}/a.csv", "-o", "{tmp}/p.npz"],
        "column phi",
    ),
    "no number": (
        ["predict", "{folder}/g.sensorgraph", "--poses", "{tmp}/b.csv", "-o", "{tmp}/p.npz"],
        "line 3",
    ),
    "not finite": (
        ["predict", "{folder}/g.sensorgraph", "--poses", "{tmp}/c.csv", "-o", "{tmp}/p.npz"],
        "not finite",
    ),
    "empty": (
        ["predict", "{folder}/g.sensorgraph", "--poses", "{tmp}/d.csv", "-o", "{tmp}/p.npz"],
        "no pose",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_mistake_is_one_line_and_leaves_no_file(
    case: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in {
        "a.csv": "x,y\n1,2\n",
        "b.csv": "x,y,phi\n1,2,3\n1,two,3\n",
        "c.csv": "x,y,phi\n1,inf,3\n",
        "d.csv": "x,y,phi\n",
    }.items():
        (tmp_path / name).write_text(text)
    arguments, words = BAD[case]
    before = set(tmp_path.iterdir())
    assert command([a.format(folder=folder, tmp=tmp_path) for a in arguments]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said and "\n" not in said
    assert set(tmp_path.iterdir()) == before
