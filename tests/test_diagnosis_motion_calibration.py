"""Wheels and mount from driving alone: what was planted is found within its standard errors, what was not is not."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scan_samples import ROOM_ROBOT, drive_in_room

import sensorgraph as sg
from logs.transforms import compose, invert
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.engine.ledger import Ledger
from sensorgraph.diagnosis.engine.verdict import Verdict
from sensorgraph.diagnosis.motion.calibration.comparison import Change, change_within, compare, is_long_enough
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding, change_lines, lines_of, verdict
from sensorgraph.diagnosis.motion.calibration.effects import effects_of
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration, calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import LaserMotion
from sensorgraph.diagnosis.report.files import save_driving, save_report
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.diagnosis.without_reference import driving_of, with_driving
from sensorgraph.effects import EFFECTS
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats
from sensorgraph.world.robot import parse_robot

MOUNT = np.array([0.12, -0.02, 0.05])
BASE = 0.4
EVERY = 5
"""Scans from one step to the next."""


def track_of(twists: Floats, dt: float) -> Floats:
    """Integrate (n, 2) [m/s, rad/s] along arcs; (n + 1, 3), phi unwrapped."""
    phi = np.concatenate([[0.0], np.cumsum(twists[:, 1] * dt)])
    middle = phi[:-1] + twists[:, 1] * dt / 2
    way = twists[:, 0] * dt
    x, y = np.cumsum(way * np.cos(middle)), np.cumsum(way * np.sin(middle))
    return np.column_stack([np.append(0.0, x), np.append(0.0, y), phi])


def drive(
    *,
    seed: int = 0,
    n: int = 4_000,
    radius: float = 1.0,
    turns: float = 1.0,
    later_turns: float = 1.0,
    bias: float = 0.0,
    delay: float = 0.0,
    mount: Floats | None = None,
    every: int = 30,
    slip: float = 0.02,
) -> LaserMotion:
    """Drive a differential robot with wheels that slip a little; the odometry says less than it does.

    Parameters
    ----------
    n : scans; twice as many where a claim needs the accuracy or the time of a long drive
    radius, turns : true way and turn per way and turn of the odometry
    later_turns : factor of `turns` in the second half
    bias : [rad/m] true turn that the odometry misses
    delay : [s] by which the odometry is ahead of the scans
    mount : (3,) as stated; None: in the middle of the axle, straight ahead
    every : scans after which the speed changes
    slip : standard deviation of the share of a step that slips
    """
    rng = np.random.default_rng(seed)
    dt = 0.1
    slow = np.repeat(rng.uniform([0.1, -1.0], [0.5, 1.0], (n // every + 1, 2)), every, axis=0)[:n]
    kernel = np.ones(10) / 10  # the robot does not jump to a speed
    said = np.column_stack([np.convolve(column, kernel, "same") for column in slow.T])
    slipping = 1 + slip * rng.standard_normal((n, 2))
    factor = turns * np.where(np.arange(n) < n // 2, 1.0, later_turns)
    true = np.column_stack([radius * said[:, 0], factor * said[:, 1] + bias * said[:, 0]]) * slipping
    odometry, body = track_of(said, dt), track_of(true, dt)
    stamps = dt * np.arange(n + 1)
    seen = np.column_stack([np.interp(stamps + delay, stamps, column) for column in body.T])
    laser = compose(seen, np.broadcast_to(MOUNT, seen.shape))
    keys = np.arange(0, n + 1, EVERY)
    noise = rng.standard_normal((len(keys), 3)) * [0.002, 0.002, 0.0005]
    laser = compose(laser[keys], noise)
    return LaserMotion(
        first=keys[:-1],
        second=keys[1:],
        steps=compose(invert(laser[:-1]), laser[1:]),
        headings=seen[keys[:-1], 2],
        stamps=stamps,
        odometry=odometry,
        mount=np.zeros(3) if mount is None else mount,
    )


@cache
def calibrated(**options: float) -> DrivingCalibration:
    """Return what `drive` with these options tells; of none: of untouched wheels."""
    return calibrate(drive(**options))  # type: ignore[arg-type]


@cache
def changed() -> tuple[DrivingCalibration, Change | None]:
    """Return what a drive tells whose turn scale changes half-way, and the change."""
    motion = drive(n=8_000, later_turns=1.04)
    found = calibrate(motion)
    return found, change_within(found)


def test_planted_wheels_mount_and_delay_are_found_within_their_standard_errors() -> None:
    found = calibrate(drive(n=8_000, radius=1.03, turns=0.97, bias=0.03, delay=-0.1))
    truth = np.array([1.03, 0.97, 0.03, *MOUNT, -0.1, 0.0, 0.0])
    off = np.abs(found.values - truth) / found.stderr
    assert off.max() < 3.0  # nine of them, two hold 95 % each
    assert (found.stderr[:3] < [0.003, 0.006, 0.006]).all()


def test_two_standard_errors_hold_95_percent() -> None:
    truth = np.array([1.0, 1.0, 0.0, *MOUNT])
    off = [
        np.abs(found.values[:6] - truth) / found.stderr[:6]
        for found in (calibrate(drive(seed=seed, n=2_000)) for seed in range(10, 18))
    ]
    assert np.mean(np.array(off) < 2.0) >= 0.86  # 48 of them: 95 % less three standard deviations of chance


def test_untouched_runs_agree() -> None:
    said = verdict(compare(calibrated(), calibrated(seed=1)), "one", "two")
    assert said[0].startswith("The two runs agree")


def test_a_turn_scale_that_differs_between_runs_is_told_with_its_size() -> None:
    differences = compare(calibrated(), calibrated(seed=1, turns=1.012))
    told = [d for d in differences if d.differs and d.is_material]
    assert [d.name for d in told] == ["turn_scale"]
    assert told[0].value == pytest.approx(0.012, abs=2 * told[0].stderr)
    assert "turn scale of two differs from that of one by +1." in verdict(differences, "one", "two")[1]


def test_a_turn_scale_that_changes_within_a_run_is_told_with_its_time() -> None:
    _, change = changed()
    assert change is not None and change.difference.name == "turn_scale"
    assert change.at_s == pytest.approx(400.0, abs=40.0)
    assert "changes during the run" in change_lines(change)[0]


def test_wheels_that_hold_do_not_change_within_a_run() -> None:
    found = calibrate(drive(seed=3))
    assert is_long_enough(found)
    assert change_within(found) is None


def test_effects_say_what_the_simulator_must_be_told() -> None:
    found = calibrate(drive(n=8_000, radius=1 / 1.03, turns=1.0, bias=0.03))
    sizes = {a.name: dict(a.parameters) for a in effects_of(found, BASE)}
    assert set(sizes) == {"wheel_radius", "wheel_base", "wheel_radius_diff", "mount_xy", "mount_yaw"}
    assert sizes["wheel_radius"]["s"] == pytest.approx(0.03, abs=0.004)
    assert sizes["wheel_base"]["s"] == pytest.approx(0.03, abs=0.008)
    assert sizes["wheel_radius_diff"]["s"] == pytest.approx(-0.012, abs=0.002)
    assert sizes["mount_xy"]["dx"] == pytest.approx(MOUNT[0], abs=0.005)
    assert "wheel_radius_diff" not in {a.name for a in effects_of(found, None)}


def test_a_delay_is_told_in_words() -> None:
    lines = "\n".join(lines_of(calibrate(drive(delay=-0.1))))
    found = re.search(r"scan delay: scans are ([0-9.]+) ms ± [0-9.]+ ms older than the odometry", lines)
    assert found and float(found[1]) == pytest.approx(100.0, abs=5.0)


def test_a_part_of_a_run_is_as_good_as_the_run() -> None:
    motion = drive(n=8_000)
    half = len(motion.first) // 2
    parts = [calibrate(motion.part(chosen)) for chosen in (slice(0, half), slice(half, None))]
    assert not any(d.differs and d.is_material for d in compare(*parts))
    assert set(PARAMETERS) == {d.name for d in compare(*parts)}


def test_other_stated_mounts_do_not_move_the_found_one() -> None:
    other = calibrate(replace(drive(), mount=np.array([0.2, 0.1, 0.0])))
    assert other.values[3:6] == pytest.approx(calibrated().values[3:6], abs=1e-4)


def test_a_robot_that_is_as_specified_is_known_as_well_as_another() -> None:
    """Its values hardly change from step to step, but the noise does, from its prior on."""
    as_specified, other = (calibrate(drive(slip=0.001, mount=mount)) for mount in (MOUNT, np.zeros(3)))
    np.testing.assert_allclose(as_specified.stderr, other.stderr, rtol=0.1)


def finding_of(**found: DrivingCalibration) -> DrivingFinding:
    """Return what runs tell."""
    first, *others = found.values()
    return DrivingFinding(
        runs=found,
        changes=dict.fromkeys(found),
        differences=compare(first, others[0]) if others else (),
        effects=effects_of(found[list(found)[-1]], BASE),
    )


def test_the_headline_is_a_sentence_and_says_what_is_not_as_stated() -> None:
    wrong = finding_of(run=calibrated()).lines
    assert re.fullmatch(r"Wheels and mount differ from the specified values: mount x \+1[12].*\.", wrong[0])
    assert "distance scale" not in wrong[0]
    right = finding_of(run=calibrate(drive(mount=MOUNT))).lines
    assert (
        right[0] == "Wheels and mount agree with the specified values, within the accuracy of driving alone."
    )
    assert right[1].startswith("run, from driving alone") and right[1].endswith(":")


def test_the_page_of_two_runs_stands_alone_and_sets_a_proper_minus(tmp_path: Path) -> None:
    later = replace(drive(seed=1, turns=1.03), mount=np.array([-0.04, 0.0, 0.0]))
    save_driving(finding_of(monday=calibrated(), friday=calibrate(later)), tmp_path / "out", {})
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<h1>The two runs differ.</h1>" in page and "specified: −4.0" in page
    words = re.sub("<style>.*?</style>|<[^>]*>", " ", page, flags=re.DOTALL)
    assert not re.search(r"(?<!\w)-\d", words)
    assert not re.search('src=(?!"data:)|href=', page)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [c["name"] for c in report["comparison"] if c["differs"]] == ["turn_scale"]
    assert report["summary"][0] == "The two runs differ."


@pytest.mark.usefixtures("no_pictures")
def test_in_a_known_place_driving_alone_stands_in_for_the_odometry_channel(
    room: Arena, tmp_path: Path
) -> None:
    shown = drive_in_room(room)
    some = replace(shown, stamps=shown.stamps[::2], ranges=shown.ranges[::2])
    finding = diagnose(some, room, parse_robot(ROOM_ROBOT), plan_next=False)
    robot = parse_robot(ROOM_ROBOT)
    assert with_driving(finding, None, robot) is finding
    told = with_driving(finding, finding_of(run=calibrated()), robot)
    assert "mount_xy" in {a.name for a in told.effects}
    (mount,) = (one for one in told.ledger.of("mount_xy") if one.verdict is Verdict.NAMED)
    assert mount.facts.evidence is not None and "its evidence is" in mount.reason
    save_report(told, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["calibration"][0]["parameters"]["mount_x"]["value"] == pytest.approx(MOUNT[0], abs=0.01)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h2>Wheels and mount from driving alone</h2>" in page


def test_a_reference_that_is_no_image_of_the_scans_is_left_to_the_odometry_channel(room: Arena) -> None:
    assert driving_of(drive_in_room(room), parse_robot(ROOM_ROBOT)) is None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "the run: the run has no odometry;.*; give an arena to diagnose the laser alone"),
        ({"second": "same"}, "the first run: the run has no odometry;"),
        ({"simulation": "same"}, "keeps no arena; give the arena in which it was recorded"),
        ({"commissioning": ["same"]}, "keeps no arena; give the arena in which it was recorded"),
    ],
)
def test_a_run_that_cannot_tell_its_wheels_gets_one_line(
    room: Arena, options: dict[str, Any], said: str
) -> None:
    run = drive_in_room(room)
    bare = replace(run, poses=run.poses[:0], pose_stamps=run.pose_stamps[:0])
    given = {k: [bare] if isinstance(v, list) else bare for k, v in options.items()}
    with pytest.raises(SensorgraphError, match=said) as caught:
        sg.diagnose(bare, **given)
    assert "\n" not in str(caught.value)


def test_wheels_of_a_located_run_that_driving_alone_cannot_tell_are_not_looked_at(room: Arena) -> None:
    """The odometry channel would compare them with poses that they have helped to find."""
    robot = parse_robot(ROOM_ROBOT)
    shown = drive_in_room(room)
    located = replace(shown, meta={"pose_source": "locate"})
    untold = driving_of(located, robot)
    assert isinstance(untold, str)
    assert "no odometry" in untold
    some = replace(shown, stamps=shown.stamps[::2], ranges=shown.ranges[::2])
    finding = diagnose(some, room, robot, plan_next=False)
    assert with_driving(finding, untold, robot).channels["odometry"] is finding.channels["odometry"]
    doubted = ChannelResult(
        channel="odometry", unknown=Unknown(statement="wheels and poses do not belong together")
    )
    looked = replace(finding, channels={**finding.channels, "odometry": doubted})
    told = with_driving(looked, "drive longer", robot)
    assert told.unknown is None
    assert not told.effects
    assert told.channels["odometry"].skipped.endswith("drive longer")


def alone(found: DrivingCalibration, change: Change | None = None) -> DrivingFinding:
    """Return the finding of one run."""
    return DrivingFinding(
        runs={"run": found},
        changes={"run": change},
        differences=(),
        effects=effects_of(found, BASE),
        base=BASE,
    )


def test_the_ledger_of_driving_alone_says_of_each_effect_what_decided() -> None:
    finding = alone(calibrate(drive(turns=1.03)))
    verdicts = {entry.name: entry.verdict for entry in finding.ledger}
    assert {name for name, one in verdicts.items() if one is Verdict.NAMED} == {
        a.name for a in finding.effects
    }
    assert "its evidence is" in finding.why("wheel_base") and "named" in finding.why("wheel base")
    assert "nats, but it needs" in finding.why("wheel_radius_diff")
    assert "without an arena" in finding.why("glass")
    assert "which of the two is late" in finding.why("latency")
    assert Ledger.from_list(finding.ledger.to_list()).names == finding.ledger.names
    with pytest.raises(SensorgraphError, match="did you mean glass"):
        finding.why("glas")


def test_a_change_during_the_drive_is_the_unknown_of_its_ledger() -> None:
    found, change = changed()
    (entry,) = (one for one in alone(found, change).ledger if one.verdict is Verdict.UNKNOWN)
    assert entry.name == "wheels_jump" and "turn scale" in entry.estimate
    short = alone(calibrate(drive(n=900))).ledger.of("wheels_jump")[0]
    assert "too short" in short.reason


def test_the_ledger_of_driving_alone_lists_each_effect_once_and_no_family_that_it_did_not_test() -> None:
    names = [entry.name for entry in alone(*changed()).ledger]
    assert sorted(names) == sorted([*EFFECTS, "wheels_jump"])
