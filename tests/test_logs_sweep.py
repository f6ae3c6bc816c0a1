"""What a log says of a laser's sweep: shown, doubted where it cannot be, and overruled by a robot.yaml."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_logs_formats_rosbag import Message, pose, scan, write_bag2

import logs
from logs.inspection import inspect
from logs.run import RangeSensor, Run
from sensorgraph.cli import run as command
from sensorgraph.world.ray_order import ray_order
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.sweep import sweep_warning, with_sweep_of

N_RAYS, PERIOD = 36, 0.1
ROBOT = parse_robot("sensor: {n_rays: 36, fov: 6.283185307, sweep_time: 0.1}")


def spinning(
    folder: Path, time_increment: float, *, clockwise: bool = False, scan_time: float = PERIOD
) -> Path:
    """Write a bag of a laser that looks all around, 10 times a second, as `scan_time` says, too."""
    messages: list[Message] = []
    for k in range(20):
        at = k * PERIOD
        messages.append(
            scan(
                at,
                np.full(N_RAYS, 1.0 + 0.01 * k),
                angle_min=np.pi if clockwise else 0.0,
                increment=(-2 if clockwise else 2) * np.pi / N_RAYS,
                time_increment=time_increment,
                scan_time=scan_time,
            )
        )
        messages.append(pose(at, 0.02 * k, 0.0, 0.0))
    folder.mkdir(exist_ok=True)
    write_bag2(folder / "bag", messages)
    return folder / "bag"


def test_inspect_shows_the_sweep(tmp_path: Path) -> None:
    found = inspect(spinning(tmp_path, PERIOD / N_RAYS))
    assert "a sweep of 0.1 s (time_increment 2.78 ms), a scan every 0.1 s" in found.usable
    assert not [line for line in found.warnings if "sweep" in line]


@pytest.mark.parametrize("time_increment", [0.0, 3e-5], ids=["left at 0", "as of the LDS-01"])
def test_time_increment_that_disagrees_with_scan_time_is_warned_of(
    tmp_path: Path, time_increment: float
) -> None:
    (warning,) = [line for line in inspect(spinning(tmp_path, time_increment)).warnings if "sweep" in line]
    assert "0.1 s according to scan_time" in warning and "sensor.sweep_time: 0.1" in warning


def test_a_log_of_which_every_third_scan_may_have_been_kept_is_not_told_that_it_is_wrong(
    tmp_path: Path,
) -> None:
    found = inspect(spinning(tmp_path, PERIOD / 3 / N_RAYS))
    (warning,) = [line for line in found.warnings if "sweep" in line]
    assert "unless the log keeps one scan in 3, set sensor.sweep_time: 0.1" in warning


@pytest.mark.parametrize(
    ("time_increment", "sweep", "words"),
    [
        (
            0.03,
            0.0,
            "0.03 s, with which 36 rays would take 1.08 s of the 0.1 s between scans, is invalid: 0 was used",
        ),
        (0.1, 0.1, "is the duration of a whole scan: 0.00278 s was used"),
        (2.5, 0.09, "is in milliseconds: 0.0025 s was used"),
        (-2500.0, -0.09, "is in microseconds: -0.0025 s was used"),
        (2.5e6, 0.09, "is in nanoseconds: 0.0025 s was used"),
    ],
    ids=["invalid", "whole scan", "ms", "us", "ns"],
)
def test_sweep_longer_than_the_time_between_scans_is_not_believed(
    time_increment: float, sweep: float, words: str, tmp_path: Path
) -> None:
    run = logs.read(spinning(tmp_path, time_increment))
    assert run.sensor.sweep_time == pytest.approx(sweep, rel=1e-6)  # float32
    assert words in run.meta["notes"]


@pytest.mark.parametrize(("unit", "name"), [(1e-9, "nanoseconds"), (1e3, "thousands of seconds")])
def test_scan_time_in_another_unit_tells_that_of_the_time_increment(
    unit: float, name: str, tmp_path: Path
) -> None:
    """As of the drivers of YDLIDAR (ns) and RPLIDAR (thousandths)."""
    run = logs.read(spinning(tmp_path, PERIOD / N_RAYS / unit, scan_time=PERIOD / unit))
    assert run.sensor.sweep_time == pytest.approx(PERIOD, rel=1e-6)  # float32
    assert float(run.meta["scan_time"]) == pytest.approx(PERIOD, rel=1e-5)
    assert f"are in {name}, as a scan is taken every 0.1 s: rescaled" in run.meta["notes"]
    assert not any("sweep" in line for line in inspect(tmp_path / "bag").warnings)


def test_robot_yaml_overrules_the_log_and_inspect_says_that_they_disagree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = spinning(tmp_path, 3e-5)
    run = logs.read(bag)
    assert with_sweep_of(run, ROBOT).sensor.sweep_time == 0.1
    clockwise = replace(run, sensor=replace(run.sensor, sweep_time=-0.05))
    assert with_sweep_of(clockwise, ROBOT).sensor.sweep_time == -0.1
    agreeing = with_sweep_of(run, ROBOT)
    assert with_sweep_of(agreeing, ROBOT) is agreeing and sweep_warning(agreeing, ROBOT) is None
    (tmp_path / "robot.yaml").write_text(ROBOT.text)
    assert command(["inspect", str(bag), "--robot", str(tmp_path / "robot.yaml")]) == 0
    said = capsys.readouterr().out
    assert "WARNING: a sweep takes 0.00108 s in the log and 0.1 s in" in said


def test_rays_from_zero_to_a_turn_are_those_from_behind_to_behind() -> None:
    step = 2 * np.pi / N_RAYS
    behind, ahead = -np.pi + step * np.arange(N_RAYS), step * np.arange(N_RAYS)
    order = ray_order(behind, ahead)
    assert order is not None
    np.testing.assert_allclose(np.exp(1j * behind[order]), np.exp(1j * ahead), atol=1e-9)
    for off in (1e-9, -1e-9):
        np.testing.assert_array_equal(ray_order(ahead, ahead + off), np.arange(N_RAYS))
    assert ray_order(behind, ahead + 0.3 * step) is None
    assert ray_order(behind, behind[1:]) is None


def test_run_that_we_recorded_is_taken_at_its_word() -> None:
    sensor = RangeSensor(bearings=np.linspace(-np.pi, np.pi, 90, endpoint=False), rate=5.0)
    run = Run(sensor=sensor, stamps=np.arange(3) / 5, ranges=np.ones((3, 90)))
    assert not [line for line in logs.inspection.warnings_of(run) if "sweep" in line]


@pytest.mark.parametrize("logged", [0.0, 0.04, 0.1])
def test_every_ray_of_a_clockwise_laser_is_taken_when_the_robot_file_says(
    tmp_path: Path, logged: float
) -> None:
    """The laser takes 36 rays in 0.1 s, the first at the stamp; the log says that it takes `logged`."""
    bag = spinning(tmp_path, logged / N_RAYS, clockwise=True)
    run = with_sweep_of(logs.read(bag), ROBOT)
    when = run.epoch_ns / 1e9 + run.stamps[0] + run.sensor.ray_delays
    first = when[-1]  # bearings increase, so the ray that was taken first is the last
    np.testing.assert_allclose(when - first, PERIOD * np.arange(N_RAYS)[::-1] / N_RAYS, atol=1e-6)
    counter = logs.read(spinning(tmp_path / "counter", logged / N_RAYS))
    assert first == pytest.approx(counter.epoch_ns / 1e9 + counter.stamps[0], abs=1e-6)
    assert run.sensor.is_clockwise and run.sensor.sweep_share[-1] == 0.0
