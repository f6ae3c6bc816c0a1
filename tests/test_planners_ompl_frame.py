"""A plan is a path of OMPL's: from its start, in its state space, through its checks, at the cost of its driving time."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from conftest import further
from planners_samples import door_arena

import planners.ompl_frame
from planners import PLANNERS, Plan, PlanError, plan
from planners.clearance import Barriers
from planners.task import PlannedDrive, Task
from planners.types import Floats
from planners.vehicle import Limits, Vehicle

pytestmark = pytest.mark.usefixtures("narrow_search")

ARENA = door_arena(0.9)
START = np.array([0.8, 0.8, 0.3])


def vehicle_of(drive: str) -> Vehicle:
    return Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.3))  # type: ignore[arg-type]


def setup_of(made: Plan, vehicle: Vehicle) -> tuple[object, object]:
    """Return OMPL's setup for a plan's floor, and the plan's drive as its path."""
    frame = planners.ompl_frame
    setup = frame.setup_of(ARENA.bounds, frame.FloorChecks.of(made.reach, Barriers(ARENA), vehicle))
    return setup, frame.path_of(setup.getSpaceInformation(), made.curve)


@pytest.mark.parametrize("drive", ["diff", "reeds_shepp", *further("dubins")])
def test_a_plan_passes_ompls_own_check_and_costs_its_driving_time(drive: str) -> None:
    vehicle = vehicle_of(drive)
    made = plan(ARENA, vehicle, cell=0.5, headings=4, start=START if drive == "diff" else None)
    setup, path = setup_of(made, vehicle)
    assert path.check()  # type: ignore[attr-defined]
    cost = path.cost(planners.ompl_frame.DrivingTime(setup.getSpaceInformation(), vehicle)).value()  # type: ignore[attr-defined]
    assert cost <= made.curve.duration + 1e-6
    if drive == "diff":  # what is left is starting and stopping
        assert cost > 0.95 * made.curve.duration
        first = planners.ompl_frame.pose_of(path.getState(0))  # type: ignore[attr-defined]
        np.testing.assert_allclose(first, START, atol=1e-9)


@pytest.mark.parametrize("drive", ["diff", "dubins"])
@pytest.mark.parametrize(
    ("places", "is_free"),
    [
        ([[0.5, 1.5], [1.5, 1.5]], True),
        ([[1.0, 0.5], [3.0, 0.5]], False),  # through the wall beside the door
        ([[0.5, 1.5], [0.1, 1.5]], False),  # into the outer wall
        ([[0.5, 1.5], [-1.0, 1.5]], False),  # off the floor
    ],
)
def test_ompl_refuses_motions_through_walls(drive: str, places: list[list[float]], is_free: bool) -> None:
    vehicle = vehicle_of(drive)
    task_reach = planners.planning.reach(ARENA, Barriers(ARENA), clearance=0.22, cell=0.25)
    frame = planners.ompl_frame
    setup = frame.setup_of(ARENA.bounds, frame.FloorChecks.of(task_reach, Barriers(ARENA), vehicle))
    information = setup.getSpaceInformation()
    heading = float(np.arctan2(*(np.subtract(places[1], places[0])[::-1])))
    a, b = (frame.state_of(information.getStateSpace(), np.array([*place, heading])) for place in places)
    assert information.checkMotion(a, b) is is_free


def test_plan_lets_ompl_run_the_planner_and_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[weakref.ref[Task]] = []
    solved = planners.ompl_frame.TaskPlanner.solve

    def spy(self: object, condition: object) -> object:
        seen.append(weakref.ref(self.task))  # type: ignore[attr-defined]
        return solved(self, condition)

    monkeypatch.setattr(planners.ompl_frame.TaskPlanner, "solve", spy)
    plan(ARENA, Vehicle(), cell=0.5, headings=4, planner="stop_and_spin")
    gc.collect()
    assert [one() for one in seen] == [None]


@pytest.mark.parametrize("kind", [PlanError, KeyboardInterrupt, ZeroDivisionError])
def test_what_a_planner_raises_comes_through_ompl(
    kind: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: Task) -> PlannedDrive:
        raise kind

    monkeypatch.setitem(PLANNERS, "stop_and_spin", fails)
    with pytest.raises(kind):
        plan(ARENA, Vehicle(), cell=0.5, headings=4, planner="stop_and_spin")


def test_distances_that_the_raster_proves_are_never_too_long() -> None:
    barriers = Barriers(ARENA)
    floor = planners.planning.reach(ARENA, barriers, clearance=0.22, cell=0.25)
    checks = planners.ompl_frame.FloorChecks.of(floor, barriers, Vehicle())
    places: Floats = np.random.default_rng(3).uniform([0, 0], [4, 3], (2000, 2))
    proven = np.array([checks.distance_bound(x, y) for x, y in places.tolist()])
    assert (proven <= barriers.distances(places) + 1e-9).all()
    assert (proven > 0.2).mean() > 0.3
