"""benchmarks/foreign_worlds: a world of others shares no code with ours, and its logs mean what their truth says."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from logs import read

GENERATOR = Path(__file__).parent.parent / "benchmarks" / "foreign_worlds"


def test_foreign_worlds_import_nothing_of_ours() -> None:
    for path in GENERATOR.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                top, _, rest = name.partition(".")
                assert top not in ("sensorgraph", "planners", "logs", "robotmodic_ident"), f"{path}: {name}"
                assert top != "benchmarks" or rest.startswith("foreign_worlds"), f"{path}: {name}"


def test_kinds_of_the_report_are_not_those_of_development() -> None:
    hidden = pytest.importorskip("benchmarks.foreign_worlds.hidden")
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
    from benchmarks.foreign_worlds import cases
    from benchmarks.foreign_worlds.files import write_log

    monkeypatch.setattr(cases, "DURATION", 6.0)
    log, arena, robot, truth = cases.make(cases.Spec(suite="none", kinds="dev", index=0, name=name))
    write_log(log, tmp_path / "run.mcap")
    run = read(tmp_path / "run.mcap")
    np.testing.assert_allclose(run.ranges, log.ranges, rtol=1e-6)
    assert len(run.odom_stamps) == len(log.odom_stamps) and len(run.cmd_stamps) == len(log.cmd_stamps)
    from planners.maps import geojson
    from sensorgraph.world.raycast import cast_laser, laser_poses
    from sensorgraph.world.robot import parse_robot

    machine = parse_robot(robot)
    poses = np.stack([np.interp(log.scan_stamps, log.pose_stamps, np.unwrap(c)) for c in log.poses.T], axis=1)
    ideal, _ = cast_laser(
        geojson.loads(arena).walls,
        laser_poses(poses, machine.sensor.mount),
        log.bearings,
        machine.sensor.range_max,
    )
    off = np.median((log.ranges - ideal)[np.isfinite(log.ranges)])
    bias = truth["effects"][0]["parameters"]["b"] if name else 0.0
    assert abs(off - bias) < 0.002


def test_the_mark_of_an_effect_is_what_it_does_to_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    from benchmarks.foreign_worlds import cases

    monkeypatch.setattr(cases, "DURATION", 6.0)
    _, _, robot, truth = cases.make(cases.Spec(suite="singles", kinds="dev", index=0, name="range_bias"))
    (effect,) = truth["effects"]
    sigma = float(robot.split("sigma: ")[1].split(",")[0])
    assert effect["mark"]["rmse_over_sigma"] == pytest.approx(
        min(abs(effect["parameters"]["b"]) / sigma, 5.0), rel=0.1
    )
    monkeypatch.setitem(cases.draw_hidden.__globals__["SPANS"], "min_range", {"r_min": (0.11, 0.12)})
    _, _, _, truth = cases.make(cases.Spec(suite="singles", kinds="dev", index=0, name="min_range"))
    assert not truth["effects"][0]["material"]  # nothing stands so near
