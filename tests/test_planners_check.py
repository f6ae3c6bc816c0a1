"""The checker finds what was planted, and only that."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from planners_samples import door_arena, shipped

from planners.check import check, check_parts
from planners.curve import CurveBuilder
from planners.trajectory import Trajectory
from planners.vehicle import Limits, Vehicle

ROBOT = Vehicle()


def clean() -> Trajectory:
    """Drive about the first room."""
    pen = CurveBuilder(np.array([0.5, 0.5, 0.0]), ROBOT.limits)
    for size in (1.0, 2.0, -0.5, 1.2):
        pen.move(0.8, overlap=0.5)
        pen.turn(size, overlap=0.5)
    return pen.curve().trajectory()


def changed(trajectory: Trajectory, **arrays: np.ndarray) -> Trajectory:
    parts = {name: getattr(trajectory, name) for name in ("stamps", "poses", "twists", "primitives")}
    return Trajectory(**(parts | arrays))


def test_a_clean_drive_has_no_violation() -> None:
    found = check(clean(), door_arena(0.9), ROBOT)
    assert found.count == 0
    assert found.min_clearance > 0.2


def at_middle(trajectory: Trajectory, column: int, add: float, field: str) -> Trajectory:
    array = getattr(trajectory, field).copy()
    array[len(array) // 2, column] += add
    return changed(trajectory, **{field: array})


@pytest.mark.parametrize(
    ("kind", "plant"),
    [
        ("v", lambda t: at_middle(t, 0, 0.5, "twists")),
        ("v", lambda t: at_middle(t, 0, -0.9, "twists")),
        ("omega", lambda t: at_middle(t, 1, 2.1, "twists")),
        ("a", lambda t: at_middle(t, 0, 0.02, "twists")),
        ("alpha", lambda t: at_middle(t, 1, 0.09, "twists")),
        ("continuity", lambda t: at_middle(t, 0, 0.002, "poses")),
        ("continuity", lambda t: at_middle(t, 1, 0.002, "poses")),
        ("continuity", lambda t: at_middle(t, 2, 0.01, "poses")),
    ],
)
def test_each_kind_of_violation_is_found(kind: str, plant: Callable[[Trajectory], Trajectory]) -> None:
    found = check(plant(clean()), door_arena(0.9), ROBOT)
    assert found.violations[kind] > 0
    assert found.violations["clearance"] == 0


def test_a_drive_too_near_a_wall_is_found_where_it_is_near() -> None:
    trajectory = clean()
    near = changed(trajectory, poses=trajectory.poses - [0.0, 0.31, 0.0])
    found = check(near, door_arena(0.9), ROBOT)
    assert found.violations["clearance"] > 0
    assert found.violations["continuity"] == 0
    assert found.min_clearance == pytest.approx(0.19, abs=1e-4)  # it drives along the wall in steps of 8 mm


@pytest.mark.parametrize(("room", "violated"), [(0.0001, False), (-0.0001, True)])
def test_a_drive_along_a_wall_may_use_all_the_room(room: float, violated: bool) -> None:
    pen = CurveBuilder(np.array([0.5, ROBOT.footprint_radius + room, 0.0]), ROBOT.limits)
    pen.move(0.8)
    found = check(pen.curve().trajectory(), door_arena(0.9), ROBOT)
    assert (found.violations["clearance"] > 0) == violated
    assert found.min_clearance == pytest.approx(ROBOT.footprint_radius + room, abs=1e-9)


def test_a_drive_through_a_wall_between_two_samples_is_found() -> None:
    """Samples are clear of the wall on either side; only the step between them crosses it."""
    trajectory = Trajectory(
        stamps=np.array([0.0, 2.0]),
        poses=np.array([[1.5, 0.5, 0.0], [2.5, 0.5, 0.0]]),
        twists=np.zeros((2, 2)),
        primitives=np.array(["move", "move"]),
    )
    assert check(trajectory, door_arena(0.9), ROBOT).violations["clearance"] > 0


def test_a_drive_outside_the_arena_has_no_clearance() -> None:
    trajectory = clean()
    outside = changed(trajectory, poses=trajectory.poses + [50.0, 0.0, 0.0])
    found = check(outside, door_arena(0.9), ROBOT)
    assert found.min_clearance == 0.0
    assert found.violations["clearance"] == len(trajectory.stamps)


def test_a_car_may_neither_spin_nor_turn_too_tightly() -> None:
    car = Vehicle(drive="reeds_shepp", limits=Limits(turning_radius=0.4))
    assert check(clean(), door_arena(0.9), car).violations["curvature"] > 0


def test_a_car_may_jump_from_one_arc_to_the_next_but_not_turn_faster_than_omega() -> None:
    """Curvature jumps are what Reeds-Shepp and Dubins curves are made of, so alpha is not asked of cars."""
    stamps = np.arange(0, 4.0, 0.02)
    omega = np.where(stamps < 2.0, 0.8, -0.8)
    phi = np.where(stamps < 2.0, 0.8 * stamps, 3.2 - 0.8 * stamps)
    way = np.where(stamps[:, None] < 2.0, np.stack([np.sin(phi), 1 - np.cos(phi)], axis=1), 0.0)
    turn = np.array([np.sin(1.6), 1 - np.cos(1.6)])
    back = np.stack([2 * np.sin(1.6) - np.sin(phi), np.cos(phi) - 2 * np.cos(1.6) + 1], axis=1)
    way = 0.4 * np.where(stamps[:, None] < 2.0, way, back)
    assert np.allclose(way[100], 0.4 * turn)
    trajectory = Trajectory(
        stamps=stamps,
        poses=np.column_stack([1.0 + way[:, 0], 1.0 + way[:, 1], phi]),
        twists=np.column_stack([np.full(len(stamps), 0.32), omega]),
        primitives=np.full(len(stamps), "drive"),
    )
    car = Vehicle(drive="dubins", limits=Limits(turning_radius=0.4))
    assert check(trajectory, door_arena(9.0), car).count == 0
    assert check(trajectory, door_arena(9.0), ROBOT).violations["alpha"] == 1
    slow = Vehicle(drive="dubins", limits=Limits(turning_radius=0.4, omega=0.7))
    assert check(trajectory, door_arena(9.0), slow).violations["omega"] == len(stamps)


def test_a_coarser_sampling_is_no_violation_by_itself() -> None:
    pen = CurveBuilder(np.array([0.5, 0.5, 0.0]), ROBOT.limits)
    for _ in range(5):
        pen.move(0.6, overlap=0.5)
        pen.turn(2.6, overlap=0.5)
    for rate in (20.0, 50.0, 100.0, 200.0):
        assert check(pen.curve().trajectory(rate), shipped("square"), ROBOT).violations["continuity"] == 0


@pytest.mark.parametrize("size", [7, 100, 10_000])
def test_in_parts_a_curve_is_sampled_and_checked_as_in_one(size: int) -> None:
    pen = CurveBuilder(np.array([0.5, 0.5, 0.0]), ROBOT.limits)
    for turn in (1.0, 2.0, -0.5, 1.2):
        pen.move(0.8, overlap=0.5)
        pen.turn(turn, overlap=0.5)
    curve, arena = pen.curve(), door_arena(0.9)
    whole, parts = curve.trajectory(100.0), list(curve.parts(100.0, size))
    for name in ("stamps", "poses", "twists", "primitives"):
        pieces = [getattr(part, name)[int(k > 0) :] for k, part in enumerate(parts)]
        np.testing.assert_array_equal(np.concatenate(pieces), getattr(whole, name))
    found, there = check_parts(parts, arena, ROBOT), check(whole, arena, ROBOT)
    assert found.violations == there.violations
    assert found.min_clearance == pytest.approx(there.min_clearance, abs=1e-12)


def test_in_parts_what_was_planted_is_found_once_or_twice() -> None:
    """Twice where two parts meet."""
    bad = at_middle(clean(), 0, 0.002, "poses")
    at = len(bad.stamps) // 2
    for cut in (at - 1, at, at + 1):
        first, second = (
            changed(bad, **{n: getattr(bad, n)[s] for n in ("stamps", "poses", "twists", "primitives")})
            for s in (slice(0, cut + 1), slice(cut, None))
        )
        one, two = (
            found.violations["continuity"]
            for found in (
                check(bad, door_arena(0.9), ROBOT),
                check_parts([first, second], door_arena(0.9), ROBOT),
            )
        )
        assert one == two > 0
