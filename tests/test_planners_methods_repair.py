"""What the search leaves is driven to through OMPL's GoalStates; what is given up has a reason."""

from __future__ import annotations

import numpy as np
import pytest
from planners_samples import door_arena, some, task_of

import planners.methods.repair_cars as repairs
from planners import plan
from planners.check import check
from planners.joins.car_paths import CarPath
from planners.methods.coverage_cars import search_floor
from planners.methods.repair_cars import MAX_IDLE_QUERIES, CarRepair
from planners.methods.stop_and_spin import StopAndSpinPlanner
from planners.search.log_phases import missed
from planners.search.room_drive import RoomDrive
from planners.search.settings import SearchSettings
from planners.task import JoinCounts
from planners.types import Bools, Floats
from planners.vehicle import Drive, Limits, Vehicle

START = np.array([0.8, 0.8, 0.3])


def gives_up(_: Bools, __: Floats, ___: int) -> RoomDrive | None:
    return None


@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
def test_bins_behind_a_wall_that_the_search_gives_up_on_are_met_by_ompl(drive: Drive) -> None:
    task = task_of(door_arena(1.2), drive, START)
    todo = some(task, (12, 1, 0), (12, 2, 0), (3, 6, 8))  # two beyond the wall, one by the start
    repair = CarRepair(task, todo, START, gives_up)
    repair.run()
    curve = repair.drive.curve
    assert not repair.lost.any()
    assert not missed(curve, todo, task.coverage, task.rate).any()
    assert repair.joins.planned >= 1
    np.testing.assert_allclose(curve.poses[0], START)
    found = check(curve.trajectory(100.0), task.arena, task.vehicle)
    assert found.count == 0
    assert found.min_clearance > task.vehicle.footprint_radius


def test_what_is_crossed_on_the_way_is_not_driven_to_again() -> None:
    task = task_of(door_arena(9.0), "reeds_shepp", START)
    ahead = CarRepair(task, some(task, (12, 6, 0)), START, gives_up)
    ahead.run()
    (curve,) = ahead.drive.curves
    bins, logged = np.unique(task.coverage.bins(curve.log(task.rate))[0], axis=0, return_counts=True)
    crossed = [tuple(own) for own in bins[logged >= 4].tolist()]
    assert len(crossed) >= 4
    again = CarRepair(task, some(task, *crossed), START, gives_up)
    again.append_curve(curve)
    again.run()
    assert len(again.drive.curves) == 1
    assert again.joins == JoinCounts()


def test_a_bin_that_no_way_leads_to_is_given_up_and_said_to_be() -> None:
    """A Dubins car cannot come back from a corner that it drives straight into."""
    task = task_of(door_arena(9.0), "dubins", START)
    corner = (14, 10, 2)
    repair = CarRepair(task, some(task, corner, (5, 6, 8)), START, gives_up)
    repair.run()
    assert repair.lost[corner]
    assert repair.lost.sum() == 1


def test_ompl_is_not_asked_twice_for_a_bin_that_it_found_no_way_to(monkeypatch: pytest.MonkeyPatch) -> None:
    task, asked = task_of(door_arena(1.2), "dubins", START), list[Bools]()

    def in_vain(start: Floats, goals: Floats, **_: object) -> tuple[None, JoinCounts]:
        (bins, inside) = task.coverage.bins(goals)
        assert inside.all()
        asked.append(some(task, *(tuple(own) for own in bins.tolist())))
        return None, JoinCounts(failed=1)

    monkeypatch.setattr(repairs, "connect_car", in_vain)
    todo = some(task, (12, 6, 0), (12, 7, 8), (3, 6, 8), (6, 8, 4))
    repair = CarRepair(task, todo, START, gives_up)
    repair.run()
    assert len(asked) == 1
    assert (todo & ~asked[0]).sum() == 0
    assert repair.joins.by_wavefront >= 1
    assert missed(repair.drive.curve, todo, task.coverage, task.rate).sum() == repair.lost.sum() == 0


