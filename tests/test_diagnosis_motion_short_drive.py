"""Wheels and mount from a drive of any length: the standard errors are as wide as the drive makes them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import polygon_arena
from scan_samples import drive_in_room
from test_diagnosis_motion_calibration import MOUNT, drive, finding_of

import sensorgraph as sg
from logs.run import Run
from logs.transforms import compose, invert
from planners.arena import Arena
from sensorgraph.diagnosis.motion.calibration.comparison import compare
from sensorgraph.diagnosis.motion.calibration.driving import headline, lines_of, verdict
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import LaserMotion, laser_motion
from sensorgraph.diagnosis.report.files import save_driving
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot


def short(n_steps: int, seed: int, **planted: float) -> LaserMotion:
    """Return the first steps of a drive that changes its speed every second."""
    motion = drive(seed=seed, n=2_000, every=12, **planted)
    return motion.part(slice(5, 5 + n_steps))


def with_odometry(run: Run, way: float, turn: float) -> Run:
    """Add an odometry whose distances and turns are too small by these factors."""
    steps = compose(invert(run.poses[:-1]), run.poses[1:])
    steps = np.column_stack([steps[:, :2] / way, ((steps[:, 2] + np.pi) % (2 * np.pi) - np.pi) / turn])
    track = [np.zeros(3)]
    for step in steps:
        track.append(compose(track[-1][None], step[None])[0])
    n = len(track)
    return replace(run, odom_stamps=run.stamps, odometry=np.array(track), odom_twists=np.zeros((n, 2)))


@pytest.mark.slow
@pytest.mark.parametrize("n_steps", [6, 15, 40, 76])
def test_two_standard_errors_cover_the_planted_errors_of_short_drives(n_steps: int) -> None:
    z = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        way, turn, bias = rng.uniform([0.85, 0.85, -0.03], [1.15, 1.15, 0.03])
        found = calibrate(short(n_steps, seed, radius=way, turns=turn, bias=bias, delay=0.05))
        z.append(np.abs(found.values[:6] - [way, turn, bias, *MOUNT]) / found.stderr[:6])
    assert np.mean(np.array(z) < 2.0) >= 0.89  # 96 of them: 95 % less 2.5 standard deviations of chance
    assert np.median(z) > 0.1  # they are no wider than needed


def test_more_steps_tell_the_wheels_more_accurately() -> None:
    errors = [calibrate(short(n, 3)).stderr[:3] for n in (8, 30, 76)]
    assert (np.diff(errors, axis=0) < 0).all()
    assert (errors[-1] < [0.004, 0.005, 0.005]).all()


def test_half_of_the_way_is_found_in_a_drive_of_30_steps() -> None:
    way, stderr = calibrate(short(30, 1, radius=2.0)).of("way_scale")
    assert stderr < 0.02
    assert way == pytest.approx(2.0, abs=2 * stderr)


def test_one_slip_does_not_move_the_scales_of_a_short_drive() -> None:
    motion = short(40, 2)
    slipped = motion.steps.copy()
    slipped[20, 0] -= 0.3
    before, after = calibrate(motion), calibrate(replace(motion, steps=slipped))
    assert after.of("way_scale")[0] == pytest.approx(before.of("way_scale")[0], abs=0.004)  # 0.3 m is 2.5 %


def straight(n_steps: int) -> LaserMotion:
    """Drive straight ahead."""
    rng = np.random.default_rng(0)
    keys = 5 * np.arange(n_steps + 1)
    odometry = np.zeros((keys[-1] + 1, 3))
    odometry[:, 0] = 0.08 * np.arange(len(odometry)) + 0.02 * np.sin(0.3 * np.arange(len(odometry)))
    laser = compose(odometry[keys], rng.standard_normal((len(keys), 3)) * [0.002, 0.002, 0.0005])
    return LaserMotion(
        first=keys[:-1],
        second=keys[1:],
        steps=compose(invert(laser[:-1]), laser[1:]),
        headings=np.zeros(n_steps),
        stamps=0.1 * np.arange(len(odometry)),
        odometry=odometry,
        mount=np.zeros(3),
    )


def test_what_a_straight_drive_does_not_show_is_in_the_table_with_its_reason() -> None:
    found = calibrate(straight(20))
    lines = lines_of(found)
    assert any(line.startswith("distance scale: ") and "±" in line for line in lines)
    for title in ("turn scale", "mount x", "mount y"):
        assert f"{title}: not observable, the robot turned by 0°" in lines
    assert any(line.startswith("mount angle: ") and "not observable" not in line for line in lines)
    assert "as far as the drive shows them; it does not show: turn scale" in headline(found, None)


def test_a_robot_that_stands_gets_a_table_and_no_error(tmp_path: Path) -> None:
    still = straight(4)
    still = replace(still.part(slice(0, 0)), odometry=np.zeros((50, 3)), stamps=0.1 * np.arange(50))
    finding = finding_of(run=calibrate(still))
    assert finding.lines[0] == "The drive does not show wheels and mount: the odometry never moves."
    assert not finding.effects
    save_driving(finding, tmp_path / "out", {})
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    parameters = report["calibration"][0]["parameters"]
    assert not any(parameters[name]["observable"] for name in PARAMETERS)
    assert report["not_observable"]["wheel_base"] == "turn scale: the odometry never moves"


def test_runs_are_compared_in_what_both_show() -> None:
    one, other = calibrate(drive(n=4_000)), calibrate(straight(20))
    differences = {d.name: d for d in compare(one, other)}
    assert differences["way_scale"].is_shown and not differences["turn_scale"].is_shown
    assert "as far as both show them" in verdict([*differences.values()], "one", "two")[0]
    still = calibrate(
        replace(straight(4).part(slice(0, 0)), odometry=np.zeros((9, 3)), stamps=np.arange(9.0))
    )
    assert verdict(compare(one, still), "one", "two")[0].startswith("The two runs cannot be compared")


def test_a_short_drive_is_too_short_to_show_a_change(room: Arena) -> None:
    finding = finding_of(run=calibrate(short(20, 0)))
    assert "The drive is too short to show a change during it." in finding.lines_of("run")


def along_the_corridor(walls: Arena) -> Run:
    """Drive 3 m along y = 1 m, with an odometry at each scan."""
    robot = parse_robot("sensor: {n_rays: 181, range_max: 4.0}")
    stamps = 0.2 * np.arange(60)
    poses = np.column_stack([15.0 + 0.05 * np.arange(60), np.full(60, 1.0), 0.1 * np.sin(stamps)])
    ranges = cast(walls, poses, robot.sensor).ranges
    ranges = ranges + 0.01 * np.random.default_rng(0).standard_normal(ranges.shape)
    run = Run(sensor=robot.sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    return with_odometry(run, 1.0, 1.0)


def sd_ahead(run: Run) -> Floats:
    motion = laser_motion(run, run)
    assert motion.scatter is not None
    return np.sqrt(motion.scatter[:, 0])


def test_steps_along_a_bare_corridor_have_a_large_covariance() -> None:
    bare = polygon_arena([(0, 0), (30, 0), (30, 2), (0, 2)])
    doors = [[(x, 0.0), (x + 0.9, 0.0), (x + 0.9, 0.3), (x, 0.3)] for x in np.arange(12.0, 22.0, 2.3)]
    furnished = polygon_arena([(0, 0), (30, 0), (30, 2), (0, 2)], *doors)
    seen = sd_ahead(along_the_corridor(furnished))
    run = along_the_corridor(bare)
    assert sd_ahead(run).min() > 3 * seen.max()
    found = calibrate(laser_motion(run, run))
    way, stderr = found.of("way_scale")
    assert stderr > 0.03  # a furnished one: 0.5 %
    assert abs(way - 1.0) < 2 * stderr


def test_a_run_with_reference_poses_but_without_an_arena_is_calibrated(room: Arena) -> None:
    finding = sg.diagnose(with_odometry(drive_in_room(room), 0.91, 0.85))
    assert isinstance(finding, sg.api.DrivingDiagnosis)
    (found,) = finding.runs.values()
    for name, planted in (("way_scale", 0.91), ("turn_scale", 0.85)):
        value, stderr = found.of(name)
        assert stderr < 0.03
        assert value == pytest.approx(planted, abs=2.5 * stderr)


def test_wheels_are_named_although_the_arena_is_in_another_frame(room: Arena) -> None:
    run = with_odometry(drive_in_room(room), 0.91, 0.85)
    c, s = np.cos(2.0), np.sin(2.0)
    corners = np.array([(0, 0), (4, 0), (4, 3), (0, 3)]) @ np.array([[c, s], [-s, c]]) + [20.0, -7.0]
    turned = polygon_arena([tuple(corner) for corner in corners.tolist()])
    finding = sg.diagnose(run, arena=turned)
    assert isinstance(finding, sg.api.Diagnosis)
    assert finding.unknown is not None and "does not fit" in finding.unknown.statement
    assert {"wheel_radius", "wheel_base"} <= {a.name for a in finding.effects}
