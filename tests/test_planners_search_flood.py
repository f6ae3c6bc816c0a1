"""A Dubins car's flood of the floor finds ways through gaps that random samples miss, and only ways there and back."""

from __future__ import annotations

import numpy as np
import pytest
from planners_samples import door_arena

import planners.repair as repairs
from planners.arena import Arena, Bools, Floats
from planners.check import check
from planners.clearance import Barriers
from planners.connect import Joins
from planners.coverage import Coverage
from planners.coverage_planner import Task
from planners.reach import reach
from planners.repair import CarRepair
from planners.robot import Limits, Robot
from planners.search import Settings, Visit
from planners.search_cars import search_floor
from planners.search_flood import Ways, cycle
from planners.search_log import missed
from planners.steering import joined

START = np.array([0.8, 0.8, 0.3])


def task_of(arena: Arena, headings: int = 16) -> Task:
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.22, cell=0.25, start=START)
    grid = Coverage.empty(origin=free.origin, cell=free.cell, cells=free.cells(), headings=headings)
    return Task(
        arena=arena, robot=Robot(drive="dubins", limits=Limits(turning_radius=0.3)), barriers=barriers, reach=free,
        coverage=grid, start=START, seed=0, rate=10.0, priority=None, duration=None, progress=None,
    )  # fmt: skip


def some(task: Task, *bins: tuple[int, int, int]) -> Bools:
    todo = np.zeros_like(task.coverage.reachable)
    todo[tuple(np.array(bins).T)] = True
    return todo


@pytest.mark.parametrize("door", [0.5, 0.6, 1.2])
@pytest.mark.parametrize("goal", [(12, 6, 0), (12, 6, 8), (13, 4, 4)])
def test_a_way_leads_through_the_door_into_the_bin(door: float, goal: tuple[int, int, int]) -> None:
    task = task_of(door_arena(door))
    wanted = some(task, goal)
    curve = Ways(task).to_one_of(wanted, START)
    assert curve is not None
    np.testing.assert_allclose(curve.poses[0], START)
    end = curve.sample(np.array([curve.duration]))[0]
    assert not missed(curve, wanted, task.coverage, task.rate).any()
    assert np.hypot(*(end[0, :2] - task.reach.origin - (np.array(goal[:2]) + 0.5) * 0.25)) < 0.3
    found = check(curve.trajectory(100.0), task.arena, task.robot)
    assert found.count == 0
    assert found.min_clearance > task.robot.footprint_radius


def test_of_several_bins_it_goes_to_the_nearest() -> None:
    task = task_of(door_arena(0.6))
    near, both = some(task, (6, 4, 2)), some(task, (6, 4, 2), (13, 4, 4))
    ways = Ways(task)
    one, other = ways.to_one_of(near, START), ways.to_one_of(both, START)
    assert one is not None
    assert other is not None
    assert one.duration == other.duration


def test_no_way_leads_through_a_wall_or_to_where_the_car_could_not_come_back_from() -> None:
    closed, open_ = task_of(door_arena(0.0)), task_of(door_arena(0.6))
    assert Ways(closed).to_one_of(some(closed, (12, 6, 0)), START) is None
    back = cycle(open_.reach, open_.robot.limits, 16, 10.0, START)
    trapped = open_.coverage.reachable & ~back
    assert trapped.any()
    assert back[12:14].any()
    assert Ways(open_).to_one_of(trapped, START) is None


def test_a_room_that_ompl_finds_no_way_into_is_entered_by_the_flood(monkeypatch: pytest.MonkeyPatch) -> None:
    task = task_of(door_arena(0.6))
    todo = np.zeros_like(task.coverage.reachable)
    todo[11:13, 5:7] = True
    todo &= cycle(task.reach, task.robot.limits, 16, 10.0, START)

    def in_vain(starts: Floats, goals: list[Floats], **_: object) -> tuple[list[None], Joins]:
        return [None] * len(starts), Joins(failed=len(starts))

    def search(missing: Bools, here: Floats, seed: int) -> Visit | None:
        return search_floor(missing, task, here, seed, lambda _: True, Settings(beam=30))

    monkeypatch.setattr(repairs, "connect_cars", in_vain)
    repair = CarRepair(task, todo, START, search)
    visit = search(todo, np.array([3.1, 1.5, 0.0]), 0)
    assert visit is not None
    repair.enters(todo, visit.ends[0], visit.curve, 0)
    curve = joined(repair.curves)
    assert (repair.joins.failed, repair.joins.flooded) == (1, 1)
    assert missed(curve, todo, task.coverage, task.rate).sum() <= 0.1 * todo.sum()
    assert check(curve.trajectory(100.0), task.arena, task.robot).count == 0
