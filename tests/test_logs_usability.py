"""The table of what a log can be used for: each verdict follows from what was planted in the drive."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs_samples import some_run
from rosbag_samples import odometry, scan, write_bag2

import logs
from logs import Run
from logs.inspection import inspect
from logs.usability import NAMES, advice, ground_of, uses_of
from sensorgraph.cli import run as cli

T = np.arange(601) / 10


def driven(legs: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Integrate legs of (duration, v, omega) to poses (601, 3) at `T`; afterwards the robot stands."""
    ends = np.cumsum([leg[0] for leg in legs])
    which = np.searchsorted(ends, T[1:], side="left")
    twists = np.array([[leg[1], leg[2]] for leg in legs] + [[0.0, 0.0]])[which]
    phi = np.concatenate([[0.0], np.cumsum(0.1 * twists[:, 1])])
    step = 0.1 * twists[:, :1] * np.column_stack([np.cos(phi[1:]), np.sin(phi[1:])])
    return np.column_stack([np.vstack([[0.0, 0.0], np.cumsum(step, axis=0)]), phi])


def run_of(drive: np.ndarray, **changes: object) -> Run:
    base = some_run(len(T))
    fields: dict[str, object] = {
        "ranges": np.full(base.ranges.shape, 2.0), "stamps": T, "odom_stamps": T, "odometry": drive,
        "odom_twists": np.zeros((len(T), 2)), "pose_stamps": np.zeros(0), "poses": np.zeros((0, 3)),
        "cmd_stamps": T, "commands": np.column_stack([np.round(np.sin(T)), np.zeros(len(T))]), "meta": {},
    }  # fmt: skip
    return replace(base, **{**fields, **changes})  # type: ignore[arg-type]


STRAIGHT = driven([(20, 0.5, 0.0)])
LOOPS = driven([(20, 0.5, 0.5), (20, 0.5, -0.5)])
REFERENCE = {"pose_stamps": T, "poses": LOOPS, "meta": {"pose_source": "/pose"}}
NONE = {"odom_stamps": T[:0], "odometry": LOOPS[:0], "odom_twists": np.zeros((0, 2))}
NO_COMMANDS = {"cmd_stamps": T[:0], "commands": np.zeros((0, 2))}


@pytest.mark.parametrize(
    ("legs", "distance", "left", "right", "revisits"),
    [
        ([(20, 0.5, 0.0)], 10, 0, 0, False),
        ([(20, 0.5, 0.5)], 10, 10, 0, True),
        ([(10, 0.5, 0.3), (20, 0.2, -0.1)], 9, 3, 2, False),
        ([(10, 0.5, 0), (10, -0.5, 0)], 10, 0, 0, True),
        ([(20, 0.0, 1.0)], 0, 20, 0, False),
        ([], 0, 0, 0, False),
    ],
)
def test_ground_is_the_length_of_the_path_and_the_sum_of_its_turns(
    legs: list[tuple[float, float, float]], distance: float, left: float, right: float, revisits: bool
) -> None:
    noise = np.random.default_rng(0).normal(
        scale=1e-3, size=(len(T), 3)
    )  # adds up to metres without a dead band
    for poses in (driven(legs), driven(legs) + noise):
        ground = ground_of(run_of(poses))
        assert ground is not None
        assert ground.distance == pytest.approx(distance, abs=0.3)
        assert (ground.left, ground.right) == pytest.approx((left, right), abs=0.3)
        assert ground.revisits == revisits
        assert ground.to_dict()["minutes"] == pytest.approx(1.0)


def test_ground_without_scans_is_not_counted() -> None:
    run = run_of(LOOPS).take_scans(T <= 4.0)  # 40 s of odometry
    ground = ground_of(run)
    assert ground is not None
    assert (ground.distance, ground.left, ground.right) == pytest.approx((2.0, 2.0, 0.0), abs=0.1)
    assert ground.duration == pytest.approx(4.0)
    assert {use.name: use.verdict for use in uses_of(run, ground)}["diagnose wheels"] == "limited"
    before = replace(run_of(LOOPS), odom_stamps=T + 100.0)
    assert (nothing := ground_of(before)) is not None and nothing.distance == 0.0
    assert "hardly moves" in advice(before, nothing)


