"""`sensorgraph watch` on files: statements, page, messages, policy and exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from localization_samples import loop_poses, room_run
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader
from watching_samples import believing, graph

import logs
from logs.notes import with_note
from logs.ros.transform_tree import MOVES
from sensorgraph.cli import run as cli
from sensorgraph.cli.watch import _read
from sensorgraph.errors import SensorgraphError
from sensorgraph.termination import Terminated
from sensorgraph.watching.policy import load_policy
from sensorgraph.watching.watcher import watch_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a graph, a good run, and a shorter one whose belief is put off after 20 s."""
    out = tmp_path_factory.mktemp("watch")
    graph().save(out / "room.sensorgraph")
    poses = loop_poses(330, laps=3.0)
    run = believing(room_run(poses, seed=20), poses)
    logs.write(run, out / "good.mcap")
    off = poses.copy()
    off[100:, 1] += 0.7
    logs.write(replace(run, poses=off).take_scans(slice(0, 150)), out / "off.mcap")
    return out


@contextmanager
def ended(process: subprocess.Popen[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """Yield the leader of a process group, which is ended afterwards: `rerun` is a script with a child."""
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()


def entities_of(recording: Path) -> set[str]:
    """Return the entities of an .rrd; one that is still written has no footer."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {str(chunk.entity_path) for chunk in RrdReader(recording).stream().to_chunks()}


@pytest.mark.parametrize(("end", "code"), [(KeyboardInterrupt, 0), (Terminated, 143)])
def test_a_live_watch_that_is_stopped_has_complete_files(
    end: type[BaseException], code: int, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C and SIGTERM are its normal end."""

    class Stopped:
        epoch_ns, n_used, n_dropped = 0, 1, 0

        def __init__(self, model: Any, *_: Any, **__: Any) -> None:
            self.model = model

        def statuses(self, _: None) -> Iterator[Any]:
            run = logs.read(folder / "off.mcap").take_scans(slice(0, 12))
            yield from watch_run(self.model, run)
            raise end

        def publish(self, *_: Any) -> None: ...

    monkeypatch.setattr("logs.live.network.RosNetwork", lambda *_, **__: nullcontext())
    monkeypatch.setattr("logs.live.recording.LiveScans", lambda *_, **__: None)
    monkeypatch.setattr("sensorgraph.watching.live.LiveWatch", Stopped)
    out = ["-o", str(tmp_path / "w.mcap"), "--json", str(tmp_path / "w.jsonl")]
    assert cli(["watch", str(folder / "room.sensorgraph"), "--live", *out]) == code
    assert sorted(path.name for path in tmp_path.iterdir()) == ["w.html", "w.jsonl", "w.mcap"]


def test_statements_page_and_messages_of_a_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, lines = folder / "watch.mcap", folder / "watch.jsonl"
    code = cli(
        [
            "watch",
            str(folder / "room.sensorgraph"),
            str(folder / "off.mcap"),
            "-o",
            str(out),
            "--json",
            str(lines),
        ]
    )
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert "off by 0.7" in printed.out
    said = [json.loads(line) for line in lines.read_text().splitlines()]
    assert len(said) == pytest.approx(30, abs=2)
    assert {"t", "pose", "place", "robot"} <= set(said[0])
    assert {"status", "offset_m", "offset_rad", "p"} <= set(said[0]["pose"])
    assert said[-1]["pose"]["status"] == "off"
    assert said[-1]["pose"]["offset_m"] == pytest.approx(0.7, abs=0.05)
    page = out.with_suffix(".html").read_text()
    assert "<svg" in page and "Time line" in page
    with AnyReader([out]) as reader:
        of_topic = {one.topic: one for one in reader.connections}
        assert {"/diagnostics", "/watch/changes", "/watch/pose"} <= set(of_topic)
        told = [
            (stamp, reader.deserialize(data, connection.msgtype).status[0])
            for connection, stamp, data in reader.messages([of_topic["/diagnostics"]])
        ]
    last = told[-1][1]
    assert (last.name, last.level) == ("sensorgraph: pose", 2)
    assert last.message.startswith("off by 0.7")
    p_wrong = [float(next(one.value for one in status.values if one.key == "p_wrong")) for _, status in told]
    began = next(pair for pair, p in zip(told, p_wrong, strict=True) if p > 0.9)  # the limit of an error
    result = f"error at {(began[0] - told[0][0]) / 1e9:.0f} s: pose {began[1].message}"
    end = f"at the end, {(told[-1][0] - told[0][0]) / 1e9:.0f} s:"
    assert result in printed.out and f"<title>{result}" in page
    assert f"{end}\npose {last.message}\n" in printed.out and end.replace(" s:", "\u00a0s:") in page


@pytest.mark.slow
def test_a_policy_from_good_runs_passes_them_and_fails_a_wrong_pose(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, policy = str(folder / "room.sensorgraph"), folder / "site.yaml"
    assert cli(["watch", room, "--init-policy", str(folder / "good.mcap"), "-o", str(policy)]) == 0
    limits = load_policy(policy)
    assert limits.hours == pytest.approx(65 / 3600, abs=2 / 3600)
    assert limits.share_predicted["error"] < limits.share_predicted["warning"] < 1.0
    assert cli(["watch", room, str(folder / "good.mcap"), "--policy", str(policy)]) == 0
    assert cli(["watch", room, str(folder / "off.mcap"), "--policy", str(policy)]) == 2
    assert "error at 20 s: pose off" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "0 runs are given"),
        (["good.mcap", "off.mcap"], "2 runs are given"),
        (["good.mcap", "--live"], "1 runs are given with --live"),
        (["good.mcap", "-o", "x.json"], "written as *.mcap"),
        (["good.mcap", "--policy", "bad.yaml"], "is no policy of watch"),
        (["--init-policy"], "--init-policy takes good runs"),
    ],
)
def test_bad_input_gives_one_line(
    arguments: list[str],
    words: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(folder)
    Path("bad.yaml").write_text("pose: [1, 2]\n")
    assert cli(["watch", "room.sensorgraph", *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()[-1:]
    assert words in line


def test_a_run_of_another_laser_is_refused_and_writes_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = room_run(loop_poses(10), n_rays=50)
    logs.write(other, tmp_path / "other.mcap")
    out = tmp_path / "w.mcap"
    assert cli(["watch", str(folder / "room.sensorgraph"), str(tmp_path / "other.mcap"), "-o", str(out)]) == 2
    assert "built with this laser" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.mcap"]
    assert np.isfinite(other.ranges).all()


def test_a_mount_that_robot_yaml_states_replaces_one_that_moves(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pans = with_note(room_run(loop_poses(3)), f"{MOVES}20 degrees")
    monkeypatch.setattr("logs.read", lambda *_, **__: pans)
    robot = tmp_path / "robot.yaml"
    rays = "angle_min: -180 deg, angle_max: 177 deg, n_rays: 120"
    robot.write_text(f"name: r\nsensor: {{{rays}, mount: [0.1, 0.0, 0.0]}}\n")
    with pytest.raises(SensorgraphError, match="the laser moves on the robot"):
        _read(tmp_path / "pans.mcap", {}, None)
    assert _read(tmp_path / "pans.mcap", {}, robot).sensor.mount == pytest.approx([0.1, 0.0, 0.0])


@pytest.mark.slow
def test_show_streams_to_a_viewer_and_writes_the_same_recording(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    started: list[list[str]] = []

    def headless(command: list[str], **options: Any) -> subprocess.Popen[bytes]:
        started.append([command[0], "--serve-grpc", *command[1:-1]])  # a server without a window
        return viewers.enter_context(ended(popen(started[0], **options)))

    popen, out = subprocess.Popen, tmp_path / "w.mcap"
    with ExitStack() as viewers:
        monkeypatch.setattr("sensorgraph.show.rerun_file.subprocess.Popen", headless)
        arguments = [str(folder / "room.sensorgraph"), str(folder / "off.mcap"), "-o", str(out), "--show"]
        assert cli(["watch", *arguments]) == 0
        port = started[0][started[0].index("--port") + 1]
        copy = tmp_path / "streamed.rrd"
        save = [started[0][0], f"rerun+http://127.0.0.1:{port}/proxy", "--port", "auto", "--save", str(copy)]
        with ended(popen(save, start_new_session=True)):
            until = time.monotonic() + 20
            while not (copy.exists() and entities_of(copy)) and time.monotonic() < until:
                time.sleep(0.5)
    expected = {"/plan/walls", "/plan/path", "/plan/robot", "/said/pose", "/series/p_wrong"}
    assert expected <= entities_of(out.with_suffix(".rrd"))
    assert expected <= entities_of(copy)


@pytest.mark.slow
def test_inspect_judges_topics_by_the_same_policy(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = tmp_path / "site.yaml"
    good = logs.read(folder / "good.mcap")
    assert (
        cli(
            [
                "watch",
                str(folder / "room.sensorgraph"),
                "--init-policy",
                str(folder / "good.mcap"),
                "-o",
                str(policy),
            ]
        )
        == 0
    )
    assert cli(["inspect", str(folder / "good.mcap"), "--policy", str(policy)]) == 0
    keep = np.abs(np.arange(good.n_scans) - 100) > 4  # 2 s of scans are missing
    logs.write(good.take_scans(keep), tmp_path / "gap.mcap")
    assert cli(["inspect", str(tmp_path / "gap.mcap"), "--policy", str(policy)]) == 2
    assert "/scan has a gap of 2.00 s, expected at most 1 s" in capsys.readouterr().out
    logs.write(
        replace(
            good,
            odom_stamps=good.odom_stamps[:0],
            odometry=good.odometry[:0],
            odom_twists=good.odom_twists[:0],
        ),
        tmp_path / "few.mcap",
    )
    assert cli(["inspect", str(tmp_path / "few.mcap"), "--policy", str(policy)]) == 2
    assert "/odom is missing" in capsys.readouterr().out
