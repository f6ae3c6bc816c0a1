"""The entrant of this repository: `sensorgraph diagnose`."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.hidden_effects.case import Case
from logs import RangeSensor, Run
from sensorgraph.cli import run as run_command


def answer(case: Path) -> dict[str, Any]:
    """Return report.json of the command, with the CPU time of the diagnosis alone."""
    run = str(case / "run.mcap")
    drawn, pixels = case / "arena.geojson", case / "arena.yaml"
    files = ["--arena", str(drawn if drawn.exists() else pixels), "--robot", str(case / "robot.yaml")]
    printed = io.StringIO()
    with tempfile.TemporaryDirectory() as out:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            code = run_command(["diagnose", run, *files, "-o", out])
        if code:
            raise RuntimeError(printed.getvalue().strip()[-4000:])
        report: dict[str, Any] = json.loads((Path(out) / "report.json").read_text())
        timing = json.loads((Path(out) / "timing.json").read_text())
        return report | {"diagnosis_s": sum(timing["cpu_s"].values())}


def run_of(case: Case) -> Run:
    """Return the run of a case as `logs` would read it from its files, without writing them."""
    log, sensor = case.log, yaml.safe_load(case.robot)["sensor"]
    return Run(
        sensor=RangeSensor(
            bearings=log.bearings,
            range_min=log.range_limits[0],
            range_max=log.range_limits[1],
            mount=np.array(sensor["mount"]),
            **{key: sensor[key] for key in ("sigma", "resolution", "rate", "sweep_time", "height")},
        ),
        stamps=log.scan_stamps,
        ranges=log.ranges,
        pose_stamps=log.pose_stamps,
        poses=log.poses,
        odom_stamps=log.odometry.stamps,
        odometry=log.odometry.poses,
        odom_twists=log.odometry.twists,
        cmd_stamps=log.cmd_stamps,
        commands=log.commands,
    )
