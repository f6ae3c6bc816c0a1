"""A plan resumes from a run of the same arena, and refuses what cannot be one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from planners_samples import outlined, shipped

from logs import RangeSensor, Recorder, Run, read
from planners.arena import Arena
from planners.errors import PlanError
from planners.maps import geojson
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.graph import Sensorgraph
from sensorgraph.planning.plan import _survey
from sensorgraph.planning.plan import plan as sg_plan
from sensorgraph.planning.resume import driven_poses, other_place_warnings, shared_walls
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import default_robot

pytestmark = pytest.mark.usefixtures("trusted_scans", "narrow_search")


def recorded(path: Path, poses: np.ndarray, arena: Arena | None = None, robot: str | None = None) -> Path:
    """Record a scan at each pose, ten a second."""
    sensor = RangeSensor(bearings=np.linspace(-1, 1, 5), range_max=8.0)
    with Recorder(path, sensor=sensor) as recorder:
        for k, pose in enumerate(poses):
            recorder.pose(0.1 * k, pose)
            recorder.scan(0.1 * k, np.ones(5))
        if arena is not None:
            recorder.attach("arena.geojson", geojson.dumps(arena).encode())
        if robot is not None:
            recorder.attach("robot.yaml", robot.encode())
    return path


DRIVE = np.column_stack([np.linspace(0.5, 3.5, 20), np.full(20, 0.5), np.zeros(20)])


def test_the_poses_of_the_scans_come_back(tmp_path: Path) -> None:
    for arena in (None, shipped("square")):
        run = recorded(tmp_path / "run.mcap", DRIVE, arena)
        np.testing.assert_allclose(driven_poses(read(run), shipped("square")), DRIVE, atol=1e-6)


def test_two_runs_are_resumed_as_if_they_were_one(tmp_path: Path) -> None:
    parts = [DRIVE[:8], DRIVE[8:]]
    runs = [recorded(tmp_path / f"{k}.mcap", part) for k, part in enumerate(parts)]
    (tmp_path / "whole").mkdir()
    whole = recorded(tmp_path / "whole" / "run.mcap", DRIVE)
    one, both = (
        sg_plan("square", cell=0.5, headings=4, resume=given).to_dict()
        for given in (whole, [str(runs[0]), read(runs[1])])
    )
    assert both["coverage_before"] == one["coverage_before"] > 0
    assert both["drive_time_s"] == one["drive_time_s"]


def test_a_run_of_another_arena_is_refused_by_its_walls(tmp_path: Path) -> None:
    """All its poses lie in free space of the office; its walls do not stand there."""
    run = recorded(tmp_path / "run.mcap", DRIVE, shipped("square"))
    with pytest.raises(PlanError, match=r"driven in another arena, of x 0 to 4.* of its walls .* x 0 to 15"):
        driven_poses(read(run), shipped("office"))


def test_an_arena_that_has_grown_or_lost_an_obstacle_is_the_same(tmp_path: Path) -> None:
    room = outlined(shapely.box(0, 0, 4, 1).difference(shapely.box(1.6, 0.8, 2.2, 1.0)))
    larger = outlined(shapely.box(0, 0, 4, 1).union(shapely.box(4, 0, 8, 1)))
    assert shared_walls(room.walls, room) == 1.0
    assert 0.7 < shared_walls(room.walls, larger) < 1.0
    assert len(driven_poses(read(recorded(tmp_path / "run.mcap", DRIVE, room)), larger)) == len(DRIVE)


def test_a_run_whose_poses_lie_elsewhere_is_refused(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run.mcap", DRIVE + [20.0, 0.0, 0.0])
    with pytest.raises(PlanError, match="0 % of its poses lie in the free space of this arena"):
        driven_poses(read(run), shipped("square"))


@pytest.mark.usefixtures("no_pictures")
def test_a_run_is_resumed_with_its_own_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = "{name: rover, footprint_radius: 0.3}"
    run = recorded(tmp_path / "run.mcap", DRIVE, shipped("square"), robot)
    options = ["--cell", "1", "--headings", "4", "--resume", str(run)]
    assert cli(["plan", *options, "-o", str(tmp_path / "out")]) == 0
    assert "planned for the run's robot rover, a disc of 0.3 m" in capsys.readouterr().out
    assert "0.3" in (tmp_path / "out" / "robot.yaml").read_text()


def test_an_empty_run_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(tmp_path / "run.mcap", DRIVE[:0])
    assert cli(["plan", "square", "--resume", str(run), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert str(run) in said[0]
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def graph_of(room: Arena, sensor: RangeSensor) -> Sensorgraph:
    """Return the graph of 600 scans, evenly over a room."""
    rng = np.random.default_rng(5)
    poses = rng.uniform([0.2, 0.2, -np.pi], [3.8, 2.8, np.pi], (600, 3))
    poses = poses[room.contains(poses[:, :2])]
    stamps = np.arange(len(poses)) / 10
    ranges = cast(room, poses, sensor).ranges + 0.01 * rng.normal(size=(len(poses), sensor.n_rays))
    return build([Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)])


@pytest.mark.slow
def test_a_graph_of_another_place_is_doubted(room: Arena, sensor: RangeSensor) -> None:
    graph = graph_of(room, sensor)
    assert other_place_warnings(graph, room) == []
    (line,) = other_place_warnings(graph, outlined(shapely.box(10, 10, 14, 13)))
    assert line.startswith("0 % of the sensorgraph's walls are in this arena")


@pytest.mark.slow
def test_where_runs_have_looked_counts_less_though_the_graph_does_not_know_it(
    room: Arena, sensor: RangeSensor
) -> None:
    """What a graph cannot know, however often it is seen, must not draw every run."""
    graph, looked = graph_of(room, sensor), np.array([[1.0, 1.0, 0.0]])
    first, again = (
        _survey("anytime", room, default_robot(), graph, visited)
        for visited in (None, np.repeat(looked, 50, axis=0))
    )
    assert first is not None
    assert again is not None
    assert 0 < again.gain(looked)[0] < 0.1 * first.gain(looked)[0]
