"""`watch --live`: a robot on zenoh, made by plain zenoh, is watched, and the statements are published."""

from __future__ import annotations

import time
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from localization_samples import loop_poses, room_run
from watching_samples import graph

pytest.importorskip("zenoh")
from rosbags.typesys import Stores, get_typestore

from benchmarks import zenoh_robot as lab
from logs.live.keys import parse_token
from sensorgraph.cli import run as cli
from sensorgraph.watching.live import warm_up
from sensorgraph.watching.tracker import PoseTracker


def test_kernels_are_warmed_up_by_a_robot_that_is_searched_for(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []
    monkeypatch.setattr(PoseTracker, "_search", lambda self, now: begun.append(1))
    warm_up(graph())
    assert begun


@pytest.mark.slow
def test_a_running_robot_is_watched_and_its_statements_are_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    graph().save(tmp_path / "room.sensorgraph")
    port = lab.free_port()
    router = lab.open_session("router", port)
    received: list[bytes] = []
    tokens: list[str] = []
    listener = lab.open_session("client", port)
    listener.declare_subscriber("0/diagnostics/**", lambda sample: received.append(sample.payload.to_bytes()))
    listener.liveliness().declare_subscriber(
        "@ros2_lv/0/**", lambda sample: tokens.append(str(sample.key_expr)), history=True
    )
    robot = lab.Robot(port, ["/tf_static", "/pose", "/odom", "/scan"])
    poses = loop_poses(240, laps=0.9)
    run = room_run(poses, rate=20.0, seed=30)
    bearings = run.sensor.bearings

    def drive() -> None:
        robot.send("/tf_static", lab.mount(1_700_000_000.0, 0.0, 0.0, 0.0))
        robot.wait_for_listener(timeout=300.0)  # without a cache, the kernels are compiled first
        began = time.monotonic()
        for k, ((x, y, phi), ranges) in enumerate(zip(poses, run.ranges, strict=True)):
            stamp = 1_700_000_000.0 + k / 20.0
            step = 0.7 if k > 100 else 0.0  # the robot believes something else after 5 s
            robot.send("/pose", lab.pose(stamp, x + step, y, phi))
            robot.send("/odom", lab.odometry(stamp, *run.odometry[k], 0.5, 0.3))
            robot.send("/scan", scan_of(stamp, bearings, ranges))
            time.sleep(max(began + (k + 1) / 20.0 - time.monotonic(), 0.0))

    thread = Thread(target=drive)
    thread.start()
    where = ["--router", f"127.0.0.1:{port}", "--domain", "0", "--duration", "10", "--wait", "20"]
    code = cli(
        ["watch", str(tmp_path / "room.sensorgraph"), "--live", *where, "-o", str(tmp_path / "live.mcap")]
    )
    thread.join()
    robot.close()
    listener.close()
    router.close()
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert "off by 0.7" in printed.out
    assert (tmp_path / "live.mcap").exists() and (tmp_path / "live.html").exists()
    types = get_typestore(Stores.ROS2_HUMBLE)
    said = [types.deserialize_cdr(data, "diagnostic_msgs/msg/DiagnosticArray") for data in received]
    assert len(said) >= 6
    levels = [one.status[0].level for one in said]
    assert levels[2] == 0 and levels[-1] == 2
    announced = [topic.name for token in tokens if (topic := parse_token(token)) is not None]
    assert "/diagnostics" in announced


def scan_of(stamp: float, bearings: np.ndarray, ranges: np.ndarray) -> bytes:
    n = len(ranges)
    message = lab.Cdr().header(stamp, "laser")
    message.put("7f", bearings[0], bearings[-1], bearings[1] - bearings[0], 0.0, 0.05, 0.05, 20.0)
    message.put("I", n).put(f"{n}f", *ranges).put("I", 0)
    return bytes(message.data)
