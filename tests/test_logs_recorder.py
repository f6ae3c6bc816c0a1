"""Recorder: what was handed over is in the file, also after an exception and after kill -9."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from logs_samples import assert_same_run, some_run

import logs
from logs import RangeSensor, Recorder, Run
from logs.formats.mcap_file import CHUNK_SIZE
from logs.recovery import recover


def test_a_folder_is_refused_before_the_drive(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        Recorder(tmp_path, sensor=some_run().sensor)
    assert not tmp_path.with_name(f"{tmp_path.name}.part").exists()


def record(run: Run, path: Path) -> None:
    """Hand a run to the recorder in the order in which it happened."""
    events = [(float(t), "scan", i) for i, t in enumerate(run.stamps)]
    events += [(float(t), "pose", i) for i, t in enumerate(run.pose_stamps)]
    events += [(float(t), "odom", i) for i, t in enumerate(run.odom_stamps)]
    events += [(float(t), "cmd", i) for i, t in enumerate(run.cmd_stamps)]
    with Recorder(
        path, sensor=run.sensor, epoch_ns=run.epoch_ns, pose_frame=run.pose_frame, meta=run.meta
    ) as recorder:
        for name, data in run.attachments.items():
            recorder.attach(name, data)
        for stamp, kind, i in sorted(events):
            if kind == "scan":
                recorder.scan(stamp, run.ranges[i])
            elif kind == "pose":
                recorder.pose(stamp, run.poses[i])
            elif kind == "odom":
                recorder.odometry(stamp, run.odometry[i], run.odom_twists[i])
            else:
                recorder.command(stamp, run.commands[i])


@pytest.mark.parametrize("pose_frame", ["base_link", "laser"])
def test_run_recorded_is_run_read(tmp_path: Path, pose_frame: str) -> None:
    run = some_run(pose_frame=pose_frame)
    record(run, tmp_path / "run.mcap")
    assert_same_run(logs.read(tmp_path / "run.mcap"), run)
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]


def test_recorded_transforms_agree_with_the_reference_at_every_pose(tmp_path: Path) -> None:
    from logs.ros.recording import transform_tree

    run = some_run()
    record(run, tmp_path / "run.mcap")
    found = transform_tree(logs.formats.mcap_file.load(tmp_path / "run.mcap")).place("map", "base_link")
    assert found is not None
    np.testing.assert_allclose(found.poses[:, :2], run.poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.cos(found.poses[:, 2] - run.poses[:, 2]), 1, atol=1e-12)


def test_exception_keeps_what_was_written_under_a_name_that_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = some_run()
    with (
        caplog.at_level(logging.WARNING),
        pytest.raises(RuntimeError, match="motor"),
        Recorder(tmp_path / "run.mcap", sensor=run.sensor) as recorder,
    ):
        for i in range(5):
            recorder.scan(float(i), run.ranges[i])
        raise RuntimeError("motor off")
    assert [p.name for p in tmp_path.iterdir()] == ["run.interrupted.mcap"]
    assert "run.interrupted.mcap" in caplog.text
    np.testing.assert_array_equal(
        logs.read(tmp_path / "run.interrupted.mcap").ranges, run.ranges[:5].astype(np.float32)
    )
    recording = logs.formats.mcap_file.load(tmp_path / "run.interrupted.mcap")
    assert recording.metadata["sensorgraph.interrupted"] == {"reason": "RuntimeError: motor off"}


def test_recorder_refuses_what_does_not_fit_the_sensor(tmp_path: Path) -> None:
    sensor = RangeSensor(bearings=np.linspace(-1, 1, 5))
    with Recorder(tmp_path / "run.mcap", sensor=sensor) as recorder:
        with pytest.raises(ValueError, match=r"ranges has shape \(4,\), expected \(5,\)"):
            recorder.scan(0.0, np.ones(4))
        with pytest.raises(logs.LogError, match="before 1970"):
            recorder.scan(-1.0, np.ones(5))
        with pytest.raises(logs.LogError, match="not finite"):
            recorder.pose(np.nan, np.zeros(3))
        recorder.scan(0.0, np.ones(5))
    assert logs.read(tmp_path / "run.mcap").n_scans == 1


KILLED = """
import sys, numpy as np
from logs import Recorder, RangeSensor
recorder = Recorder(sys.argv[1], sensor=RangeSensor(bearings=np.linspace(-1, 1, 181)), attachments={"a.txt": b"kept"})
rng = np.random.default_rng(0)
for i in range(10**9):
    recorder.scan(i / 10, rng.uniform(1, 7, 181))
    if i == 1000:
        print("now", flush=True)
        sys.stdin.readline()
"""


def test_kill_9_loses_the_open_chunk_at_most(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    )
    assert child.stdout is not None and child.stdin is not None
    assert child.stdout.readline() == "now\n"
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    child.stdout.close()
    child.stdin.close()
    part = tmp_path / "run.mcap.part"
    assert [p.name for p in tmp_path.iterdir()] == [part.name]
    with pytest.raises(
        logs.LogError, match=r"sensorgraph recover .*run\.mcap\.part -o .*run\.recovered\.mcap"
    ):
        logs.read(part)
    saved = recover(part, path)
    per_chunk = CHUNK_SIZE // (4 * 181) + 1
    assert 1001 - per_chunk <= saved.written["/scan"] <= 1001
    run = logs.read(path)
    want = np.random.default_rng(0).uniform(1, 7, (run.n_scans, 181)).astype(np.float32)
    np.testing.assert_array_equal(run.ranges, want)
    assert run.attachments == {"a.txt": b"kept"}
