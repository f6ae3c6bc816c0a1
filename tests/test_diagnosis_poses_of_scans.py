"""Runs whose poses were found from their own scans: what these poses have taken along gets no name of its own."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scan_samples import ROOM_ROBOT, drive_in_room

from logs.run import Run
from logs.transforms import compose
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.engine.ledger import Ledger
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding, lines_of
from sensorgraph.diagnosis.motion.calibration.effects import effects_of
from sensorgraph.diagnosis.motion.calibration.estimate import (
    N_ALL,
    PARAMETERS,
    DrivingCalibration,
    WindowRows,
)
from sensorgraph.diagnosis.motion.regression import BoundedPrior
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.diagnosis.without_reference import located_in, with_described_mount, with_driving
from sensorgraph.effects import Amendment
from sensorgraph.effects.map_scale import MAP_SCALE
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.localization.locate import POSE_SOURCE
from sensorgraph.world.robot import parse_robot

ROBOT = parse_robot(ROOM_ROBOT)


def pulled(run: Run, ahead: float) -> Run:
    """Return a run as if it had been located, its poses pulled ahead [m] in the robot's own frame, with noise of location."""
    rng = np.random.default_rng(8)
    offset = np.array([ahead, 0.0, 0.0]) + rng.normal(size=run.poses.shape) * [0.004, 0.004, 0.002]
    return replace(run, poses=compose(run.poses, offset), meta={**run.meta, "pose_source": POSE_SOURCE})


@pytest.fixture(scope="module")
def biased(room: Arena) -> Finding:
    """Return what is said of a run with a bias that has pulled its poses."""
    return diagnose(pulled(drive_in_room(room, bias=0.025), 0.015), room, ROBOT, plan_next=False)


def test_the_ledger_of_located_poses_is_plain_data(biased: Finding) -> None:
    """Tolerances of located poses come from the scans, as numbers of numpy."""
    text = json.dumps(biased.ledger.to_list())
    assert Ledger.from_list(json.loads(text)) == biased.ledger


def test_poses_that_a_bias_has_pulled_make_no_mount(biased: Finding) -> None:
    assert [a.name for a in biased.effects] == ["range_bias"] and biased.unknown is None
    bias = biased.effects[0]
    assert abs(bias["b"] - 0.025) < 2 * bias.stderr["b"]
    assert biased.data.from_scans and biased.intake["poses_of_its_own_scans"]


def test_a_reference_that_is_off_like_that_has_a_mount(room: Arena) -> None:
    run = replace(pulled(drive_in_room(room), 0.015), meta={})
    finding = diagnose(run, room, ROBOT, plan_next=False)
    assert [a.name for a in finding.effects] == ["mount_xy"] and not finding.data.from_scans


def test_poses_far_off_their_scans_are_a_reference(room: Arena) -> None:
    """A laser that somebody moved after its run had been located, as the poses of a log and its scans may be joined later."""
    finding = diagnose(pulled(drive_in_room(room), 0.06), room, ROBOT, plan_next=False)
    assert [a.name for a in finding.effects] == ["mount_xy"] and not finding.data.from_scans


def test_the_mount_of_a_located_run_is_that_of_the_robot(room: Arena) -> None:
    """Scans locate the laser; where it sits on the base, robot.yaml says."""
    run = pulled(drive_in_room(room), 0.0)
    unmounted = replace(
        run,
        poses=compose(run.poses, np.broadcast_to(ROBOT.sensor.mount, run.poses.shape)),
        sensor=replace(run.sensor, mount=np.zeros(3)),
    )
    told = with_described_mount(unmounted, ROBOT)
    np.testing.assert_allclose(told.poses, run.poses, atol=1e-12)
    np.testing.assert_allclose(told.sensor.mount, ROBOT.sensor.mount)
    assert with_described_mount(replace(unmounted, meta={}), ROBOT).sensor.mount[0] == 0.0


def test_a_log_without_transforms_is_located_by_the_robots_mount(room: Arena) -> None:
    raw = drive_in_room(room)
    raw = replace(
        raw,
        pose_stamps=raw.pose_stamps[:0],
        poses=raw.poses[:0],
        sensor=replace(raw.sensor, mount=np.zeros(3)),
    )
    finding = diagnose(located_in(raw, room, ROBOT), room, ROBOT, plan_next=False)
    assert finding.effects == () and finding.unknown is None
    unseen = finding.channels["scan"].not_observable
    assert {"mount_xy", "mount_yaw", "latency"} <= set(unseen)
    said = " ".join(summarise(finding).details)
    assert "so that an error of the laser's mount or delay would not show" in said