def test_numbers_that_overflow_are_no_number_in_json() -> None:
    with np.errstate(over="ignore"):
        ground = ground_of(run_of(LOOPS * 1e307))
    assert ground is not None and ground.to_dict()["distance_m"] is None


@pytest.mark.parametrize(
    ("run", "verdicts"),
    [
        (run_of(LOOPS), "yes limited limited yes yes"),
        (run_of(LOOPS, **REFERENCE), "yes yes yes yes yes"),
        (run_of(LOOPS, **NO_COMMANDS), "yes limited limited yes no"),
        (run_of(LOOPS, commands=np.ones((len(T), 2))), "yes limited limited yes limited"),
        (run_of(STRAIGHT), "yes limited limited limited yes"),
        (run_of(0 * LOOPS), "limited limited limited limited yes"),
        (run_of(LOOPS, **NONE, **NO_COMMANDS), "limited limited limited no no"),
        (run_of(LOOPS, **NONE, **REFERENCE), "limited yes yes no yes"),
        (run_of(LOOPS, ranges=np.full((len(T), 19), np.inf)), "no no no yes yes"),
    ],
)
def test_verdicts_follow_from_the_signals_and_the_motion(run: Run, verdicts: str) -> None:
    uses = uses_of(run, ground_of(run))
    assert [use.name for use in uses] == list(NAMES)
    assert " ".join(use.verdict for use in uses) == verdicts
    assert all(use.why and "\n" not in use.why for use in uses)


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (run_of(0 * LOOPS), "drive a loop of some metres"),
        (
            run_of(STRAIGHT),
            "drive loops with turns to both sides: the log has 10 m of nearly straight motion",
        ),
        (run_of(driven([(20, 0.0, 1.0)])), "drive some metres: the robot turned by 20 rad"),
        (run_of(driven([(20, 0.5, 0.5)])), "drive turns to the right: they are 0 % of all"),
        (run_of(driven([(9, 0.5, 0.3), (9, 0.5, -0.3)])), "return to places"),
        (run_of(LOOPS, **NO_COMMANDS), "record the commands"),
        (run_of(LOOPS, **NONE), "record the odometry"),
        (run_of(LOOPS), ""),
    ],
)
def test_the_minute_that_would_help_most_is_what_the_drive_lacks(run: Run, words: str) -> None:
    found = advice(run, ground_of(run))
    assert found.startswith(words) and bool(found) == bool(words)


def test_inspect_ends_with_the_table_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs.write(run_of(LOOPS), tmp_path / "run.mcap")
    assert cli(["inspect", str(tmp_path / "run.mcap"), "--json", str(tmp_path / "found.json")]) == 0
    table = capsys.readouterr().out.rstrip().split("what this log can be used for\n")[1].splitlines()
    assert [line.split("  ")[1] for line in table] == [*NAMES, "ground covered"]
    found = json.loads((tmp_path / "found.json").read_text())
    assert [use["name"] for use in found["use"]] == list(NAMES)
    assert found["use"][0] == {"name": "locate", "verdict": "yes", "why": "601 scans, and odometry"}
    assert found["ground"]["distance_m"] == pytest.approx(20, abs=0.3)
    assert found["advice"] == ""


def test_a_log_that_is_no_run_has_no_use(tmp_path: Path) -> None:
    path = write_bag2(tmp_path / "bag", [scan(0, [1, 2], topic=name) for name in ("/front", "/rear")])
    assert {use.verdict for use in inspect(path).use} == {"no"}


def test_no_warning_is_there_twice(tmp_path: Path) -> None:
    bag = [scan(0.1 * (i // 2), [1, 2 + i, 3]) for i in range(20)]
    bag += [odometry(t, t, 0, 0, topic=name) for t in np.arange(10) / 10 for name in ("/a", "/b")]
    found = inspect(write_bag2(tmp_path / "bag", sorted(bag, key=lambda m: m[2])))
    assert len(found.warnings) == len(set(found.warnings))
    for words in ("duplicates", "/a"):
        assert sum(words in line for line in (*found.warnings, *found.missing)) == 1
