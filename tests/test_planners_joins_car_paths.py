"""Cars in OMPL's own state spaces: shortest curves, ways round a wall, proven by the checker's own distances."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from planners_samples import door_arena

import planners.joins.ompl_car_paths as car_ways
from planners.arena import wrap
from planners.cars.arc_path import car_context, even_arc_path
from planners.cars.car_curve import arcs_of_curve
from planners.check import check
from planners.clearance import Barriers
from planners.curve import Curve
from planners.joins import ompl_paths, ompl_process
from planners.joins.car_paths import CarPath, connect_car
from planners.reach import Reach, reach
from planners.task import JoinCounts
from planners.types import Floats
from planners.vehicle import SHORTEST_ARC, Drive, Limits, Vehicle

CLEARANCE = 0.22
STARTS = np.array([[1.0, 1.0, 0.0], [1.0, 0.7, 0.0], [1.0, 2.0, 1.0]])
GOALS = [
    np.array([[1.4, 1.2, 0.5]]),
    np.array([[3.0, 0.7, 0.0], [3.2, 0.8, 1.0]]),
    np.array([[3.0, 2.4, 3.0]]),
]
"""Beside the start; two behind the wall, and one."""


def car(drive: Drive, radius: float = 0.4) -> Vehicle:
    return Vehicle(drive=drive, limits=Limits(turning_radius=radius))


def ends(curve: Curve) -> Floats:
    return curve.sample(np.array([0.0, curve.duration]))[0]


def connect_all(
    free: Reach, barriers: Barriers, vehicle: Vehicle, seed: int
) -> tuple[list[CarPath | None], JoinCounts]:
    """Join each start to its goals; return the paths, and their counts."""
    found = [
        connect_car(start, goals, reach=free, barriers=barriers, vehicle=vehicle, seed=seed)
        for start, goals in zip(STARTS, GOALS, strict=True)
    ]
    joins = JoinCounts()
    for _, count in found:
        joins += count
    return [way for way, _ in found], joins


@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
def test_a_wall_across_the_shortest_curve_makes_ompl_plan_a_car_round_it(drive: Drive) -> None:
    arena, vehicle = door_arena(1.2), car(drive)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=CLEARANCE, cell=0.25)
    ways, joins = connect_all(free, barriers, vehicle, seed=3)
    assert (joins.direct, joins.planned, joins.failed) == (1, 2, 0)
    for start, goals, way in zip(STARTS, GOALS, ways, strict=True):
        assert way is not None
        assert way.curve is not None
        first, last = ends(way.curve)
        np.testing.assert_allclose(first, start, atol=1e-12)
        np.testing.assert_allclose(last, goals[way.goal], atol=1e-6)  # arcs are read off to 1e-8, one by one
        found = check(way.curve.trajectory(100.0), arena, vehicle)
        assert found.count == 0
        assert found.min_clearance > vehicle.footprint_radius
    assert joins.planned_m >= 2 * np.hypot(2.0, 0.8)  # none goes through the wall beside the door


def test_without_a_wall_the_same_moves_are_the_shortest_curves() -> None:
    arena = door_arena(9.0)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=CLEARANCE, cell=0.25)
    _, joins = connect_all(free, barriers, car("reeds_shepp"), seed=3)
    assert (joins.direct, joins.planned, joins.failed, joins.planned_m) == (3, 0, 0, 0.0)


def test_what_no_way_leads_to_fails_and_is_counted() -> None:
    arena = door_arena(0.3)  # the robot is wider than the door
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=CLEARANCE, cell=0.25)
    way, joins = connect_car(
        STARTS[1], GOALS[1], reach=free, barriers=barriers, vehicle=car("reeds_shepp"), seed=0
    )
    assert way is None
    assert (joins.direct, joins.planned, joins.failed, joins.planned_m) == (0, 0, 1, 0.0)


@pytest.mark.slow  # OMPL cannot know that it searches in vain
def test_a_query_in_vain_ends_by_count() -> None:
    """A Dubins car in a corner, which it cannot leave forward; the disc could."""
    arena = door_arena(9.0)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=CLEARANCE, cell=0.25)
    corner = np.array([3.7, 2.7, 0.8])
    way, joins = connect_car(corner, GOALS[0], reach=free, barriers=barriers, vehicle=car("dubins"), seed=0)
    assert way is None
    assert joins.failed == 1


def test_of_many_goals_the_car_drives_to_one_that_it_can_reach() -> None:
    """GoalStates: one goal in a wall, one behind it, one in the open."""
    arena = door_arena(0.3)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=CLEARANCE, cell=0.25)
    goals = np.array([[0.1, 1.0, 0.0], [3.0, 1.5, 0.0], [0.6, 0.6, -2.0]])
    way, _ = connect_car(STARTS[0], goals, reach=free, barriers=barriers, vehicle=car("dubins", 0.25), seed=0)
    assert way is not None
    assert way.goal == 2


@pytest.mark.parametrize("seed", range(8))
def test_arcs_read_off_a_curve_lead_where_it_leads(seed: int) -> None:
    """In the open a car of any radius comes to the pose asked for, by no more arcs than a word has."""
    rng = np.random.default_rng(seed)
    arena = door_arena(9.0)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.05, cell=0.25)
    start, goal = (np.array([*rng.uniform(1.3, 1.7, 2), rng.uniform(-3, 3)]) for _ in range(2))
    vehicle = car("reeds_shepp", 0.2)
    way, joins = connect_car(start, goal[None], reach=free, barriers=barriers, vehicle=vehicle, seed=seed)
    assert joins.direct == 1
    assert way is not None
    assert way.curve is not None
    last = ends(way.curve)[1]
    assert abs(last[:2] - goal[:2]).max() < 1e-6
    assert abs(wrap(np.float64(last[2] - goal[2]))) < 1e-6
    parts = np.sign(np.round(way.curve.twists + 1e-3 * way.curve.rates, 9))
    assert (np.diff(parts, axis=0) != 0).any(axis=1).sum() <= 4  # Reeds and Shepp: five parts at most


@pytest.mark.parametrize("drive", ["reeds_shepp", "dubins"])
@pytest.mark.parametrize("aside", [1e-6, 1e-4, -1e-3])
def test_a_way_that_is_all_but_straight_does_not_twitch_its_wheel(drive: Drive, aside: float) -> None:
    """The shortest word to a goal a hair aside holds arcs of a hair; a wheel cannot turn there and back in a sample."""
    arena = door_arena(9.0)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.05, cell=0.25)
    start, goal = np.array([1.2, 1.5, 0.0]), np.array([2.8, 1.5 + aside, 0.0])
    vehicle = car(drive, 0.2)
    way, _ = connect_car(start, goal[None], reach=free, barriers=barriers, vehicle=vehicle, seed=0)
    assert way is not None
    assert way.curve is not None
    np.testing.assert_allclose(ends(way.curve)[1][:2], goal[:2], atol=1e-6)
    assert arcs_of_curve(way.curve).length.sum() < 1.6 + 4 * np.pi * 0.2 + 0.1  # at most two loops more
    whole, _ = even_arc_path(
        start, arcs_of_curve(way.curve), car_context(free, np.ones((*free.shape, 1), dtype=np.bool_), vehicle.limits, 0.2, 10.0,
        can_reverse=drive == "reeds_shepp"),
    )  # fmt: skip
    turns = np.diff(whole.bend) | np.diff(whole.gear)
    runs = np.add.reduceat(whole.length, np.append(0, np.flatnonzero(turns) + 1))
    assert runs.min() >= SHORTEST_ARC
    assert check(way.curve.trajectory(100.0), arena, vehicle).count == 0


@pytest.mark.slow
def test_same_seed_same_ways_whatever_the_process_did_before() -> None:
    script = (
        "import sys, hashlib; sys.path.insert(0, sys.argv[1]);"
        "from test_planners_joins_car_paths import *;"
        "a = door_arena(1.2); b = Barriers(a); f = reach(a, b, clearance=CLEARANCE, cell=0.25);"
        "n = int(sys.argv[2]);"
        "[connect_all(f, b, car('dubins'), seed=k) for k in range(n)];"
        "w, _ = connect_all(f, b, car('dubins'), seed=7);"
        "print(hashlib.sha256(b''.join(x.curve.poses.tobytes() for x in w)).hexdigest())"
    )
    here = str(Path(__file__).parent)
    answers = {
        subprocess.run([sys.executable, "-c", script, here, n], capture_output=True, check=True).stdout
        for n in ("0", "1")
    }
    assert len(answers) == 1


@pytest.mark.parametrize("module", [ompl_paths, car_ways])
def test_callbacks_of_ompl_hold_nothing_of_ompl_and_answer_with_a_bool(module: ModuleType) -> None:
    """A closure over a problem or a space leaks all it holds; a np.bool_ raises std::bad_cast."""
    calls = [
        ast.unparse(node.args[0])
        for node in ast.walk(ast.parse(Path(ompl_process.__file__).read_text()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "setStateValidityChecker"
    ]
    assert calls == ["partial(is_valid, self.field)"]
    assert module._is_valid.__closure__ is None
    field = ompl_process.DistanceField(np.full((3, 3), 0.5), np.zeros(2), 0.1)
    assert {type(value) for value in vars(field).values()} <= {list, tuple, float}

    class State(list[float]):
        """A state of the plane, and one of a car."""

        def getX(self) -> float:  # noqa: N802
            return self[0]

        def getY(self) -> float:  # noqa: N802
            return self[1]

    for clearance, expected in ((0.4, True), (0.6, False)):
        field.clearance = clearance
        assert module._is_valid(field, State([0.1, 0.1])) is expected