# three metres: laser, map, wheels ------------------------------------------------------------------------------------


def driving(way: float, *, bias: float = 0.0, delay: float = 0.0) -> DrivingFinding:
    """Return what driving alone tells: by the laser's metre, ways are so many times the odometry's."""
    values = np.array([way, 1.0, bias, *ROBOT.sensor.mount, delay, 0.0, 0.0])
    none = np.zeros(N_ALL)
    prior = BoundedPrior(mean=none, sigma=none + 1.0, reach=none + np.inf)
    rows = WindowRows(
        A=np.zeros((0, 3, N_ALL)), y=np.zeros((0, 3)), at=values, prior=prior, from_s=none[:0], floors=none
    )
    found = DrivingCalibration(
        values=values, stderr=np.full(N_ALL, 5e-4), mount=np.asarray(ROBOT.sensor.mount), way_m=30.0,
        turn_rad=40.0, duration_s=100.0, rows=rows,
    )  # fmt: skip
    effects = effects_of(found, ROBOT.wheels.base)
    return DrivingFinding(runs={"run": found}, changes={"run": None}, differences=(), effects=effects)


def stretched(biased: Finding, effect: Amendment) -> Finding:
    """Return a finding that names a stretch alone."""
    named = replace(effect, stderr={"s": 5e-4}, evidence=900.0)
    scan = replace(biased.channels["scan"], effects=(named,))
    return replace(biased, channels={**biased.channels, "scan": scan})


@pytest.mark.parametrize("effect", [RANGE_SCALE(s=-0.009), MAP_SCALE(s=-0.009)], ids=["laser", "map"])
def test_of_laser_map_and_wheels_the_one_that_disagrees_is_wrong(biased: Finding, effect: Amendment) -> None:
    finding = stretched(biased, effect)
    of_laser = with_driving(finding, driving(1 - 0.0092), ROBOT)
    assert [a.name for a in of_laser.effects] == ["range_scale"] and of_laser.undecided == ()
    assert of_laser.driving is not None
    found = next(iter(of_laser.driving.runs.values()))
    way, error = found.of("way_scale")
    assert abs(way - 1) < 5e-4 and error > 5e-4 and "in the map's length scale" in lines_of(found)[0]
    assert not any(rival.name == "range_scale" for rival in of_laser.channels["scan"].rivals)
    of_map = with_driving(finding, driving(1.0001), ROBOT)
    names = [a.name for a in (*of_map.effects, *of_map.undecided)]
    assert names == [effect.name] and bool(of_map.undecided) == (effect.effect is RANGE_SCALE)


@pytest.mark.parametrize("wheels", [None, driving(1.02)], ids=["no odometry", "three metres differ"])
def test_a_stretch_that_nothing_decides_has_no_name(biased: Finding, wheels: DrivingFinding | None) -> None:
    told = with_driving(stretched(biased, RANGE_SCALE(s=-0.009)), wheels, ROBOT)
    assert [a.name for a in told.undecided] == ["range_scale"]
    assert [(r.name, r.instead_of) for r in told.channels["scan"].rivals][-1] == ("map_scale", "range_scale")
    assert "range_scale" not in {a.name for a in told.effects}


@pytest.mark.parametrize(
    ("wheels", "said"),
    [
        (driving(1.0, bias=-0.05), "The odometry misses a heading bias of −2.86"),
        (driving(1.0, delay=-0.05), "Scans are 50.00 ms ± 0.50 ms older than the odometry"),
        (driving(1.0), "Nothing material found."),
    ],
    ids=["unequal wheels", "late scans", "nothing"],
)
def test_what_driving_shows_without_an_effect_for_it_is_the_headline(
    biased: Finding, wheels: DrivingFinding, said: str
) -> None:
    """A delay may be of either clock, and unequal wheels have no size without the wheelbase."""
    nothing = {name: ChannelResult(channel=name) for name in biased.channels}
    told = summarise(replace(biased, channels=nothing, driving=wheels))
    assert told.headline.startswith(said)
    assert any(text.startswith("The scans agree") for text in told.details) == (
        not said.startswith("Nothing")
    )


def test_calibration_names_are_as_the_stand_in_has_them() -> None:
    assert PARAMETERS[0] == "way_scale" and len(PARAMETERS) + 3 == N_ALL
