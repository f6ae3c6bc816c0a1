"""Scans that contradict each other because of a clock, a mount, bearings or a scale, and those that do not."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from localization_samples import room_run

import logs
from logs.run import Run
from sensorgraph.building.build import build
from sensorgraph.cli import run as command
from sensorgraph.world.orientation import orientation
from sensorgraph.world.self_fit import SEARCHES, self_fit


@cache
def good() -> Run:
    """Return a drive around the box that looks about; on a circle, a lag would be a turn of the whole room."""
    t = np.arange(0.0, 26.0, 0.1)
    around = np.column_stack([3.2 + 1.5 * np.cos(0.25 * t), 2.6 + 1.5 * np.sin(0.25 * t)])
    poses = np.column_stack([around, 0.25 * t + np.pi / 2 + 0.9 * np.sin(0.9 * t)])
    run = room_run(poses, n_rays=90, rate=10.0)
    return replace(run, pose_stamps=run.stamps, poses=poses, meta={"pose_source": "/pose"})


def changed(name: str, value: float) -> Run:
    """Return the run for which a change by `value` is right."""
    run = good()
    sensor, bearings = run.sensor, run.sensor.bearings
    if name == "lag":
        return replace(run, pose_stamps=run.pose_stamps + value)
    if name == "turn":
        return replace(run, sensor=replace(sensor, bearings=bearings - value))
    if name == "step":
        wrong = bearings[0] + (bearings - bearings[0]) / (1 + value)
        return replace(run, sensor=replace(sensor, bearings=wrong))
    return replace(run, ranges=run.ranges / (1 + value))


@pytest.mark.parametrize(
    ("name", "value"), [("lag", 0.3), ("lag", -0.2), ("turn", 0.1), ("step", 0.03), ("scale", -0.05)]
)
def test_what_is_wrong_is_named_with_its_size(name: str, value: float) -> None:
    found = self_fit(changed(name, value))
    assert found is not None and found.name == name
    assert found.value == pytest.approx(value, abs=2 * SEARCHES[name].fine)
    assert "%" in found.line()


def test_scans_that_agree_and_runs_that_show_nothing_have_no_verdict() -> None:
    run = good()
    assert self_fit(run) is None
    assert self_fit(run.take_scans(slice(0, 40))) is None
    assert self_fit(replace(run, ranges=np.full_like(run.ranges, 50.0))) is None
    assert self_fit(replace(run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3)))) is None


@pytest.mark.parametrize("degrees", [90, -60])
def test_a_laser_that_is_turned_by_any_angle_is_noticed(degrees: int) -> None:
    run = good()
    mount = run.sensor.mount - [0, 0, np.radians(degrees)]
    found = orientation(replace(run, sensor=replace(run.sensor, mount=mount)), None)
    assert found is not None
    assert found.best == f"turned {degrees}°"


def test_inspect_and_build_warn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(changed("lag", 0.3), tmp_path / "late.mcap")
    assert command(["inspect", str(tmp_path / "late.mcap")]) == 0
    words = r"the scans fit each other better with the poses that are stamped (280|300|320) ms later"
    assert re.search(f"WARNING: {words}", capsys.readouterr().out)
    entry = build([changed("lag", 0.3)], model="polynomial", degree=1, harmonics=1).origin["inputs"][0]
    assert any(re.match(words, text) for text in entry["warnings"])
