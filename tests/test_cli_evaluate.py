"""`sensorgraph evaluate` and `review` say so if graph and run do not belong together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from localization_samples import loop_poses, room_run
from watching_samples import graph

import logs
from sensorgraph.cli import run as cli


@pytest.mark.parametrize("command", ["evaluate", "review"])
def test_a_run_in_another_frame_than_the_graph_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    graph().save(tmp_path / "room.sensorgraph")
    poses = loop_poses(60)
    run = room_run(poses, seed=3)
    told = []
    for name, offset in (("same", 0.0), ("other", 0.7)):
        moved = replace(run, pose_stamps=run.stamps, poses=poses + [offset, 0.0, 0.0])
        logs.write(moved, tmp_path / f"{name}.mcap")
        model, log = str(tmp_path / "room.sensorgraph"), str(tmp_path / f"{name}.mcap")
        review = ["review", log, "--graph", model, "-o", str(tmp_path / f"{name}.rrd")]
        assert cli(["evaluate", model, log] if command == "evaluate" else review) == 0
        told.append([line for line in capsys.readouterr().err.splitlines() if "fits the run badly" in line])
    assert not told[0]
    assert len(told[1]) == 1 and told[1][0].startswith(
        "warning: the graph fits the run badly (median error 0."
    )
