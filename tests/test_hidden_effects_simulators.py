"""benchmarks/foreign_worlds: a world of others shares no code with ours, and its logs mean what their truth says."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects.case import Spec
from benchmarks.hidden_effects.log import write_log
from logs import read

HIDDEN = "benchmarks.hidden_effects.worlds.simulators.hidden"


def test_kinds_of_the_report_are_not_those_of_development() -> None:
    hidden = importlib.import_module(HIDDEN)
    for kinds in (hidden.LIBRARY, hidden.FOREIGN):
        assert not set(kinds["dev"]) & set(kinds["report"])
        assert set(kinds["dev"]) | set(kinds["report"]) <= set(hidden.SPANS)
    for kinds in (hidden.IRSIM_LIBRARY, hidden.IRSIM_FOREIGN):
        assert not set(kinds["dev"]) & set(kinds["report"])
    assert len(hidden.FOREIGN["dev"]) >= 8 and len(hidden.FOREIGN["report"]) >= 8


@pytest.mark.parametrize("name", ["", "range_bias"])
def test_a_log_of_mujoco_means_what_its_truth_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    from benchmarks.hidden_effects.worlds.simulators import mujoco

    monkeypatch.setattr(mujoco, "DURATION", 6.0)
    case = mujoco.make(Spec(suite="none", index=0, effect=name))
    log = case.log
    write_log(log, tmp_path / "run.mcap", "mujoco")
    run = read(tmp_path / "run.mcap")
    np.testing.assert_allclose(run.ranges, log.ranges, rtol=1e-6)
    assert len(run.odom_stamps) == len(log.odometry.stamps) and len(run.cmd_stamps) == len(log.cmd_stamps)
    from planners.maps import geojson
    from sensorgraph.world.raycast import cast_laser, laser_poses
    from sensorgraph.world.robot import parse_robot

    machine = parse_robot(case.robot)
    poses = np.stack([np.interp(log.scan_stamps, log.pose_stamps, np.unwrap(c)) for c in log.poses.T], axis=1)
    ideal, _ = cast_laser(
        geojson.loads(case.map["arena.geojson"]).walls,
        laser_poses(poses, machine.sensor.mount),
        log.bearings,
        machine.sensor.range_max,
    )
    off = np.median((log.ranges - ideal)[np.isfinite(log.ranges)])
    bias = case.truth["effects"][0]["parameters"]["b"] if name else 0.0
    assert abs(off - bias) < 0.002


def test_the_mark_of_an_effect_is_what_it_does_to_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    from benchmarks.hidden_effects.worlds.simulators import mujoco

    monkeypatch.setattr(mujoco, "DURATION", 6.0)
    case = mujoco.make(Spec(suite="singles", index=0, effect="range_bias"))
    (effect,) = case.truth["effects"]
    sigma = float(case.robot.split("sigma: ")[1].split(",")[0])
    assert effect["mark"]["rmse_over_sigma"] == pytest.approx(
        min(abs(effect["parameters"]["b"]) / sigma, 5.0), rel=0.1
    )
    monkeypatch.setitem(importlib.import_module(HIDDEN).SPANS, "min_range", {"r_min": (0.11, 0.12)})
    truth = mujoco.make(Spec(suite="singles", index=0, effect="min_range")).truth
    assert not truth["effects"][0]["material"]  # nothing stands so near
