"""The report of a run in which nothing is named: silent, with something unknown, or with a condition."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_samples import columns_of, with_scan
from scan_samples import ROOM_ROBOT, drive_in_room

from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report import comparison
from sensorgraph.diagnosis.report.files import save_report
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.diagnosis.result import ChannelResult, Deviation, Unknown
from sensorgraph.effects import EFFECTS, effects_file
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot


@pytest.fixture(scope="module")
def silent(room: Arena) -> Finding:
    return diagnose(drive_in_room(room), room, parse_robot(ROOM_ROBOT))


@pytest.fixture
def unknown(silent: Finding) -> Finding:
    deviation = Deviation(
        family="bias", partition="wall", label="w/edge_1", z=9.0, size=0.021, n_rays=812, xy=(4.0, 1.5)
    )
    doubt = Unknown(
        statement="something no effect of the library explains",
        deviation=deviation,
        statistic=9.0,
        threshold=4.0,
    )
    return with_scan(silent, unknown=doubt, deviations=(deviation,))


def test_a_mount_that_driving_tells_is_in_the_poses_and_amends_no_scan(silent: Finding) -> None:
    """The poses of a located run put the laser where it was; moved by its mount as well, it is off by that."""
    mount = EFFECTS["mount_xy"](dx=0.095, dy=0.006)
    odometry = replace(silent.channels["odometry"], effects=(mount,))
    compared = comparison.compare(replace(silent, channels={**silent.channels, "odometry": odometry}))
    assert compared is not None and not compared.is_amended


@pytest.mark.usefixtures("no_pictures")
def test_nothing_found_is_said(silent: Finding, tmp_path: Path) -> None:
    save_report(silent, tmp_path)
    assert summarise(silent).outcome == "nothing"
    assert "Nothing material found." in (tmp_path / "report.html").read_text()
    assert effects_file.read(tmp_path / "effects.yaml") == ()
    assert "/plan/amended" not in columns_of(tmp_path / "review.rrd")


@pytest.mark.usefixtures("no_pictures")
def test_a_reference_worse_than_stated_is_said_where_nothing_is_found(
    silent: Finding, room: Arena, tmp_path: Path
) -> None:
    """Poses off by twice their tolerance: they agree only if the tolerance is wrong, and the report says so."""
    run, rng = drive_in_room(room), np.random.default_rng(5)
    shaken = run.poses + rng.normal(size=run.poses.shape) * [0.005, 0.005, 0.0034]
    finding = diagnose(replace(run, poses=shaken), room, parse_robot(ROOM_ROBOT), plan_next=False)
    factor = finding.tolerance_factors["pose"]
    assert finding.effects == () and factor > 1.6
    said = " ".join(summarise(finding).details)
    assert f"only if the reference pose is {factor:.1f} times worse" in said
    assert "within the accuracy of a careful setup" not in said
    save_report(finding, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["pose_scale"] == pytest.approx(factor) and report["map_scale"] < 1.3
    page = (tmp_path / "report.html").read_text()
    assert f"only if the reference pose is {factor:.1f} times worse" in page
    assert "careful setup" in " ".join(summarise(silent).details)


@pytest.mark.slow
def test_the_same_finding_gives_the_same_bytes(silent: Finding, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_report(silent, tmp_path / name)
    for path in (tmp_path / "a").iterdir():
        if path.suffix != ".rrd":  # chunks of a recording carry ids
            assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


@pytest.mark.usefixtures("no_pictures")
def test_something_unknown_is_said_with_its_place(unknown: Finding, tmp_path: Path) -> None:
    what = summarise(unknown)
    assert what.outcome == "unknown"
    assert what.headline == "Something unknown at wall w/edge_1 about (4.0, 1.5) m."
    assert "2.1 cm too long" in what.details[0]
    save_report(unknown, tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["unknown"]["where"]["label"] == "w/edge_1"
    assert what.headline in (tmp_path / "report.html").read_text()


def test_a_doubt_of_the_motion_says_what_differs(unknown: Finding) -> None:
    scan = unknown.channels["scan"]
    assert scan.unknown is not None and scan.unknown.deviation is not None
    label = "by a loss of motion after a wheel reverses: play"
    told = replace(scan.unknown.deviation, channel="odometry", partition="reversal", label=label)
    said = replace(unknown, channels={"scan": replace(scan, unknown=replace(scan.unknown, deviation=told))})
    assert summarise(said).headline == f"Something unknown: odometry and reference pose differ {label}."


def test_what_another_channel_does_not_know_either_is_said_too(unknown: Finding) -> None:
    words = "odometry and reference pose differ by jumps, which no effect of the library explains; it is off by 1 cm"
    odometry = ChannelResult(channel="odometry", unknown=Unknown(statement=words))
    both = summarise(replace(unknown, channels={**unknown.channels, "odometry": odometry}))
    sentence = "Odometry and reference pose differ by jumps; it is off by 1 cm."
    assert both.headline == summarise(unknown).headline
    assert sentence in both.details and sentence not in summarise(unknown).details


def test_wide_tolerances_say_what_they_hide(room: Arena, silent: Finding) -> None:
    machine = parse_robot(ROOM_ROBOT)
    machine = replace(machine, tolerances=replace(machine.tolerances, mount_yaw=0.03))
    turned = replace(machine.sensor, mount=machine.sensor.mount + [0.0, 0.0, 0.03])
    run = drive_in_room(room)
    noise = 0.01 * np.random.default_rng(1).normal(size=run.ranges.shape)
    ranges = cast(room, run.poses, turned).ranges + noise
    hidden = diagnose(replace(run, ranges=ranges), room, machine, plan_next=False)
    assert "mount_yaw" not in [a.name for a in hidden.effects]
    said = r"wide \(mount_yaw\); they hide: .*mounting yaw of up to 4\.\d+° \(this run may have 1\.[67]\d*°\)"
    assert re.search(said, summarise(hidden).details[-1])
    # those of a careful set-up hide nothing
    assert not any("tolerances" in line for line in summarise(silent).details)


def test_skipped_channels_and_missing_parts_leave_a_report(silent: Finding, tmp_path: Path) -> None:
    channels = ("scan", "odometry", "drive")
    skipped = {name: ChannelResult(channel=name, skipped=f"no {name}") for name in channels}
    bare = replace(silent, channels=skipped, explained=None, goodness_of_fit=None, next_run=None)
    files = save_report(bare, tmp_path)
    assert {path.name for path in files} == {"report.json", "report.html", "effects.yaml"}
    html = (tmp_path / "report.html").read_text()
    assert "Nothing could be compared." in html
    assert "no drive" in html
    assert json.loads((tmp_path / "report.json").read_text())["gap"] is None
