"""A plan cut for a battery, a budget or an end pose is still a plan: in time, at rest, feasible, and nothing is lost."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from planners_samples import door_arena, outlined

from planners import Plan, PlanError, plan, planning
from planners.arena import Arena, wrap
from planners.battery import battery_sessions, farthest_first
from planners.check import check
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.curve import Curve
from planners.export import commands, waypoints
from planners.methods import coverage_spins
from planners.methods.repair_cars import CarRepair
from planners.sections import (
    PathCache,
    cut_points,
    end_poses,
    fit_to_budget,
    longest_section,
    section_of,
    section_up_to,
    turning_stops,
)
from planners.task import JoinCounts, PlannedDrive, Task
from planners.vehicle import Drive, Limits, Vehicle
from sensorgraph.planning.plan_folder import counted

pytestmark = pytest.mark.usefixtures("narrow_search")

ROBOT = Vehicle()
GRID = {"cell": 0.5, "headings": 8}


def task_of(made: Plan, arena: Arena, vehicle: Vehicle = ROBOT) -> tuple[PlannedDrive, Task]:
    driven = PlannedDrive(curve=made.curve, stops=made.stops, joins=JoinCounts())
    task = Task(
        arena=arena,
        vehicle=vehicle,
        barriers=Barriers(arena),
        reach=made.reach,
        coverage=Coverage(
            origin=made.coverage.origin,
            cell=made.coverage.cell,
            reachable=made.coverage.reachable,
            counts=np.zeros_like(made.coverage.counts),
            core=np.zeros_like(made.coverage.core),
        ),
        start=None,
        seed=0,
        rate=10.0,
        priority=None,
        duration=None,
        progress=None,
    )
    return driven, task


@pytest.fixture(scope="module")
def rooms() -> tuple[Plan, Arena]:
    arena = door_arena(0.9)
    return plan(arena, ROBOT, **GRID), arena


def assert_drives(curve: Curve, arena: Arena) -> None:
    """Rest to rest, no limit broken, clear of walls all along."""
    twists = curve.sample(np.array([0.0, curve.duration]))[1]
    np.testing.assert_allclose(twists, 0.0, atol=1e-9)
    found = check(curve.trajectory(100.0), arena, ROBOT)
    assert found.violations == dict.fromkeys(found.violations, 0)


@pytest.mark.parametrize("planner", ["coverage", "stop_and_spin"])
def test_sections_between_any_cuts_pass_all_that_the_whole_passes(
    planner: str, rooms: tuple[Plan, Arena]
) -> None:
    made, arena = rooms
    if planner != "coverage":
        made = plan(arena, ROBOT, planner=planner, **GRID)
    choice = cut_points(made.curve, ROBOT)
    marks = [int(choice[k]) for k in (0, len(choice) // 3, len(choice) // 2, -1)]
    logged = []
    for first, last in pairwise(marks):
        part = section_of(made.curve, first, last, ROBOT)
        assert_drives(part, arena)
        logged.append(part.log(10.0))
    assert counted(made.coverage, np.concatenate(logged)).fraction == 1.0


def test_every_run_begins_and_ends_at_the_dock_within_the_battery(rooms: tuple[Plan, Arena]) -> None:
    made, arena = rooms
    driven, task = task_of(made, arena)
    dock, battery = np.array([0.4, 0.5, 1.0]), 150.0
    runs = battery_sessions(driven, task, battery=battery, dock=dock)
    assert len(runs) >= made.curve.duration / battery
    logged = []
    for run in runs:
        curve = run.driven.curve
        assert curve.duration <= battery + 1e-6
        for pose in end_poses(curve):
            np.testing.assert_allclose(pose[:2], dock[:2], atol=1e-9)
            assert abs(wrap(pose[2] - dock[2])) < 1e-9
        assert_drives(curve, arena)
        logged.append(curve.log(10.0))
    assert counted(made.coverage, np.concatenate(logged)).fraction == 1.0
    assert sum(run.driven.joins.planned for run in runs) > 0  # the other room lies behind a door


def test_a_battery_too_small_for_the_farthest_cell_is_one_line(rooms: tuple[Plan, Arena]) -> None:
    driven, task = task_of(*rooms)
    with pytest.raises(PlanError, match=r"battery of 0.2 min is too small: .* min at least") as caught:
        battery_sessions(driven, task, battery=12.0, dock=np.array([0.4, 0.5, 1.0]))
    assert "\n" not in str(caught.value)


def test_where_the_nearest_cut_fits_the_battery_is_not_too_small(
    rooms: tuple[Plan, Arena],
) -> None:
    (driven, task), dock = task_of(*rooms), np.array([0.4, 0.5, 1.0])
    choice, cache = cut_points(driven.curve, ROBOT), PathCache(task)
    for first in choice[:-1:25].tolist():
        nearest = int(choice[choice > first][0])
        least = section_up_to(driven.curve, first, nearest, dock, cache, ROBOT).duration
        assert longest_section(driven.curve, first, least + 1e-6, dock, cache, ROBOT) is not None


def test_early_runs_are_spread_out() -> None:
    points = np.array([[x, 0.0] for x in range(9)], dtype=np.float64)
    order = farthest_first(points)
    assert sorted(order) == list(range(9))
    assert order[:3] == [0, 8, 4]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 2.0])
@pytest.mark.parametrize("end", [None, np.array([3.5, 2.5, -2.0])], ids=["anywhere", "end"])
def test_a_budget_is_kept_and_used(
    rooms: tuple[Plan, Arena], share: float, end: np.ndarray[tuple[int], np.dtype[np.float64]] | None
) -> None:
    made, arena = rooms
    driven, task = task_of(made, arena)
    budget = share * made.curve.duration
    cut = fit_to_budget(driven, task, budget=budget, end=end)
    assert cut.curve.duration <= budget + 1e-6
    if share < 1:
        assert cut.curve.duration >= budget - 15.0  # a stop comes that often, and ways home differ little
    assert_drives(cut.curve, arena)
    np.testing.assert_allclose(end_poses(cut.curve)[0], end_poses(made.curve)[0], atol=1e-9)
    if end is not None:
        last = end_poses(cut.curve)[1]
        np.testing.assert_allclose(last[:2], end[:2], atol=1e-9)
        assert abs(wrap(last[2] - end[2])) < 1e-9
    elif share > 1:
        assert cut is driven


def test_stops_found_in_a_curve_turn_as_far_as_the_robot_does(rooms: tuple[Plan, Arena]) -> None:
    curve = rooms[0].curve
    found = turning_stops(curve)
    dt = np.diff(np.append(curve.starts, curve.duration))
    turned = (curve.twists[:, 1] * dt + 0.5 * curve.rates[:, 1] * dt**2).sum()
    assert found[:, 3].sum() == pytest.approx(turned, abs=1e-6)
    assert abs(found[:, 3]).max() <= 2 * np.pi + np.pi / 4


def test_a_plan_for_batteries_tells_of_every_run(rooms: tuple[Plan, Arena]) -> None:
    arena, dock = rooms[1], np.array([0.4, 0.5, 1.0])
    made = plan(arena, ROBOT, battery=150.0, dock=dock, **GRID)
    told = made.report["sessions"]
    assert len(told) == len(made.sessions) > 1
    assert sum(run["new_bins"] for run in told) == made.report["covered_cells"]
    assert [run["coverage"] for run in told] == sorted(run["coverage"] for run in told)
    assert told[-1]["coverage"] == made.report["coverage"] == 1.0
    assert sum(run["drive_time_s"] for run in told) == pytest.approx(made.curve.duration)
    assert made.report["limit_violations"] == 0
    assert made.report["joins"]["failed"] == 0
    np.testing.assert_allclose(made.trajectory.poses[[0, -1]], [dock, dock], atol=1e-9)
    waypoints_turn = sum(abs(run.driven.stops[:, 3]).sum() for run in made.sessions)
    assert made.report["turned_rad"] == pytest.approx(waypoints_turn)


def test_half_the_time_still_covers_half_and_ends_where_told(rooms: tuple[Plan, Arena]) -> None:
    made, arena = rooms
    end = np.array([3.5, 2.5, -2.0])
    half = plan(arena, ROBOT, budget=0.5 * made.curve.duration, end=end, **GRID)
    assert half.report["drive_time_s"] <= 0.5 * made.curve.duration
    assert 0.4 < half.report["coverage"] < 0.8
    assert half.report["limit_violations"] == 0
    np.testing.assert_allclose(half.trajectory.poses[-1], end, atol=1e-6)


def test_ctrl_c_keeps_a_valid_shorter_plan(rooms: tuple[Plan, Arena]) -> None:
    def interrupt(done: int, total: int) -> None:
        if done > 0.4 * total:
            raise KeyboardInterrupt

    made = plan(rooms[1], ROBOT, cell=0.25, headings=16, progress=interrupt)
    assert made.report["interrupted"]
    assert "shorter" in made.report["warnings"][0]
    assert 0.0 < made.report["coverage"] < 1.0
    assert_drives(made.curve, rooms[1])


def pressing(work: Callable[..., Any], times: int = 1) -> Callable[..., Any]:
    """Return what does some work while Ctrl-C is pressed some times."""

    def pressed(*args: Any, **kwargs: Any) -> Any:
        for _ in range(times):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.3)
        return work(*args, **kwargs)

    return pressed


@pytest.mark.parametrize("drive", ["diff", pytest.param("reeds_shepp", marks=pytest.mark.slow)])
def test_ctrl_c_while_rooms_are_joined_keeps_what_is_joined(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.3))
    if drive == "diff":
        monkeypatch.setattr(coverage_spins, "_join_rooms", pressing(coverage_spins._join_rooms))
    else:
        monkeypatch.setattr(CarRepair, "enter_room", pressing(CarRepair.enter_room))
    made = plan(door_arena(1.2), vehicle, cell=0.25, headings=8)
    assert made.report["interrupted"]
    assert made.report["coverage"] > 0.3
    assert made.report["limit_violations"] == 0


def test_ctrl_c_while_a_plan_is_measured_keeps_it_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = plan(door_arena(9.0), ROBOT, cell=0.5, headings=4)
    monkeypatch.setattr(planning, "plan_report", pressing(planning.plan_report))
    made = plan(door_arena(9.0), ROBOT, cell=0.5, headings=4)
    assert made.report["interrupted"]
    assert made.report["coverage"] == whole.report["coverage"]
    monkeypatch.setattr(planning, "plan_report", pressing(planning.plan_report, times=2))
    with pytest.raises(KeyboardInterrupt):
        plan(door_arena(9.0), ROBOT, cell=0.5, headings=4)


def test_ctrl_c_before_anything_is_found_ends_all(rooms: tuple[Plan, Arena]) -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan(rooms[1], ROBOT, planner="stop_and_spin", progress=interrupt, **GRID)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"end": np.array([5.0, 1.0, 0.0])}, r"end \(5, 1\) is .* m inside a wall or outside"),
        ({"end": np.array([0.1, 1.0, 0.0])}, r"end \(0\.1, 1\) is 0\.100 m from a wall"),
        ({"end": np.array([1.0, np.nan, 0.0])}, "end is .*three finite numbers"),
        ({"budget": -1.0}, "budget is -1"),
        ({"budget": 0.3}, "budget of .* too short"),
        ({"battery": 0.0}, "battery is 0"),
        ({"battery": 5.0, "dock": np.array([0.5, 0.5, 0.0])}, "battery of .* too small"),
        ({"dock": np.array([0.5, 0.5, 0.0])}, "a dock needs a battery"),
        ({"battery": 100.0, "budget": 100.0}, "leave out `end` and `budget`"),
        ({"battery": 100.0, "dock": np.array([0.1, 0.5, 0.0])}, r"0\.100 m from a wall"),
        (
            {"battery": 100.0, "dock": np.array([0.5, 0.5, 0.0]), "start": np.array([1.0, 0.5, 0.0])},
            "starts at the dock",
        ),
    ],
)
def test_what_does_not_go_together_is_one_line(
    rooms: tuple[Plan, Arena], options: dict[str, Any], says: str
) -> None:
    with pytest.raises(PlanError, match=says) as caught:
        plan(rooms[1], ROBOT, **GRID, **options)
    assert "\n" not in str(caught.value)


def test_an_end_pose_behind_a_closed_door_is_refused() -> None:
    with pytest.raises(PlanError, match="cannot be reached from the start"):
        plan(door_arena(0.0), ROBOT, start=np.array([1.0, 1.0, 0.0]), end=np.array([3.0, 1.0, 0.0]), **GRID)


@pytest.mark.parametrize("planner", ["coverage", "stop_and_spin"])
def test_commands_drive_as_far_as_the_plan(planner: str, rooms: tuple[Plan, Arena]) -> None:
    """Held as they are, they end where the plan does: unicycle arcs between two commands are exact."""
    made = plan(rooms[1], ROBOT, planner=planner, **GRID)
    stamps, twists = commands(made.curve, 100.0)
    dt = np.diff(stamps)[:, None]
    turn = twists[:-1, 1:] * dt
    phi = made.curve.poses[0, 2] + np.cumsum(turn) - turn[:, 0]
    way = (twists[:-1, :1] * dt * np.sinc(turn / (2 * np.pi)))[:, 0]
    ended = made.curve.poses[0, :2] + np.array(
        [(way * np.cos(phi + turn[:, 0] / 2)).sum(), (way * np.sin(phi + turn[:, 0] / 2)).sum()]
    )
    np.testing.assert_allclose(
        ended, made.trajectory.poses[-1, :2], atol=0.01
    )  # 5 ms mean twists, no feedback
    turned = made.curve.poses[0, 2] + turn.sum()
    assert abs(wrap(turned - made.trajectory.poses[-1, 2])) < 1e-6
    assert (twists[-1] == 0).all()
    assert abs(twists).max(axis=0) == pytest.approx(abs(made.trajectory.twists).max(axis=0), rel=0.05)


def test_nav2_steps_visit_every_stop_and_turn_as_far(rooms: tuple[Plan, Arena]) -> None:
    made = plan(rooms[1], ROBOT, planner="stop_and_spin", **GRID)
    data = yaml.safe_load(waypoints(made))
    spins = [step["target_yaw"] for step in data["steps"] if step["action"] == "Spin"]
    turned = made.stops[:, 3]
    assert sum(spins) == pytest.approx(turned[abs(turned) > 0.01].sum(), abs=1e-3)
    here = np.array(made.trajectory.poses[0])
    for step in data["steps"]:
        if step["action"] == "Spin":
            here[2] += step["target_yaw"]
            continue
        place = data["poses"][step["pose"]]["position"]
        way = np.array([place["x"], place["y"]]) - here[:2]
        heading = np.arctan2(way[1], way[0]) + (np.pi if step["backward"] else 0.0)
        assert abs(wrap(heading - here[2])) < 0.1  # a turn that overlaps a move bends it by millimetres
        here[:2] = place["x"], place["y"]
    np.testing.assert_allclose(here[:2], made.trajectory.poses[-1, :2], atol=0.01)
    assert yaml.safe_load(waypoints(rooms[0]))["steps"] == []  # it turns while it moves


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
def test_cars_come_home_too(drive: Any) -> None:
    arena, dock = outlined(shapely.box(0, 0, 4, 3)), np.array([2.0, 0.6, 0.0])
    car = Vehicle(drive=drive, limits=Limits(turning_radius=0.4))
    made = plan(arena, car, start=dock, **GRID)
    driven, task = task_of(made, arena, car)
    runs = battery_sessions(driven, task, battery=120.0, dock=dock)
    assert len(runs) > 1
    for run in runs:
        curve = run.driven.curve
        assert curve.duration <= 120.0 + 1e-6
        for pose in end_poses(curve):
            np.testing.assert_allclose(pose[:2], dock[:2], atol=1e-5)
            assert abs(wrap(pose[2] - dock[2])) < 1e-5
        assert check(curve.trajectory(100.0), arena, car).count == 0
    logged = np.concatenate([run.driven.curve.log(10.0) for run in runs])
    task.coverage.add(logged)
    assert task.coverage.fraction >= made.report["coverage"] - 0.005
    half = fit_to_budget(driven, task, budget=60.0, end=None)
    assert 50.0 < half.curve.duration <= 60.0 + 1e-6
    assert check(half.curve.trajectory(100.0), arena, car).count == 0
