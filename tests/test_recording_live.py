"""`record --live`: what a robot publishes is written as it was sent; what is missing is said."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

pytest.importorskip("zenoh")
import logs
from benchmarks import zenoh_robot as lab
from logs.live import network, recording
from logs.live.keys import PublishedTopic, data_key, dds_type, parse_token, ros_type
from planners.trajectory import Trajectory
from sensorgraph.cli import run as cli

TOPICS = ["/tf_static", "/pose", "/odom", "/cmd_vel", "/scan", "/chatter"]
N_RAYS = 31


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """Run a router on this machine."""
    port = lab.free_port()
    router = lab.open_session("router", port)
    yield port
    router.close()


def live(port: int, out: Path, *more: str, domain: int = 0) -> int:
    where = ["--router", f"127.0.0.1:{port}", "--domain", str(domain)]
    return cli(["record", "--live", *where, "-o", str(out), *more])


def drive(robot: lab.Robot, duration: float, rate: float = 40.0) -> Thread:
    """Drive a robot as soon as somebody listens."""

    def go() -> None:
        robot.wait_for_listener()
        time.sleep(0.2)  # the other topics follow
        robot.drive(duration, rate=rate, n_rays=N_RAYS)

    thread = Thread(target=go)
    thread.start()
    return thread


def stop_with(thread: Thread, monkeypatch: pytest.MonkeyPatch) -> None:
    """Press Ctrl-C when the thread has ended."""
    pump: Callable[[recording.LiveRecording, float], None] = recording.LiveRecording.pump

    def interrupted(self: recording.LiveRecording, duration: float) -> None:
        pump(self, duration)
        if not thread.is_alive():
            raise KeyboardInterrupt

    monkeypatch.setattr(recording.LiveRecording, "pump", interrupted)


@pytest.mark.parametrize("type_hash", [lab.HUMBLE, lab.KILTED], ids=["humble", "kilted"])
def test_every_message_is_in_the_file_as_it_was_sent(
    type_hash: str, port: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = lab.Robot(port, TOPICS, type_hash=type_hash)
    robot.send("/tf_static", lab.mount(1_700_000_000.0, 0.1, -0.05, 0.2))  # before anybody listens
    thread = drive(robot, 0.5)
    assert live(port, tmp_path / "run.mcap", "--duration", "1.4") == 0
    thread.join()
    robot.close()
    run = logs.read(tmp_path / "run.mcap")
    assert (run.n_scans, len(run.poses), len(run.odometry), len(run.commands)) == (20, 20, 20, 20)
    np.testing.assert_allclose(run.ranges[0], 2.0 + 0.001 * np.arange(N_RAYS), atol=1e-6)  # float32
    np.testing.assert_allclose(run.sensor.mount, [0.1, -0.05, 0.2], atol=1e-9)
    np.testing.assert_allclose(run.poses[4, :2], [2 + np.sin(0.05), 2 - np.cos(0.05)], atol=1e-9)
    np.testing.assert_allclose(run.odom_twists[3], [0.5, 0.5])
    said = capsys.readouterr().out
    assert "/scan: 20 messages, silent for the last 0." in said and "/tf_static: 1 message\n" in said
    assert "/chatter" not in said
    assert not list(tmp_path.glob("*.part"))


def test_messages_lost_on_the_way_and_gaps_are_counted(
    port: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = lab.Robot(port, ["/scan"], domain=3)

    def go() -> None:
        robot.wait_for_listener()
        for k in range(12):
            message = lab.scan(1_700_000_000.0 + 0.05 * k, [1.0] * N_RAYS, 20.0)
            robot.send("/scan", message, skip=k in (4, 5, 6))
            time.sleep(0.4 if k == 8 else 0.02)

    thread = Thread(target=go)
    thread.start()
    assert live(port, tmp_path / "run.mcap", "--duration", "1.2", domain=3) == 0
    thread.join()
    robot.close()
    assert "/scan: 9 messages, 3 lost in transport, 1 gap of 0.4" in capsys.readouterr().out


def test_it_ends_when_the_plan_is_covered_and_says_what_is_missing(
    port: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    phi = 0.5 * np.arange(0.0, 12.0, 0.02)
    way = Trajectory(
        stamps=np.arange(len(phi)) * 0.02,
        poses=np.column_stack([2 + np.sin(phi), 2 - np.cos(phi), phi]),
        twists=np.tile([0.5, 0.5], (len(phi), 1)),
        primitives=np.full(len(phi), "move"),
    )
    plan = tmp_path / "plan"
    plan.mkdir()
    way.write_csv(plan / "trajectory.csv")
    (plan / "plan.json").write_text(
        '{"grid": {"origin": [0.0, 0.0], "cell": 0.5, "headings": 4}, "rate": 40.0, "coverage": 1.0}'
    )
    robot = lab.Robot(port, ["/pose", "/scan"], domain=4)
    thread = drive(robot, 1.5)
    begin = time.monotonic()
    arguments = ["--until-covered", str(plan), "--share", "0.1", "--duration", "20"]
    assert live(port, tmp_path / "run.mcap", *arguments, domain=4) == 0
    assert time.monotonic() - begin < 15
    thread.join()
    robot.close()
    said = capsys.readouterr().out
    assert "of the plan's 1" in said and "missing in" in said and "headings" in said
    assert (
        f"sensorgraph plan ARENA --resume {tmp_path / 'run.mcap'} --cell 0.5 --headings 4 -o" in said
        and "the plan is covered; wrote" in said
    )
    assert "plan.json" in logs.read(tmp_path / "run.mcap").attachments


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "5"], "a LaserScan or Range is not published in domain 9 at tcp/127.0.0.1"),
        (["--topic", "pose=/mocap/pose"], "/mocap/pose"),
        (["--duration", "-1"], "expected seconds above 0"),
        (["--wait", "0"], "--wait is 0, expected seconds above 0"),
        (["--until-covered", "nowhere"], "nowhere has no trajectory.csv"),
        (["--graph", "some.sensorgraph"], "--graph is for the simulated robot"),
    ],
    ids=lambda value: value[0].strip("-") if isinstance(value, list) else "",
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    arguments: list[str],
    words: str,
    port: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(recording, "PATIENCE", 0.3)
    robot = lab.Robot(port, ["/chatter", "/odom"], domain=9)
    assert live(port, tmp_path / "run.mcap", *arguments, domain=9) == 2
    robot.close()
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and words in said[0], said
    if "published" in said[0]:
        assert "/chatter (std_msgs/msg/String), /odom (nav_msgs/msg/Odometry)" in said[0]
    assert not list(tmp_path.iterdir())


def test_no_router_and_no_zenoh_are_one_line_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(network, "CONNECT_TIMEOUT", 0.3)
    assert live(lab.free_port(), tmp_path / "run.mcap") == 2
    assert "no zenoh router answers at tcp/127.0.0.1:" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "zenoh", None)
    assert live(7447, tmp_path / "run.mcap") == 2
    assert "pip install eclipse-zenoh" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_names_of_data_and_tokens_are_rmw_zenohs() -> None:
    topic = PublishedTopic(name="/front/scan", type="sensor_msgs/msg/LaserScan")
    assert data_key(7, topic) == "7/front/scan/sensor_msgs::msg::dds_::LaserScan_/*"
    assert ros_type(dds_type("tf2_msgs/msg/TFMessage")) == "tf2_msgs/msg/TFMessage"
    head = "@ros2_lv/7/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/lidar/%front%scan"
    token = f"{head}/sensor_msgs::msg::dds_::LaserScan_/{lab.KILTED}/:1:,1:,:,:,,"
    assert parse_token(token) == PublishedTopic(
        name="/front/scan", type="sensor_msgs/msg/LaserScan", is_latched=True
    )
    assert parse_token(token.replace("/MP/", "/MS/")) is None
    assert network.endpoint_of("robot.local") == "tcp/robot.local:7447"
    assert network.endpoint_of("10.0.0.2:7500") == "tcp/10.0.0.2:7500"
    assert network.endpoint_of("tls/robot:7447") == "tls/robot:7447"


@pytest.mark.slow
def test_a_killed_recorder_loses_one_chunk(port: int, tmp_path: Path) -> None:
    robot = lab.Robot(port, ["/pose", "/scan"], domain=5)
    where = ["--router", f"127.0.0.1:{port}", "--domain", "5", "-o", str(tmp_path / "run.mcap")]
    command = [sys.executable, "-c", "from sensorgraph.cli import main; main()", "record", "--live"]
    process = subprocess.Popen([*command, *where])
    thread = drive(robot, 6.0, rate=100.0)
    thread.join()
    process.kill()
    process.wait()
    robot.close()
    (part,) = tmp_path.glob("*.part")
    assert cli(["recover", str(part), "-o", str(tmp_path / "saved.mcap")]) == 0
    run = logs.read(tmp_path / "saved.mcap")
    size = len(lab.scan(0.0, [1.0] * N_RAYS, 100.0)) + len(lab.pose(0.0, 0.0, 0.0, 0.0))
    assert run.n_scans >= 600 - 1.1 * 65536 / size


def test_ctrl_c_ends_a_recording_as_it_should(
    port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = lab.Robot(port, ["/scan"], domain=6)
    thread = drive(robot, 0.6)
    stop_with(thread, monkeypatch)
    assert live(port, tmp_path / "run.mcap", domain=6) == 0
    thread.join()
    robot.close()
    assert "stopped after" in capsys.readouterr().out
    assert logs.read(tmp_path / "run.mcap").n_scans >= 20


def test_sigterm_ends_a_recording_as_ctrl_c_does(port: int, tmp_path: Path) -> None:
    """`docker stop` of a recorder: the file is complete."""
    robot = lab.Robot(port, ["/scan"], domain=7)
    where = ["--router", f"127.0.0.1:{port}", "--domain", "7", "-o", str(tmp_path / "run.mcap")]
    words = [sys.executable, "-m", "sensorgraph", "record", "--live", *where]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        drive(robot, 0.6).join()
        time.sleep(0.3)
        process.terminate()
        said, _ = process.communicate(timeout=30)
    robot.close()
    assert process.returncode == 143
    assert "terminated after" in said
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
    assert logs.read(tmp_path / "run.mcap").n_scans >= 20


@pytest.mark.slow
def test_a_recording_goes_on_when_router_and_robot_restart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = lab.free_port()
    router = lab.open_session("router", port)
    seen: list[int] = []
    begins: list[float] = []

    def drive(robot: lab.Robot) -> None:
        """Drive with stamps that run with the clock of the wall, as a robot's do."""
        begins.append(time.monotonic())
        seen.append(robot.drive(0.25, rate=40.0, n_rays=N_RAYS, begin=begins[-1] - begins[0]))

    def lose_and_regain() -> None:
        nonlocal router
        first = lab.Robot(port, TOPICS)
        first.send("/tf_static", lab.mount(1_700_000_000.0, 0.1, -0.05, 0.2))
        first.wait_for_listener()
        time.sleep(0.1)
        drive(first)
        router.close()
        time.sleep(0.4)
        router = lab.open_session("router", port)
        first.wait_for_listener()
        drive(first)
        first.close()  # switched off, and on again: other publishers, which count from 1
        again = lab.Robot(port, ["/odom", "/pose", "/scan", "/tf_static"])
        again.wait_for_listener()
        time.sleep(0.3)
        drive(again)
        again.close()
        time.sleep(0.3)

    thread = Thread(target=lose_and_regain)
    stop_with(thread, monkeypatch)
    thread.start()
    assert live(port, tmp_path / "run.mcap") == 0
    thread.join()
    router.close()
    run = logs.read(tmp_path / "run.mcap")
    assert seen == [10, 10, 10] and run.n_scans == len(run.poses) == len(run.odometry) == 30
    np.testing.assert_allclose(np.diff(run.stamps)[[9, 19]], np.diff(begins) - 0.225, atol=1e-6)
    np.testing.assert_allclose(run.sensor.mount, [0.1, -0.05, 0.2], atol=1e-9)
    said = capsys.readouterr().out
    (note,) = (line for line in said.splitlines() if line.startswith("note:"))
    away = float(note.rpartition("(")[2].split()[0])
    assert f"no connection to the router at tcp/127.0.0.1:{port} from 0." in note and 0.3 <= away <= 3.0, note
    (scan,) = (line for line in said.splitlines() if line.startswith("/scan: 30 messages"))
    assert "lost" not in scan and "2 gaps, the longest " in scan and "silent for the last" in scan
    assert not list(tmp_path.glob("*.part"))


def test_router_and_robot_may_come_later_than_the_recorder(tmp_path: Path) -> None:
    port = lab.free_port()

    def come() -> None:
        time.sleep(0.3)
        router = lab.open_session("router", port)
        robot = lab.Robot(port, ["/pose", "/scan"])
        robot.wait_for_listener()
        time.sleep(0.1)
        robot.drive(0.25, rate=40.0, n_rays=N_RAYS)
        time.sleep(0.2)
        robot.close()
        router.close()

    thread = Thread(target=come)
    thread.start()
    assert live(port, tmp_path / "run.mcap", "--wait", "10", "--duration", "0.8") == 0
    thread.join()
    assert logs.read(tmp_path / "run.mcap").n_scans == 10
