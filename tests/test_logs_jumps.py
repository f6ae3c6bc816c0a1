"""Poses that jump by metres between scans are found, and nothing is built from them unless the user insists."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import further, polygon_arena

import logs
import sensorgraph as sg
from logs.jumps import find_jumps
from logs.run_warnings import warnings_of
from planners.arena import Arena
from sensorgraph.cli import run as command
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import check_jumps
from sensorgraph.world.raycast import cast


def test_a_jump_is_farther_than_the_robot_drives_in_the_time_between() -> None:
    stamps = np.arange(20) * 0.1
    poses = np.column_stack([0.05 * np.arange(20), np.zeros(20), np.zeros(20)])
    assert find_jumps(stamps, poses) is None
    lost = poses.copy()
    lost[7:, 1] += 3.0
    found = find_jumps(stamps, lost)
    assert found is not None
    assert (found.count, found.at) == (1, pytest.approx(0.7))
    assert found.farthest == pytest.approx(3.0, abs=1e-3)
    assert find_jumps(np.where(stamps < 0.65, stamps, stamps + 2.0), lost) is None, "3 m in 2 s can be driven"


def test_a_clock_of_whole_seconds_is_no_jump_and_no_clock_allows_two_metres() -> None:
    poses = np.column_stack([1.2 * np.arange(20), np.zeros(20), np.zeros(20)])
    assert find_jumps(np.floor(np.arange(20) / 2), poses) is None
    assert find_jumps(np.arange(20) * 0.1, poses, is_timed=False) is None
    assert find_jumps(np.arange(20) * 0.1, 2 * poses, is_timed=False) is not None


def test_repeated_stamps_of_a_coarse_clock_are_no_jumps_for_inspect(sensor: logs.RangeSensor) -> None:
    stamps, ranges = np.floor(np.arange(20) / 2), np.ones((20, sensor.n_rays))
    poses = np.column_stack([0.3 * np.arange(20), np.zeros(20), np.zeros(20)])
    run = logs.Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    assert "jumps" not in "\n".join(warnings_of(run))
    poses[7:, 1] += 6.0
    assert "the pose jumps 1 times, at most 6.01 m" in "\n".join(warnings_of(run))


def test_places_measured_one_by_one_are_taken_where_the_scans_fit_together(
    room: Arena, sensor: logs.RangeSensor
) -> None:
    """No drive, but true poses; the same poses in another order are garbage."""
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(0.3, 2.2, 200), rng.uniform(0.3, 2.7, 200), rng.uniform(-3, 3, 200)])
    stamps = np.arange(200) * 0.1
    ranges = cast(room, poses, sensor).ranges
    run = logs.Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    check_jumps(run, logs.pair(run), force=False)
    shuffled = replace(run, ranges=rng.permutation(ranges))
    with pytest.raises(SensorgraphError, match="the pose jumps"):
        check_jumps(shuffled, logs.pair(shuffled), force=False)
    check_jumps(shuffled, logs.pair(shuffled), force=True)


def drive_through_rooms(arena: Arena, sensor: logs.RangeSensor, *, every: int = 1) -> logs.Run:
    """Drive to and fro through the doors of three rooms for 60 s; keep each `every`-th scan."""
    stamps = np.arange(0.0, 60.0, 0.1)[::every]
    x = 6.0 - 4.8 * np.cos(2 * np.pi * stamps / 40.0)
    poses = np.column_stack([x, 2.0 + 0.2 * np.sin(stamps), 0.5 * np.sin(0.9 * stamps)])
    rng = np.random.default_rng(2)
    ranges = cast(arena, poses, sensor).ranges + 0.01 * rng.standard_normal((len(stamps), sensor.n_rays))
    return logs.Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


@pytest.fixture(scope="module")
def rooms() -> Arena:
    """Three rooms of different depth in a row, with doors between them."""
    walls = [
        [(3.9, -1.0), (4.0, -1.0), (4.0, 1.3), (3.9, 1.3)],
        [(3.9, 2.7), (4.0, 2.7), (4.0, 5.0), (3.9, 5.0)],
        [(7.9, 0.0), (8.0, 0.0), (8.0, 1.4), (7.9, 1.4)],
        [(7.9, 2.6), (8.0, 2.6), (8.0, 4.0), (7.9, 4.0)],
    ]
    return polygon_arena(
        [(0, -1), (4, -1), (4, 0), (12, 0), (12, 4), (8, 4), (8, 3.5), (4, 3.5), (4, 5), (0, 5)], *walls
    )


@pytest.fixture(scope="module")
def all_round() -> logs.RangeSensor:
    bearings = np.radians(np.arange(-135.0, 136.0, 3.0))
    return logs.RangeSensor(bearings=bearings, range_max=20.0)


def refusal(run: logs.Run) -> str:
    """Return the error of poses that jump; empty if they are accepted."""
    try:
        check_jumps(run, logs.pair(run), force=False)
    except SensorgraphError as exc:
        return str(exc)
    return ""


@pytest.mark.parametrize("every", [30, 60])
def test_a_scan_every_few_metres_is_no_jump_if_the_scans_agree(
    rooms: Arena, all_round: logs.RangeSensor, every: int
) -> None:
    run = drive_through_rooms(rooms, all_round, every=every)
    sparse = replace(run, meta={"clock": "assumed"}, poses=run.poses, stamps=0.1 * np.arange(run.n_scans))
    sparse = replace(sparse, pose_stamps=sparse.stamps)
    assert find_jumps(sparse.stamps, sparse.poses) is not None
    assert refusal(sparse) == ""
    assert "the pose jumps" in refusal(
        replace(sparse, ranges=np.random.default_rng(1).permutation(sparse.ranges))
    )


def test_stretches_may_be_left_out_of_a_log(rooms: Arena, all_round: logs.RangeSensor) -> None:
    run = drive_through_rooms(rooms, all_round)
    kept = np.r_[0:80, 160:300, 420:600]
    stamps = 0.1 * np.arange(len(kept))  # a log that was cut and joined
    cut = replace(run, stamps=stamps, pose_stamps=stamps, ranges=run.ranges[kept], poses=run.poses[kept])
    found = find_jumps(stamps, cut.poses)
    assert found is not None
    assert found.after.tolist() == [80, 220]
    assert refusal(cut) == ""


@pytest.mark.parametrize(
    ("n", "by"),
    [
        (300, (1.6, 0.0, 0.0)), (40, (0.0, 1.6, 0.0)), (4, (1.5, 1.5, 0.5)),
        *further(*((n, by) for n in (300, 40, 4) for by in ((1.6, 0.0, 0.0), (0.0, 1.6, 0.0), (1.5, 1.5, 0.5)))),
    ],
)  # fmt: skip
def test_a_lost_pose_is_refused_for_as_long_as_it_was_lost(
    rooms: Arena, all_round: logs.RangeSensor, n: int, by: tuple[float, float, float]
) -> None:
    run = drive_through_rooms(rooms, all_round)
    poses = run.poses.copy()
    poses[300 : 300 + n] += by
    said = refusal(replace(run, poses=poses))
    assert "the pose jumps" in said
    assert "of the points lie where scans beyond a jump saw through" in said


def test_a_few_people_beside_the_robot_during_a_part_of_the_log_are_no_wrong_poses(
    rooms: Arena, all_round: logs.RangeSensor
) -> None:
    run = drive_through_rooms(rooms, all_round)
    ranges = run.ranges.copy()
    ranges[160:300, ::6] = np.minimum(ranges[160:300, ::6], 0.9)
    kept = np.r_[0:80, 160:300, 420:600]
    stamps = 0.1 * np.arange(len(kept))
    cut = replace(run, stamps=stamps, pose_stamps=stamps, ranges=ranges[kept], poses=run.poses[kept])
    assert refusal(cut) == ""


@pytest.fixture(scope="module")
def lost(tmp_path_factory: pytest.TempPathFactory, room: Arena, sensor: logs.RangeSensor) -> Path:
    """Write a run whose poses jump by 1.6 m where localisation was lost."""
    rng = np.random.default_rng(3)
    stamps = np.arange(120) * 0.1
    poses = np.column_stack(
        [1.3 + 0.5 * np.sin(0.3 * stamps), 1.5 + 0.5 * np.cos(0.2 * stamps), np.zeros(120)]
    )
    ranges = cast(room, poses, sensor).ranges + 0.01 * rng.normal(size=(120, 61))
    said = poses.copy()
    said[60:, 0] += 1.6
    run = logs.Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=said)
    out = tmp_path_factory.mktemp("lost") / "lost.mcap"
    logs.write(run, out)
    good = replace(run, poses=poses)
    sg.build(good, model="polynomial", degree=1, harmonics=1, n_terms=4).save(
        out.with_name("good.sensorgraph")
    )
    return out


@pytest.mark.parametrize("name", ["build", "diagnose", *further("evaluate", "review")])
def test_a_command_refuses_jumps_in_one_line_and_force_overrules_it(
    name: str, lost: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    graph, out = str(lost.with_name("good.sensorgraph")), tmp_path / f"{name}.rrd"
    arguments = {
        "build": [
            "build",
            str(lost),
            "--model",
            "polynomial",
            "--degree",
            "1",
            "-o",
            str(tmp_path / "a.sensorgraph"),
        ],
        "evaluate": ["evaluate", graph, str(lost)],
        "review": ["review", str(lost), "-o", str(out)],
        "diagnose": ["diagnose", str(lost), "--arena", "square", "-o", str(tmp_path / "d")],
    }[name]
    assert command(arguments) == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if text.startswith("error")]
    assert "the pose jumps once between consecutive scans, at most 1.6 m at 6.00 s" in line
    assert "--force" in line
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    if name != "diagnose":  # the same argument, and slow
        assert command([*arguments, "--force"]) == 0
