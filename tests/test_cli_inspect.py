"""`sensorgraph inspect`: everything worth knowing of a file is said, also of one that is no run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs_samples import DATA, some_run
from test_logs_formats_rosbag import odometry, pose, scan, transform, trip, write_bag2

import logs
from logs import Run
from logs.expectations import deviations, expected_topics
from logs.inspection import inspect
from sensorgraph.cli import run as command


def changed(run: Run, **fields: object) -> Run:
    return Run(**{name: getattr(run, name) for name in run.__dataclass_fields__} | fields)


def warnings_of(run: Run, tmp_path: Path) -> str:
    logs.write(run, tmp_path / "run.mcap")
    return "\n".join(inspect(tmp_path / "run.mcap").warnings)


def test_our_file_is_described_without_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = some_run(100)
    poses, odometry = np.zeros_like(run.poses), np.zeros_like(run.odometry)
    poses[:, 0], odometry[:, 0] = 0.2 * run.pose_stamps, 0.2 * run.odom_stamps
    logs.write(changed(run, poses=poses, odometry=odometry), tmp_path / "run.mcap")
    assert command(["inspect", str(tmp_path / "run.mcap"), "--json", str(tmp_path / "found.json")]) == 0
    said = capsys.readouterr().out
    for words in (
        "/scan", "10.00 Hz", "sensor_msgs/msg/LaserScan  in laser", "30.00 Hz", "base_link -> laser (static)",
        "map -> odom (100 samples)", "100 scans of 19 rays from -85.9° to 97.4°, 0.05 to 8 m", "scene.geojson (29 bytes)",
        "laser at (0.100, -0.020) m, 1.7° in base_link", "100 of 100 scans paired with poses",
    ):  # fmt: skip
        assert words in said, said
    assert "warnings" not in said and "missing" not in said
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["is_run"] and {t["name"]: t["n_messages"] for t in found["topics"]}["/scan"] == 100


def test_the_rate_of_a_topic_counts_what_was_lost_and_what_came_in_bursts(tmp_path: Path) -> None:
    run = some_run(300)
    kept = np.arange(run.n_scans) % 3 > 0
    logs.write(run, tmp_path / "good.mcap")
    logs.write(run.take_scans(kept), tmp_path / "lost.mcap")
    good, lost = (inspect(tmp_path / f"{name}.mcap") for name in ("good", "lost"))
    rates = {topic.name: topic.rate for topic in lost.topics}
    assert rates["/scan"] == pytest.approx(2 / 3 * 10, rel=0.01)
    said = [one.text for one in deviations(lost, expected_topics([good]))]
    assert "/scan has 6.67 Hz, expected 9 Hz" in said

    pairs = np.sort(np.r_[run.cmd_stamps[::2], run.cmd_stamps[::2] + 0.001])
    commands = np.zeros((len(pairs), 2))
    logs.write(changed(run, cmd_stamps=pairs, commands=commands), tmp_path / "burst.mcap")
    rates = {topic.name: topic.rate for topic in inspect(tmp_path / "burst.mcap").topics}
    assert rates["/cmd_vel"] == pytest.approx(1 / np.mean(np.diff(run.cmd_stamps)), rel=0.01)


def test_file_that_is_no_run_is_still_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag2(tmp_path / "bag", [odometry(0, 0, 0, 0), odometry(0.5, 1, 0, 0)])
    assert command(["inspect", str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    assert "no LaserScan" in said and "/odom" in said and "2.00 Hz" in said


def test_choice_of_topics_is_offered_and_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = [scan(0, [1, 2], topic="/front/scan"), scan(0, [3, 4], topic="/rear/scan"), pose(0, 0, 0, 0)]
    write_bag2(tmp_path / "bag", bag)
    assert command(["inspect", str(tmp_path / "bag")]) == 0
    assert "--topic scan=/front/scan, --topic scan=/rear/scan" in capsys.readouterr().out
    assert command(["inspect", str(tmp_path / "bag"), "--topic", "scan=/rear/scan"]) == 0
    assert "1 of 1 scans paired" in capsys.readouterr().out
    for wrong in ("scan", "scan=/side", "lidar=/rear/scan"):
        assert command(["inspect", str(tmp_path / "bag"), "--topic", wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_missing_signals_are_named(tmp_path: Path) -> None:
    write_bag2(tmp_path / "bag", [scan(0.1 * i, [1, 2, 3]) for i in range(3)])
    found = inspect(tmp_path / "bag")
    for words in (
        "reference poses (/pose, or /tf map -> base_link)",
        "odometry (/odom, or /tf odom -> base_link)",
        "commands (/cmd_vel)",
    ):
        assert any(words in line for line in found.missing)
    assert found.pairing == "0 of 3 scans paired with poses, 3 without any pose"


def test_dropped_scans_are_counted_with_the_reason(tmp_path: Path) -> None:
    run = some_run(40)
    keep = (
        (run.pose_stamps > 0.5) & ~((run.pose_stamps > 2) & (run.pose_stamps < 3)) & (run.pose_stamps < 3.5)
    )
    logs.write(changed(run, pose_stamps=run.pose_stamps[keep], poses=run.poses[keep]), tmp_path / "run.mcap")
    found = inspect(tmp_path / "run.mcap")
    assert found.pairing == (
        "19 of 40 scans paired with poses, 5 before the first pose, 5 after the last pose, "
        "10 in a gap of the poses above 0.2 s, 1 sweeping beyond the poses"
    )


def test_what_looks_wrong_is_said(tmp_path: Path) -> None:
    run = some_run(60)
    still = np.tile([1.0, 2.0, 0.5], (len(run.poses), 1))
    jumping = still.copy()
    jumping[90:, 0] += 3.0
    jumping[:, 1] += 0.001 * np.arange(len(jumping))
    blind = run.ranges.copy()
    blind[:, [3, 4, 9]] = np.inf
    gap = np.where(np.arange(60) < 30, run.stamps, run.stamps + 4.0)
    for case, words in (
        (changed(run, poses=still), "the pose never changes"),
        (changed(run, poses=jumping), "the pose jumps 1 times, at most 3.00 m"),
        (changed(run, ranges=blind), "3 rays never return: 3-4, 9"),
        (changed(run, ranges=run.ranges * 1000), "looks like millimetres"),
        (changed(run, ranges=run.ranges * 100), "looks like centimetres"),
        (changed(run, stamps=gap), "scan: 1 gaps, the longest 4.10 s"),
        (changed(run, stamps=1000 * run.stamps), "a scan every 100 s: check that the stamps are in seconds"),
        (changed(run, stamps=run.stamps + 100), "do not overlap in time, they are 94.0 s apart"),
        (changed(run, meta={"pose_source": "slam"}), "estimated from these scans"),
        (changed(run, meta={"pose_source": "odometry /odom"}), "which drifts and distorts a map"),
    ):
        assert words in warnings_of(case, tmp_path), words


def test_two_clocks_are_noticed(tmp_path: Path) -> None:
    bag = [scan(0.1 * i, [1, 2, 3], log=0.1 * i + 2.5) for i in range(5)]
    write_bag2(tmp_path / "bag", bag)
    note = "the log times are 2.500 s after the header stamps: the header stamps were used"
    assert inspect(tmp_path / "bag").warnings[0] == note
    write_bag2(tmp_path / "other", [odometry(t, t, 0, 0, log=t + 2.5) for t in (0.0, 0.1)])
    assert inspect(tmp_path / "other").warnings == (
        "the log times are 2.500 s after the header stamps of /odom",
    )


def test_mount_that_is_missing_or_tilted_is_said(tmp_path: Path) -> None:
    write_bag2(tmp_path / "bare", [scan(0, [1, 2])])
    assert any("no transform base_link -> laser" in line for line in inspect(tmp_path / "bare").warnings)
    tilted = transform(0, "base_link", "laser", 0, 0, 0, roll=0.5, static=True)
    write_bag2(tmp_path / "tilted", [tilted, scan(0, [1, 2])])
    assert any("tilted by 29°" in line for line in inspect(tmp_path / "tilted").warnings)


def test_run_is_handed_on_for_checks_that_need_more_than_the_file(tmp_path: Path) -> None:
    write_bag2(tmp_path / "bag", trip())
    found = inspect(tmp_path / "bag")
    assert found.run is not None and found.run.n_scans == 10
    more = replace(found, warnings=(*found.warnings, "mirrored"))
    assert "  mirrored" in more.lines()


def test_corrected_carmen_log_says_that_its_poses_are_the_lasers() -> None:
    path = DATA / "ple-intel" / "intel-corrected.log.gz"
    if not path.is_file():
        pytest.skip("the research data set ple-intel is not beside the project")
    said = "\n".join(inspect(path).lines())
    for words in (
        "910 poses of laser from slam",
        "absorb errors of the mount and the clock",
        "910 of 910 scans paired",
    ):
        assert words in said
