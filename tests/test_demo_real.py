"""`sensorgraph demo --real`: the shipped log, whose it is, and what is said of its wheels."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from localization_samples import loop_poses, room_run

from sensorgraph.cli import run as command
from sensorgraph.demo_real import LOG, odometry_drift
from sensorgraph.localization.locate import LocatedRun
from sensorgraph.localization.result import Localization, WheelParameters


def test_shipped_log_says_whose_it_is() -> None:
    data = files("sensorgraph.data")
    said = (data / "fr079.ATTRIBUTION.md").read_text(encoding="utf-8")
    assert "Creative Commons Attribution 3.0" in said and "University of Freiburg" in said and LOG in said
    assert (data / LOG).read_bytes().startswith(b"BZh")


def test_drift_of_the_wheels_goes_where_their_parameters_are_right() -> None:
    truth = loop_poses(200, laps=2.0)
    run = room_run(truth, way_scale=0.95, heading_bias=0.03)
    found = Localization(
        t=run.stamps,
        poses=truth,
        covariances=np.broadcast_to(np.eye(3) * 1e-6, (200, 3, 3)),
        status=("ok",) * 200,
        wheels=WheelParameters(way_scale=1 / 0.95, heading_bias=0.03 / 0.95),
    )
    before, after = odometry_drift(LocatedRun.of(run, found))
    assert before > 0.2 and after < 0.02


@pytest.mark.slow
def test_demo_on_the_real_log_leaves_poses_graph_and_review(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(["demo", "--real", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "4,934 of 4,934 scans located" in said and "CC-BY 3.0" in said
    assert {"located.mcap", "poses.csv", "map.png", "fr079.sensorgraph", "review.rrd", "demo.json"} <= {
        path.name for path in tmp_path.iterdir()
    }
    numbers = json.loads((tmp_path / "demo.json").read_text())
    assert numbers["evaluation"]["all"]["within_0.1m"] > 0.75
