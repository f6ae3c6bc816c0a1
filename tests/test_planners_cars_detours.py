"""Detours come by bins beside a drive, cost least, lose nothing, and never lead through walls."""

from __future__ import annotations

import numpy as np
import pytest
from planners_samples import door_arena, some, task_of

from planners.cars.car_curve import curve_of_arcs
from planners.check import check
from planners.curve import Curve
from planners.methods.repair_cars import CarRepair
from planners.search.log_phases import met, missed
from planners.task import Task
from planners.types import Bools
from planners.vehicle import Drive

START = np.array([0.5, 1.375, 0.0])
SPEED = 0.3


def straight(task: Task, length: float) -> Curve:
    return curve_of_arcs(START, np.array([length]), np.array([0]), np.array([1]), task.vehicle.limits, SPEED)


def repair_of(task: Task, todo: Bools, curve: Curve) -> CarRepair:
    repair = CarRepair(task, todo, START, lambda *_: None)
    repair.append_curve(curve)
    return repair


@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
@pytest.mark.slow
def test_a_bin_beside_the_drive_is_met_and_those_on_it_stay_met(drive: Drive) -> None:
    task = task_of(door_arena(9.0), drive, START)
    curve = straight(task, 2.8)
    on_it = met(curve, task.coverage, task.rate).all(axis=0)
    todo = on_it | some(task, (8, 8, 3), (5, 3, 12))
    repair = repair_of(task, todo, curve)
    assert repair.missing().sum() == 2
    repair.add_detours(SPEED)
    after = repair.drive.curve
    assert not missed(after, todo, task.coverage, task.rate).any()
    np.testing.assert_allclose(after.poses[0], START)
    ends = [own.sample(np.array([own.duration]))[0][0] for own in (curve, after)]
    np.testing.assert_allclose(ends[1][:2], ends[0][:2], atol=1e-9)
    assert check(after.trajectory(100.0), task.arena, task.vehicle).count == 0


def test_a_detour_costs_less_than_a_drive_to_the_bin_from_the_end() -> None:
    task = task_of(door_arena(9.0), "reeds_shepp", START)
    curve, todo = straight(task, 2.8), some(task, (4, 5, 4))  # beside where the drive begins
    by_detour, at_end = repair_of(task, todo, curve), repair_of(task, todo, curve)
    by_detour.add_detours(SPEED)
    at_end.run()
    for repair in (by_detour, at_end):
        assert not repair.missing().any()
        assert not repair.lost.any()
    assert by_detour.drive.curve.duration < at_end.drive.curve.duration


def test_what_lies_behind_a_wall_stays_missing() -> None:
    """In the other room, a hand's breadth from the wall along which the car drives."""
    task = task_of(door_arena(0.0), "reeds_shepp", START)
    curve, todo = straight(task, 1.0), np.zeros_like(task.coverage.reachable)
    todo[9, 5, 4] = True
    repair = repair_of(task, todo, curve)
    repair.add_detours(SPEED)
    assert repair.drive.curves == (curve,)
    assert repair.missing().sum() == 1


def test_what_was_lost_is_found_again_and_no_longer_lost() -> None:
    task = task_of(door_arena(9.0), "reeds_shepp", START)
    repair = repair_of(task, some(task, (6, 7, 5)), straight(task, 2.8))
    repair.lost[6, 7, 5] = True
    repair.add_detours(SPEED)
    assert not repair.lost.any()
    assert not repair.missing().any()
