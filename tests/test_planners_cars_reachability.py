"""A Dubins car's wavefront over the floor finds paths through gaps that random samples miss, and only paths there and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import further
from planners_samples import door_arena, some, task_of

import planners.cars.reachability as reachability
import planners.methods.repair_cars as repairs
from planners.cars.reachability import ReachabilityPlanner, returnable_set
from planners.check import check
from planners.methods.coverage_cars import search_floor
from planners.methods.repair_cars import CarRepair
from planners.search.log_phases import missed
from planners.search.room_drive import RoomDrive
from planners.search.settings import SearchSettings
from planners.task import JoinCounts
from planners.types import Bools, Floats

START = np.array([0.8, 0.8, 0.3])


@pytest.mark.parametrize("door", [0.5, 1.2, *further(0.6)])
@pytest.mark.parametrize("goal", [(12, 6, 0), *further(((12, 6, 8),), ((13, 4, 4),))])
def test_a_way_leads_through_the_door_into_the_bin(door: float, goal: tuple[int, int, int]) -> None:
    task = task_of(door_arena(door), "dubins", START)
    wanted = some(task, goal)
    curve = ReachabilityPlanner(task).path_to_any(wanted, START)
    assert curve is not None
    np.testing.assert_allclose(curve.poses[0], START)
    end = curve.sample(np.array([curve.duration]))[0]
    assert not missed(curve, wanted, task.coverage, task.rate).any()
    assert np.hypot(*(end[0, :2] - task.reach.origin - (np.array(goal[:2]) + 0.5) * 0.25)) < 0.3
    found = check(curve.trajectory(100.0), task.arena, task.vehicle)
    assert found.count == 0
    assert found.min_clearance > task.vehicle.footprint_radius


def test_a_car_with_a_reverse_gear_backs_out_of_a_corner_and_goes_through_the_door() -> None:
    """It faces a wall, so that no drive leads on forward; what lies behind a wall is told once and for all."""
    trapped = np.array([3.75, 1.5, 0.0])
    task = task_of(door_arena(0.5), "reeds_shepp", trapped)
    wanted = some(task, (3, 6, 8))
    curve = ReachabilityPlanner(task).path_to_any(wanted, trapped)
    assert curve is not None
    assert not missed(curve, wanted, task.coverage, task.rate).any()
    found = check(curve.trajectory(100.0), task.arena, task.vehicle)
    assert found.count == 0
    assert found.min_clearance > task.vehicle.footprint_radius
    closed = task_of(door_arena(0.0), "reeds_shepp", START)
    assert ReachabilityPlanner(closed).path_to_any(some(closed, (12, 6, 0)), START) is None


def test_of_several_bins_it_goes_to_the_nearest() -> None:
    task = task_of(door_arena(0.6), "dubins", START)
    near, both = some(task, (6, 4, 2)), some(task, (6, 4, 2), (13, 4, 4))
    ways = ReachabilityPlanner(task)
    one, other = ways.path_to_any(near, START), ways.path_to_any(both, START)
    assert one is not None
    assert other is not None
    assert one.duration == other.duration


def test_no_way_leads_through_a_wall_or_to_where_the_car_could_not_come_back_from() -> None:
    closed, open_ = task_of(door_arena(0.0), "dubins", START), task_of(door_arena(0.6), "dubins", START)
    assert ReachabilityPlanner(closed).path_to_any(some(closed, (12, 6, 0)), START) is None
    back = returnable_set(open_.reach, open_.vehicle.limits, 16, 10.0, START).bins
    trapped = open_.coverage.reachable & ~back
    assert trapped.any()
    assert back[12:14].any()
    assert ReachabilityPlanner(open_).path_to_any(trapped, START) is None


def test_a_pose_leads_back_where_a_way_from_it_comes_back_and_not_out_of_a_corner() -> None:
    """Along a way through the door and back again each pose does; driving straight into a wall, none does."""
    task = task_of(door_arena(0.6), "dubins", START)
    ways = ReachabilityPlanner(task)
    there = ways.path_to_any(some(task, (12, 6, 8)), START)
    assert there is not None
    end = there.sample(np.array([there.duration]))[0][0]
    back = ways.path_to_any(some(task, (3, 3, 1)), end)
    assert back is not None
    poses = np.concatenate([one.sample(np.linspace(0.0, one.duration, 60))[0] for one in (there, back)])
    assert ways.can_return(poses, START).mean() > 0.9  # a lattice's cell may touch a wall
    trapped = np.array([[3.7, 2.7, np.pi / 4], [3.75, 1.5, 0.0], [1.0, 2.75, np.pi / 2]])
    assert not ways.can_return(trapped, START).any()


def test_what_an_exhaustive_wavefront_did_not_find_is_not_looked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = task_of(door_arena(0.0), "dubins", START)
    wavefronts, run_wavefront = list[int](), reachability._run_wavefront

    def counted(*args: Any, **kwargs: Any) -> reachability._WavefrontResult:
        wavefronts.append(1)
        return run_wavefront(*args, **kwargs)

    monkeypatch.setattr(reachability, "_run_wavefront", counted)
    ways, behind = ReachabilityPlanner(task), some(task, (12, 6, 0), (12, 6, 4))
    assert ways.path_to_any(behind, START) is None
    before = len(wavefronts)
    assert ways.path_to_any(behind, np.array([1.2, 1.0, 2.0])) is None
    assert len(wavefronts) == before
    assert ways.path_to_any(behind | some(task, (4, 6, 2)), START) is not None


def test_a_room_that_ompl_finds_no_way_into_is_entered_by_the_wavefront(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = task_of(door_arena(0.6), "dubins", START)
    todo = np.zeros_like(task.coverage.reachable)
    todo[11:13, 5:7] = True
    todo &= returnable_set(task.reach, task.vehicle.limits, 16, 10.0, START).bins

    def in_vain(start: Floats, goals: Floats, **_: object) -> tuple[None, JoinCounts]:
        return None, JoinCounts(failed=1)

    def search(missing: Bools, here: Floats, seed: int) -> RoomDrive | None:
        return search_floor(
            missing, task, here, seed, lambda left, seconds: True, SearchSettings(beam_width=30)
        )

    monkeypatch.setattr(repairs, "connect_car", in_vain)
    repair = CarRepair(task, todo, START, search)
    visit = search(todo, np.array([3.1, 1.5, 0.0]), 0)
    assert visit is not None
    repair.enter_room(todo, visit.ends[0], visit.curve, 0)
    curve = repair.drive.curve
    assert (repair.joins.failed, repair.joins.by_wavefront) == (1, 1)
    assert missed(curve, todo, task.coverage, task.rate).sum() <= 0.1 * todo.sum()
    assert check(curve.trajectory(100.0), task.arena, task.vehicle).count == 0
