"""What the scan channel takes from the run, and what it says to the other channels."""

from __future__ import annotations

from dataclasses import replace

import pytest
from conftest import further
from scan_samples import data_of, drive, hall_arena

from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.scan import naming
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit, told_by_tolerances
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.loading import robot_for
from sensorgraph.world.robot import parse_robot


@pytest.fixture(scope="module")
def null() -> Fitted:
    data = data_of(hall_arena())
    return fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())


@pytest.mark.parametrize(("stated", "height"), [("", 0.45), (", height: 0.2", 0.2)])
def test_height_of_the_laser_is_the_logs_unless_robot_yaml_says_it(stated: str, height: float) -> None:
    hall = hall_arena()
    run = drive(hall, n=60)
    run = replace(run, sensor=replace(run.sensor, height=0.45))
    data, _ = prepare_scans(run, hall, parse_robot(f"sensor: {{n_rays: 61{stated}}}"))
    assert data.sensor.height == height


@pytest.mark.parametrize("evidence", [100.0, *further(0.0)])
def test_a_mount_that_the_reference_may_be_is_neither_found_nor_within_tolerance(
    monkeypatch: pytest.MonkeyPatch, evidence: float
) -> None:
    monkeypatch.setattr(naming, "evidence_beside_wander", lambda fitted, a: evidence)
    hall = hall_arena()
    run = drive(hall, (EFFECTS["mount_xy"](dx=0.03, dy=0.0),))
    found = diagnose(run, hall, parse_robot("sensor: {n_rays: 61}"), plan_next=False).channels["scan"]
    assert [a.name for a in found.effects] == (["mount_xy"] if evidence > 12 else [])
    assert "mount_xy" not in [a.name for a in found.within_tolerance]
    assert ("drifts" in found.not_observable.get("mount_xy", "")) is (evidence < 12)


def test_without_a_robot_file_nothing_is_stated_and_the_height_is_the_logs() -> None:
    run = drive(hall_arena(), n=60)
    robot = robot_for(replace(run, sensor=replace(run.sensor, height=0.45)))
    assert robot.sensor.height == 0.45 and robot.stated == frozenset()


@pytest.mark.parametrize(
    ("scale", "has_effect", "is_told"),
    [(2.3, True, True), (1.8, True, False), (2.3, False, False), (3.4, False, True)],
)
def test_a_map_that_must_be_twice_as_wide_beside_an_effect_is_told(
    null: Fitted, scale: float, has_effect: bool, is_told: bool
) -> None:
    """The plan of a room that is longer along one side is a scale of the map to a part."""
    model = (EFFECTS["map_scale"](s=0.008, dx=0.0, dy=0.0),) if has_effect else ()
    state = replace(null.state, map_scale=scale)
    stretched = replace(null, model=model, solution=replace(null.solution, state=state))
    told = told_by_tolerances(stretched, GoodnessOfFit())
    assert (told is not None) == is_told
    if told is not None:
        assert told.told is not None
        assert f"the map would have to be {scale:.1f} times worse" in told.told.statement
