"""A log that holds a map serves as the arena: its attachment, or the last grid of /map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs_samples import some_run
from rosbag_samples import Message, message, quaternion, scan, write_bag1, write_bag2

import logs
from logs.recorded_map import read_map
from logs.ros.messages import GRID_TYPE
from planners.errors import PlanError
from planners.maps.ros_map import of_grid
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.loading import arena_in, attachments_of, load_arena, robot_in
from sensorgraph.world.robot import default_robot

ROOM = np.full((8, 12), -1)
ROOM[1:7, 1:11] = 100
ROOM[2:6, 2:10] = 0
"""(ny, nx) a room of 8 x 4 free cells with walls of one cell."""


def grid(
    stamp: float, cells: np.ndarray, *, topic: str = "/map", yaw: float = 0.0, resolution: float = 0.5
) -> Message:
    ny, nx = cells.shape
    return message(
        topic, GRID_TYPE, stamp, {"frame_id": "map"}, resolution=[resolution], size=[nx, ny],
        origin=[-1, 2, 0, *quaternion(yaw)], data=cells.reshape(-1),
    )  # fmt: skip


@pytest.mark.parametrize("is_ros1", [False, True])
@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_last_grid_of_map_is_the_arena(is_ros1: bool, yaw: float, tmp_path: Path) -> None:
    empty = np.full((3, 4), -1)
    bag = [
        grid(0, empty, yaw=yaw),
        scan(0, [1, 2]),
        grid(1, ROOM, yaw=yaw),
        grid(1, ROOM, topic="/local_costmap/costmap"),
    ]
    path = write_bag1(tmp_path / "a.bag", bag) if is_ros1 else write_bag2(tmp_path / "a", bag)
    found = read_map(path)
    assert found.grid is not None and found.source == "/map, the last of 2 messages"
    np.testing.assert_array_equal(found.grid.data, ROOM)
    arena = load_arena(path)
    assert arena.free.area == pytest.approx(8 * 4 * 0.25)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    middle = np.array([-1, 2]) + turn @ (0.5 * np.array([6, 4]))
    np.testing.assert_allclose(np.array(arena.free.centroid.coords[0]), middle, atol=1e-9)
    assert "33.3 % free, 29.2 % occupied, 37.5 % unknown" in arena.notes[0]


def test_attached_arena_comes_first(tmp_path: Path) -> None:
    square = (Path(__file__).parents[1] / "sensorgraph" / "data" / "square.geojson").read_bytes()
    run = replace(some_run(), attachments={"arena.geojson": square})
    logs.write(run, tmp_path / "run.mcap")
    np.testing.assert_array_equal(load_arena(tmp_path / "run.mcap").walls, load_arena("square").walls)


def test_log_without_one_map_says_what_it_has(tmp_path: Path) -> None:
    for k, (bag, words) in enumerate((
        ([scan(0, [1, 2])], r"no occupancy grid; it has /scan \(sensor_msgs"),
        ([grid(0, ROOM, topic="/a"), grid(0, ROOM, topic="/b")], r"several maps \(/a, /b\) and none in /map"),
        ([grid(0, ROOM, resolution=np.nan)], "has 96 cells of nan m at -1, 2; expected 12 x 8 cells"),
        ([grid(0, np.full((2, 2), -1))], r"no cell is free \(0\.0 % free, 0\.0 % occupied, 100\.0 % unknown\)"),
    )):  # fmt: skip
        with pytest.raises(SensorgraphError, match=words):
            load_arena(write_bag2(tmp_path / str(k), bag))
    (tmp_path / "plan.dxf").write_text("0 SECTION")
    with pytest.raises(SensorgraphError, match="no reader for"):
        load_arena(tmp_path / "plan.dxf")


def test_cells_between_the_thresholds_are_unknown() -> None:
    cells = np.array([[0, 25, 26, 64, 65, 100, -1]], dtype=np.int8)
    arena = of_grid(cells, 1.0, [0, 0, 0], "grid")
    assert arena.free.area == pytest.approx(2)
    assert arena.free.bounds == (0, 0, 2, 1)
    assert arena.walls[:, :, 0].min() == 4 and arena.walls[:, :, 0].max() == 6
    with pytest.raises(PlanError, match="no cell is occupied"):
        of_grid(0 * cells, 1.0, [0, 0, 0], "grid")


def test_commands_say_which_map_they_took(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_bag2(tmp_path / "bag", [grid(0, ROOM), *(scan(0.1 * i, [1, 2]) for i in range(3))])
    assert cli(["inspect", str(path), "--arena", str(path)]) == 0
    assert "12 x 8 cells of 0.5 m, 33.3 % free" in capsys.readouterr().out
    assert cli(["locate", str(path), "--arena", str(path)]) == 2  # three scans


def test_arena_and_robot_that_a_run_keeps_are_read_back() -> None:
    arena, robot = load_arena("square"), default_robot()
    run = replace(some_run(), attachments=attachments_of(arena, robot))
    kept, machine = arena_in(run), robot_in(run)
    assert kept is not None and machine is not None
    np.testing.assert_array_equal(kept.walls, arena.walls)
    assert machine.text == robot.text and set(attachments_of(arena, None)) == {"arena.geojson"}
