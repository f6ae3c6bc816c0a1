"""Two scanners that publish on one topic with one frame_id are named; one laser is not, however it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from localization_samples import loop_poses, room_run, seen

import logs
from logs.alternating_scans import alternating_text
from logs.run import Run
from logs.transforms import compose
from sensorgraph.cli import run as command

POSES = loop_poses(90)
RUN = room_run(POSES)


def mixed(every: int) -> Run:
    """Return the run with every n-th scan of a laser at the back of the robot, that looks backwards."""
    rear = np.arange(len(POSES)) % every == 0
    ranges = RUN.ranges.copy()
    ranges[rear] = seen(compose(POSES[rear], np.array([-0.3, 0.1, np.pi])), RUN.sensor.bearings)
    return replace(RUN, ranges=ranges)


@pytest.mark.parametrize("every", [2, 3])
def test_scans_of_two_lasers_are_named(every: int) -> None:
    assert "two scanners seem to share the topic" in alternating_text(mixed(every).ranges)


def test_scans_of_one_laser_are_not() -> None:
    fast = room_run(loop_poses(60, laps=8))  # 48 degrees from scan to scan
    missing = np.where(np.random.default_rng(0).random(RUN.ranges.shape) < 0.95, np.inf, RUN.ranges)
    one = np.broadcast_to(RUN.ranges[:1], RUN.ranges.shape)
    for ranges in (RUN.ranges, RUN.ranges[::6], fast.ranges, missing, one, RUN.ranges[:5], RUN.ranges[:0]):
        assert alternating_text(ranges) == ""


def test_locate_refuses_them_and_inspect_warns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(mixed(2), tmp_path / "two.mcap")
    assert command(["locate", str(tmp_path / "two.mcap")]) != 0
    assert "two scanners seem to share the topic" in capsys.readouterr().err
    assert command(["inspect", str(tmp_path / "two.mcap")]) == 0
    assert "two scanners seem to share the topic" in capsys.readouterr().out
