"""`record` and `review` as a user runs them: files that others open, same seed same bytes, mistakes in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import logs
import sensorgraph.data
from planners.arena import wrap
from planners.maps import geojson
from planners.trajectory import Trajectory
from sensorgraph.cli import run as cli
from sensorgraph.effects.effects_file import loads
from sensorgraph.loading import load_arena


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a plan's folder: spin half a turn at a spot of the square arena, from rest to rest."""
    folder = tmp_path_factory.mktemp("plan")
    t = np.arange(0, 8.0, 0.02)
    omega = 0.8 * np.sin(np.pi * t / t[-1]) ** 2
    phi = np.concatenate([[0], np.cumsum((omega[1:] + omega[:-1]) / 2 * 0.02)])
    poses = np.column_stack([np.full_like(t, 0.6), np.full_like(t, 0.6), wrap(phi)])
    Trajectory(
        stamps=t, poses=poses, twists=np.column_stack([0 * t, omega]), primitives=np.full(len(t), "spin")
    ).write_csv(folder / "trajectory.csv")
    return folder


@pytest.fixture(scope="module")
def recorded(plan: Path) -> Path:
    out = plan / "run.mcap"
    assert cli(["record", str(plan), "--arena", "square", "-o", str(out)]) == 0
    return out


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command that must fail for the user's fault; return its one line."""
    assert cli([str(a) for a in arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_a_recording_holds_every_signal_at_its_rate(recorded: Path) -> None:
    run = logs.read(recorded)
    assert run.ranges.shape == (85, 181)
    assert np.diff(run.stamps) == pytest.approx(0.1, abs=1e-6)
    assert np.median(np.diff(run.pose_stamps)) == pytest.approx(1 / 30, abs=1e-6)
    assert np.median(np.diff(run.odom_stamps)) == pytest.approx(0.05, abs=1e-6)
    assert len(run.commands) > 150
    assert {"arena.geojson", "robot.yaml"} <= set(run.attachments)
    assert logs.pair(run).paired.all()


def test_same_seed_same_bytes_other_seed_other_noise(plan: Path, recorded: Path, tmp_path: Path) -> None:
    for seed, same in ((0, True), (1, False)):
        again = tmp_path / f"{seed}.mcap"
        assert cli(["record", str(plan), "--arena", "square", "--seed", str(seed), "-o", str(again)]) == 0
        assert (again.read_bytes() == recorded.read_bytes()) == same


def test_recorded_commands_drive_the_robot_again(recorded: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    assert cli(["record", str(recorded), "--arena", "square", "-o", str(again)]) == 0
    first, second = logs.read(recorded), logs.read(again)
    turn = np.ptp(np.unwrap(first.poses[:, 2])), np.ptp(np.unwrap(second.poses[:, 2]))
    assert turn[0] == pytest.approx(turn[1], abs=0.05)


GLASS = """
- name: glass
  parameters: {a: 0.0, b: 4.0, alpha_ret: 0.0, depth: 1.0}
  location: {name: square/edge_0}
- {name: wheel_radius, parameters: {s: 0.05}}
- {name: actuator_lag, parameters: {tau: 0.3}}
- {name: people, parameters: {p: 0.02}}
"""


def test_effects_change_scans_wheels_and_motors_and_are_kept(
    plan: Path, recorded: Path, tmp_path: Path
) -> None:
    (tmp_path / "effects.yaml").write_text(GLASS)
    runs = []
    for name in ("a", "b"):
        out = tmp_path / f"{name}.mcap"
        arguments = ["record", str(plan), "--arena", "square", "--effects", str(tmp_path / "effects.yaml")]
        assert cli([*arguments, "-o", str(out)]) == 0
        runs.append(out.read_bytes())
    assert runs[0] == runs[1]
    plain, amended = logs.read(recorded), logs.read(tmp_path / "a.mcap")
    assert amended.meta["effects"] == "glass, wheel_radius, actuator_lag, people"
    kept = loads(amended.attachments["effects.yaml"].decode())
    assert [a.name for a in kept] == ["glass", "wheel_radius", "actuator_lag", "people"]
    assert "effects.yaml" not in plain.attachments
    assert "effects" not in plain.meta
    both = np.isfinite(plain.ranges) & np.isfinite(amended.ranges)
    farther = (amended.ranges - plain.ranges)[both] > 0.8  # one wall of four is a pane
    assert 0.1 < farther.mean() < 0.4
    turned = [
        np.ptp(np.unwrap(r.odometry[:, 2])) / np.ptp(np.unwrap(r.poses[:, 2])) for r in (plain, amended)
    ]
    assert turned[1] / turned[0] == pytest.approx(1.05, abs=0.01)


TURTLE = """
name: turtle
footprint_radius: 0.11
sensor: {n_rays: 36, fov: 6.283185307, range_min: 0.12, range_max: 3.5, rate: 5.0}
"""


def test_a_plan_is_driven_in_its_own_arena_by_its_own_robot(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "plan" / "run_1"  # a run of a battery keeps both one folder up
    folder.mkdir(parents=True)
    (folder / "trajectory.csv").write_text((plan / "trajectory.csv").read_text())
    (tmp_path / "plan" / "robot.yaml").write_text(TURTLE)
    (tmp_path / "plan" / "arena.geojson").write_text(geojson.dumps(load_arena("square")))
    assert cli(["record", str(folder), "-o", str(tmp_path / "own.mcap")]) == 0
    captured = capsys.readouterr()
    assert f"arena and robot of {folder} (turtle)" in captured.out
    assert captured.err == ""
    run = logs.read(tmp_path / "own.mcap")
    assert (run.sensor.n_rays, run.sensor.range_max) == (36, 3.5)
    assert run.attachments["robot.yaml"].decode() == TURTLE
    again = ["record", str(tmp_path / "own.mcap"), "-o", str(tmp_path / "again.mcap")]
    assert cli(again) == 0, "a run is driven again in the arena and by the robot that it keeps"
    assert logs.read(tmp_path / "again.mcap").sensor.n_rays == 36


def test_another_robot_or_arena_than_the_plan_has_is_warned_of(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trajectory.csv").write_text((plan / "trajectory.csv").read_text())
    (tmp_path / "robot.yaml").write_text(TURTLE)
    (tmp_path / "arena.geojson").write_text(geojson.dumps(load_arena("square")))
    (tmp_path / "other.yaml").write_text(TURTLE + "limits: {v: 0.2}\n")
    arguments = ["record", str(tmp_path), "--robot", str(tmp_path / "other.yaml"), "--arena", "office"]
    assert cli([*arguments, "-o", str(tmp_path / "a.mcap")]) in (
        0,
        2,
    )  # 2: the start may lie in a wall of the office
    said = capsys.readouterr().err
    assert "was planned for another arena" in said
    assert "was planned for another robot: limits.v differ" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["record", "{plan}", "--arena", "nowhere", "-o", "{tmp}/a.mcap"], "one of office, square"),
        (["record", "{plan}", "-o", "{tmp}/a.mcap"], "keeps no arena; give --arena NAME or --graph GRAPH"),
        (["record", "{tmp}/none", "--arena", "square", "-o", "{tmp}/a.mcap"], "does not exist"),
        (
            ["record", "{data}/square.geojson", "-o", "{tmp}/a.mcap"],
            "is an arena or a robot, expected a plan's",
        ),
        (["record", "{plan}", "--arena", "square", "-o", "{tmp}/a.bag"], "name it a.mcap"),
        (
            ["record", "{plan}", "--arena", "square", "-o", "{tmp}/no/a.mcap"],
            "create it or write to another folder",
        ),
        (
            ["record", "{plan}", "--arena", "square", "--robot", "{tmp}", "-o", "{tmp}/a.mcap"],
            "is a directory",
        ),
        (["record", "{run}", "--arena", "square", "--start", "1,2", "-o", "{tmp}/a.mcap"], "X,Y,PHI"),
        (["record", "{run}", "--arena", "square", "--start", "0.1,2,0", "-o", "{tmp}/a.mcap"], "from a wall"),
        (
            ["record", "{plan}", "--arena", "square", "--effects", "{tmp}/e", "-o", "{tmp}/a.mcap"],
            "does not exist",
        ),
        (
            ["record", "{plan}", "--arena", "square", "--effects", "{run}", "-o", "{tmp}/a.mcap"],
            "not a text file",
        ),
        (
            ["record", "{plan}", "--arena", "square", "--effects", "{csv}", "-o", "{tmp}/a.mcap"],
            "expected a list",
        ),
        (["review", "{run}", "-o", "{tmp}/a.png"], "name it a.rrd"),
        (["review", "{run}", "--graph", "{run}", "-o", "{tmp}/a.rrd"], "is a log (mcap) and no sensorgraph"),
        (["review", "{run}", "--ray", "181", "-o", "{tmp}/a.rrd"], "rays 0 to 180"),
        (["review", "{run}", "--plan", "{tmp}/none", "-o", "{tmp}/a.rrd"], "trajectory.csv"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_file(
    arguments: list[str],
    said: str,
    plan: Path,
    recorded: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = {"plan": plan, "run": recorded, "csv": plan / "trajectory.csv", "tmp": tmp_path}
    names["data"] = Path(sensorgraph.data.__path__[0])
    assert said in fails(capsys, *(a.format(**names) for a in arguments))
    assert not list(tmp_path.iterdir())