@pytest.mark.slow
def test_more_bins_are_driven_to_one_by_one_than_queries_may_be_in_vain() -> None:
    task = task_of(door_arena(9.0), "reeds_shepp", START)
    todo = np.zeros_like(task.coverage.reachable)
    todo[3:13:2, 3:9:2, ::4] = True  # too few near each other for a search, too far apart for one way
    repair = CarRepair(task, todo, START, gives_up)
    repair.run()
    assert len(repair.drive.curves) > 2 * MAX_IDLE_QUERIES
    assert missed(repair.drive.curve, todo, task.coverage, task.rate).sum() == repair.lost.sum() <= 2


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
def test_a_search_that_gives_up_goes_on_where_ompl_has_brought_the_car(drive: Drive) -> None:
    task = task_of(door_arena(1.2), drive, START)
    todo = np.zeros_like(task.coverage.reachable)
    todo[11:13, 5:7] = True

    def search(missing: Bools, here: Floats, seed: int) -> RoomDrive | None:
        """Give up before the wall, where a search sees no bin within its horizon."""
        narrow = SearchSettings(beam_width=30)
        if here[0] < 2.0:
            return None
        return search_floor(missing, task, here, seed, lambda left, seconds: True, narrow)

    repair = CarRepair(task, todo, START, search)
    repair.run()
    curve = repair.drive.curve
    assert repair.joins.direct + repair.joins.planned >= 1
    assert {"join", "drive"} == set(curve.labels.tolist())
    assert missed(curve, todo, task.coverage, task.rate).sum() == repair.lost.sum() <= 0.1 * todo.sum()
    assert check(curve.trajectory(100.0), task.arena, task.vehicle).count == 0


def test_a_robot_that_turns_in_place_goes_round_the_wall_and_turns_through_what_is_missing() -> None:
    """The cells beyond the wall have no straight way; the one by the start has."""
    task = task_of(door_arena(1.2), "diff", START)
    todo = some(task, (12, 1, 0), (12, 1, 5), (13, 1, 9), (3, 6, 8))
    made = StopAndSpinPlanner(task, todo).run()
    curve = made.curve
    assert made.lost is not None and not made.lost.any()
    assert not missed(curve, todo, task.coverage, task.rate).any()
    assert (made.joins.direct, made.joins.planned, made.joins.failed) == (2, 1, 0)
    assert made.joins.planned_m > np.hypot(2.0, 0.8)
    np.testing.assert_allclose(curve.poses[0], START)
    found = check(curve.trajectory(100.0), task.arena, task.vehicle)
    assert found.count == 0
    assert found.min_clearance > task.vehicle.footprint_radius


def test_turns_where_nothing_is_missing_are_not_made() -> None:
    """What the way to the first cell meets, and what it needs no more, is not driven to."""
    task = task_of(door_arena(9.0), "diff", START)
    here = (3, 3, 1)  # the bin that START lies in
    made = StopAndSpinPlanner(task, some(task, here)).run()
    assert made.curve.duration < 3.0


def test_what_lies_behind_a_closed_door_is_said_to_have_no_way() -> None:
    task = task_of(door_arena(0.3), "diff", START)
    todo = some(task, (12, 6, 0), (12, 7, 3), (3, 6, 8))
    made = StopAndSpinPlanner(task, todo).run()
    assert made.joins.failed > 0
    np.testing.assert_array_equal(made.lost, some(task, (12, 6, 0), (12, 7, 3)))


def test_where_no_way_leads_on_from_the_end_of_a_drive_one_leads_on_from_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = task_of(door_arena(1.2), "reeds_shepp", START)
    repair = CarRepair(task, some(task, (12, 6, 0)), START, gives_up)
    repair.run()
    end, driven, asked = repair.drive.here.copy(), repair.drive.curves[-1], list[Floats]()
    way = CarRepair._connect

    def not_from_the_end(self: CarRepair, start: Floats, goals: Floats, round_: int) -> CarPath | None:
        asked.append(start)
        return None if np.hypot(*(start - end)[:2]) < 0.3 else way(self, start, goals, round_)

    monkeypatch.setattr(CarRepair, "_connect", not_from_the_end)
    assert repair.drive_to(START)
    assert len(asked) > 1
    curve = repair.drive.curve
    np.testing.assert_allclose(curve.sample(np.array([curve.duration]))[0][0], START, atol=1e-6)
    assert repair.drive.curves[-2].duration < driven.duration
    assert check(curve.trajectory(100.0), task.arena, task.vehicle).count == 0


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
def test_two_rooms_become_one_drive(drive: Drive) -> None:
    vehicle = Vehicle(drive=drive, limits=Limits(turning_radius=0.3))
    made = plan(door_arena(1.2), vehicle, cell=0.5, headings=8)
    assert made.report["coverage"] > 0.99
    assert made.report["limit_violations"] == 0
