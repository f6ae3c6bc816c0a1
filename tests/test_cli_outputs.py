"""Outputs: never over an input, never half, the same bytes for the same seed, saved before anything is printed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from logs.files import atomic_file
from sensorgraph.cli import run as cli

pytestmark = pytest.mark.usefixtures("narrow_search")


@pytest.mark.parametrize(
    "command",
    [
        "build {run} -o {run}",
        "evaluate {graph} {run} --json {run}",
        "evaluate {graph} {run} --json {graph}",
        "inspect {run} --json {run}",
        "predict {graph} --poses {poses} -o {poses}",
        "predict {graph} --poses {poses} -o {graph}",
        "record {run} --arena square -o {run}",
        "recover {run} -o {run}",
    ],
)
def test_an_input_is_never_written_over(
    command: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"run": "run.mcap", "graph": "g.sensorgraph", "poses": "poses.csv"}
    for name in names.values():
        shutil.copy(made / name, tmp_path / name)
    words = command.format(**{key: tmp_path / name for key, name in names.items()}).split()
    assert cli(words) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    for name in names.values():
        assert (tmp_path / name).read_bytes() == (made / name).read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("record {png} --arena square -o {tmp}/a.mcap", "not a CSV file"),
        ("record {made}/plan --arena square --seed -1 -o {tmp}/a.mcap", "--seed"),
        ("record {made}/plan --arena square --start 1,1,0 -o {tmp}/a.mcap", "which has its own start"),
        ("predict {made}/g.sensorgraph --poses {far} -o {tmp}/a.npz", "from the origin"),
        ("plan square --cell 1e9 -o {tmp}/a", "larger than the whole arena"),
        ("plan square --duration 100 -o {tmp}/a", "duration is for the baselines"),
        ("show {made}/g.sensorgraph --ray -1", "ray -1 does not exist"),
        ("build {made}/run.mcap --terms x -o {tmp}/a.sensorgraph", "terms is 'x'"),
        ("inspect {made}/run.mcap --json {made}", "is a folder"),
    ],
)
def test_a_mistake_is_named_as_the_user_made_it(
    command: str, said: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs = tmp_path / "in"
    inputs.mkdir()
    (inputs / "picture.csv").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    (inputs / "far.csv").write_text("x,y,phi\n1e300,0,0\n")
    out = tmp_path / "out"
    out.mkdir()
    names = {"png": inputs / "picture.csv", "far": inputs / "far.csv", "made": made, "tmp": out}
    assert cli(command.format(**names).split()) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line
    assert not list(out.iterdir())


def test_json_is_saved_though_nobody_reads_the_table(made: Path, tmp_path: Path) -> None:
    code = "import sys; from sensorgraph.cli import main; sys.argv[0] = 'sensorgraph'; main()"
    words = [
        "evaluate",
        str(made / "g.sensorgraph"),
        str(made / "run.mcap"),
        "--json",
        str(tmp_path / "e.json"),
    ]
    with subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.close()
        process.wait()
    assert (tmp_path / "e.json").is_file()


def test_the_time_that_planning_took_does_not_change_a_run(made: Path, tmp_path: Path) -> None:
    again = tmp_path / "plan"
    shutil.copytree(made / "plan", again)
    (again / "plan.json").write_text('{"planning_s": 99.0, "seed": 0}')
    assert cli(["record", str(again), "--arena", "square", "-o", str(tmp_path / "run.mcap")]) == 0
    assert (tmp_path / "run.mcap").read_bytes() == (made / "run.mcap").read_bytes()


@pytest.mark.usefixtures("no_pictures")
def test_a_plan_driven_in_another_arena_is_warned_of(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan"
    assert cli(["plan", "square", "--planner", "wall_following", "--duration", "20", "-o", str(plan)]) == 0
    assert cli(["record", str(plan), "--arena", "square", "-o", str(tmp_path / "a.mcap")]) == 0
    assert "another arena" not in capsys.readouterr().err
    cli(["record", str(plan), "--arena", "office", "-o", str(tmp_path / "b.mcap")])
    assert "another arena" in capsys.readouterr().err


@pytest.mark.usefixtures("no_pictures")
def test_part_of_an_arena_behind_a_narrow_door_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    door = """{"type": "FeatureCollection", "features": [
      {"type": "Feature", "properties": {"name": "room", "kind": "arena"}, "geometry": {"type": "Polygon",
       "coordinates": [[[0,0],[4,0],[4,4],[0,4],[0,0]]]}},
      {"type": "Feature", "properties": {"name": "wall", "kind": "obstacle"}, "geometry": {"type": "Polygon",
       "coordinates": [[[1.9,0],[2.1,0],[2.1,3.65],[1.9,3.65],[1.9,0]]]}}]}"""
    (tmp_path / "door.geojson").write_text(door)
    assert (
        cli(
            [
                "plan",
                str(tmp_path / "door.geojson"),
                "--cell",
                "0.5",
                "--headings",
                "4",
                "-o",
                str(tmp_path / "p"),
            ]
        )
        == 0
    )
    assert "reachable" in capsys.readouterr().err


def test_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "a") as part:
        part.write_text("done")
    with pytest.raises(KeyboardInterrupt), atomic_file(tmp_path / "b") as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
