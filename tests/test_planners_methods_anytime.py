"""The anytime order: every prefix shows much, a budget is a prefix, and the end is complete."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from conftest import further
from planners_samples import door_arena

from planners import Plan, PlanError, plan
from planners.methods import anytime, overview
from planners.types import Floats
from planners.vehicle import Limits, Vehicle

pytestmark = pytest.mark.usefixtures("narrow_search")

GRID = {"cell": 0.5, "headings": 8}
PLACES = np.mgrid[0:40, 0:30] * 0.1 + 0.05
"""(2, 40, 30) [m]"""


@dataclass
class DiscSurvey:
    """A sensor that sees all places within a radius; a place is of worth once."""

    radius: float = 0.8
    seen: set[tuple[int, int]] = field(default_factory=set)

    def _around(self, pose: Floats) -> set[tuple[int, int]]:
        near = np.hypot(PLACES[0] - pose[0], PLACES[1] - pose[1]) < self.radius
        return set(zip(*(part.tolist() for part in np.nonzero(near)), strict=True))

    def gain(self, poses: Floats) -> Floats:
        return np.array([float(len(self._around(pose) - self.seen)) for pose in poses])

    def mark(self, poses: Floats) -> None:
        for pose in poses:
            self.seen |= self._around(pose)

    def copy(self) -> DiscSurvey:
        return DiscSurvey(self.radius, set(self.seen))


def planned(order: str = "anytime", radius: float = 0.8, **given: object) -> Plan:
    survey = DiscSurvey(radius) if order == "anytime" else None
    return plan(door_arena(0.9), Vehicle(), order=order, survey=survey, seed=1, **GRID, **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def whole() -> Plan:
    return planned()


def test_an_anytime_plan_ends_complete_clear_and_within_limits(whole: Plan) -> None:
    assert whole.report["coverage"] == 1.0
    assert whole.report["limit_violations"] == 0
    assert whole.report["min_clearance_m"] > Vehicle().footprint_radius
    assert whole.report["order"] == "anytime"


@pytest.mark.slow
def test_a_budget_is_a_prefix_of_the_whole(whole: Plan) -> None:
    part = planned(budget=60.0)
    assert part.curve.duration <= 60.0 + 1e-6
    stamps = np.arange(0.0, part.curve.duration - 1.0, 0.1)  # but for the turn that brakes at its end
    np.testing.assert_allclose(part.curve.sample(stamps)[0], whole.curve.sample(stamps)[0], atol=1e-9)


def test_both_rooms_are_seen_before_one_is_finished(whole: Plan) -> None:
    """The order `fast` finishes one room of the two first."""

    def until_both(made: Plan) -> float:
        x = made.curve.log(10.0)[:, 0]
        return float(max((x < 1.5).argmax(), (x > 2.5).argmax())) / 10.0

    assert until_both(whole) < 45.0 < until_both(planned("fast"))


@pytest.mark.parametrize("width", [0.47, *further(0.5)])
def test_a_door_so_narrow_that_no_straight_way_between_cells_leads_through_is_no_wall(width: float) -> None:
    made = plan(
        door_arena(width), Vehicle(), order="anytime", survey=DiscSurvey(), seed=1, budget=120.0, **GRID
    )  # type: ignore[arg-type]
    x = made.curve.log(10.0)[:, 0]
    assert x.min() < 1.5 < 2.5 < x.max()


def test_without_a_survey_coarse_coverage_comes_first() -> None:
    made = plan(door_arena(9.0), Vehicle(), order="anytime", cell=0.25, headings=4)
    assert made.report["coverage"] == 1.0
    early = made.curve.log(10.0)[: int(10.0 * 45.0)]
    assert np.ptp(early[:, 0]) > 2.0  # two blocks of 3 m side by side in a room of 4 x 3 m


def test_an_interrupted_plan_keeps_what_it_has() -> None:
    ticks: list[int] = []

    def stop_at_the_second(done: int, total: int) -> None:
        ticks.append(done)
        if len(ticks) == 2:
            raise KeyboardInterrupt

    made = planned(progress=stop_at_the_second)
    assert made.report["interrupted"]
    assert 0.0 < made.report["coverage"] < 1.0
    assert made.report["limit_violations"] == 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"order": "slow"}, "order 'slow' is unknown"),
        ({"order": "anytime", "planner": "wall_following"}, "needs the planner coverage"),
        ({"order": "anytime", "vehicle": Vehicle(drive="dubins", limits=Limits(turning_radius=0.3))}, "order fast"),
        ({"order": "anytime", "priority": lambda grid: np.ones(grid.counts.shape)}, "a priority excludes the order"),
    ],
)  # fmt: skip
def test_what_has_no_order_is_refused(given: dict[str, object], said: str) -> None:
    vehicle = given.pop("vehicle", Vehicle())
    with pytest.raises(PlanError, match=said):
        plan(door_arena(9.0), vehicle, **GRID, **given)  # type: ignore[arg-type]


def test_rounds_of_spins_see_more_than_a_room_filled_as_long(monkeypatch: pytest.MonkeyPatch) -> None:
    def seen_until(spin_share: float, seconds: float) -> int:
        monkeypatch.setattr(anytime, "VIEW_SHARE", 0.02)
        monkeypatch.setattr(anytime, "SPIN_SHARE", spin_share)
        made, survey = planned(radius=0.3, budget=seconds), DiscSurvey(0.3)
        survey.mark(made.curve.log(10.0))
        return len(survey.seen)

    monkeypatch.setattr(overview, "FIRST_ROUND", 10.0)
    assert seen_until(0.5, 120.0) > 1.3 * seen_until(0.0, 120.0)


@pytest.mark.slow
def test_the_search_at_the_end_leaves_out_what_rounds_of_spins_have_completed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rounds cost their ways, not their whole length."""

    def made(spin_share: float) -> Plan:
        monkeypatch.setattr(anytime, "VIEW_SHARE", 0.02)
        monkeypatch.setattr(anytime, "SPIN_SHARE", spin_share)
        return planned(radius=0.3)

    without, share = made(0.0), 0.4
    assert made(share).curve.duration < without.curve.duration + 0.6 * share * without.report["t_ref_s"]
