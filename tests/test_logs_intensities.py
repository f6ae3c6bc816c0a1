"""Intensities: read with the ranges they belong to, kept in our files, shown by `inspect`."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag1_samples import Sample, bag20, header
from logs_samples import some_run
from rosbag_samples import EPOCH, Message, message, read, scan, transform, write_bag2

import logs
from logs import stream
from logs.recovery import recover
from logs.ros.recording import SCAN_TYPE
from sensorgraph.cli import run as command


def bright(
    stamp: float, n: int = 5, *, increment: float = 0.25, frame: str = "laser", topic: str = "/scan"
) -> Message:
    """A scan whose intensities are ten times its ranges."""
    ranges = 1.0 + np.arange(n) + stamp
    limits = [-0.5, -0.5 + increment * (n - 1), increment, 0.0, 0.1, 0.1, 20.0]
    return message(
        topic, SCAN_TYPE, stamp, {"frame_id": frame}, limits=limits, ranges=ranges, intensities=10 * ranges
    )


def assert_ten_times(run: logs.Run) -> None:
    known = np.isfinite(run.intensities)
    np.testing.assert_allclose(run.intensities[known], 10 * run.ranges[known], rtol=1e-6)


@pytest.mark.parametrize(
    ("increment", "roll"), [(0.25, 0.0), (-0.25, 0.0), (0.25, np.pi), (2 * np.pi / 5, 0.0)]
)
def test_an_intensity_stays_with_its_ray(increment: float, roll: float, tmp_path: Path) -> None:
    """Also of a laser that sweeps clockwise, is upside down, or repeats its first ray after a turn."""
    n = 6 if increment > 1 else 5
    tree = [transform(0, "base_link", "laser", 0, 0, 0, roll=roll, static=True)]
    run = read(tmp_path, [*tree, *(bright(0.1 * i, n, increment=increment) for i in range(4))])
    assert run.intensities.shape == run.ranges.shape == (4, 5)
    assert np.isfinite(run.intensities).all()
    assert_ten_times(run)


def test_scans_of_another_geometry_and_without_intensities_are_kept(tmp_path: Path) -> None:
    bag = [bright(0.1 * i) for i in range(4)] + [scan(0.5, [1, 2, 3, 4, 5]), bright(0.6, 3)]
    run = read(tmp_path, bag)
    assert np.isnan(run.intensities[4]).all()
    assert np.isfinite(run.intensities[5, :3]).all() and np.isnan(run.intensities[5, 3:]).all()
    assert_ten_times(run)


def test_two_lasers_as_one_keep_their_intensities(tmp_path: Path) -> None:
    tree = [
        transform(0, "base_link", frame, 0.1 * k, 0, 2.0 * k, static=True) for k, frame in enumerate("ab")
    ]
    bag = [bright(0.1 * i, frame="a", topic="/front") for i in range(3)]
    bag += [bright(0.1 * i, frame="b", topic="/rear") for i in range(3)]
    run = read(tmp_path, [*tree, *bag], scan="/front,/rear")
    assert run.intensities.shape == (3, 10)
    assert_ten_times(run)


@pytest.mark.parametrize("value", [0.0, 47.0])
def test_a_constant_intensity_is_none(value: float, tmp_path: Path) -> None:
    limits = [-0.5, 0.5, 0.25, 0.0, 0.1, 0.1, 20.0]
    bag = [
        message("/scan", SCAN_TYPE, 0.1 * i, {"frame_id": "laser"}, limits=limits, ranges=[1, 2, 3, 4, 5],
                intensities=np.full(5, value))
        for i in range(3)
    ]  # fmt: skip
    assert read(tmp_path, bag).intensities.shape == (0, 5)


def test_intensities_survive_writing_and_reading(tmp_path: Path) -> None:
    run = some_run()
    assert run.intensities.shape == (0, run.sensor.n_rays)
    rng = np.random.default_rng(0)
    known = rng.uniform(0, 300, run.ranges.shape).astype(np.float32).astype(np.float64)
    known[0, :3] = np.nan
    logs.write(replace(run, intensities=known), tmp_path / "run.mcap")
    again = logs.read(tmp_path / "run.mcap")
    np.testing.assert_array_equal(again.intensities, known)
    np.testing.assert_array_equal(again.ranges, logs.read(tmp_path / "run.mcap").ranges)
    pieces = list(stream.open_log(tmp_path / "run.mcap").pieces())
    np.testing.assert_array_equal(np.concatenate([piece.intensities for piece in pieces]), known)
    logs.write(run, tmp_path / "none.mcap")
    assert logs.read(tmp_path / "none.mcap").intensities.shape == (0, run.sensor.n_rays)
    recover(tmp_path / "run.mcap", tmp_path / "saved.mcap")
    np.testing.assert_array_equal(logs.read(tmp_path / "saved.mcap").intensities, known)


def test_a_recorder_writes_them(tmp_path: Path) -> None:
    run = some_run(3)
    with logs.Recorder(tmp_path / "run.mcap", sensor=run.sensor, epoch_ns=EPOCH) as recorder:
        for i in range(3):
            recorder.scan(0.1 * i, run.ranges[i], np.arange(run.sensor.n_rays))
    want = np.tile(np.arange(run.sensor.n_rays), (3, 1))
    np.testing.assert_array_equal(logs.read(tmp_path / "run.mcap").intensities, want)


def test_a_subset_of_the_scans_keeps_its_intensities(tmp_path: Path) -> None:
    run = read(tmp_path, [bright(0.1 * i) for i in range(6)])
    some = run.take_scans(slice(1, 4))
    assert some.n_scans == 3
    assert_ten_times(some)
    assert replace(run, stamps=run.stamps[:2], ranges=run.ranges[:2]).intensities.shape == (0, 5)


def test_ros_1_and_carmen_have_them_too(tmp_path: Path) -> None:
    ranges = np.float32([1, 2, 3])
    limits = struct.pack("<7f", -0.25, 0.25, 0.25, 0, 0.1, 0.1, 10)
    arrays = b"".join(struct.pack("<I", 3) + values.tobytes() for values in (ranges, 10 * ranges))
    samples = [
        Sample("/scan", "sensor_msgs/LaserScan", 1e9 + i, header(0, 1e9 + i, "l") + limits + arrays)
        for i in range(2)
    ]
    (tmp_path / "a.bag").write_bytes(bag20(samples))
    assert_ten_times(logs.read(tmp_path / "a.bag"))
    line = "RAWLASER1 1 -1.0 2.0 1.0 30.0 0.01 0 3 1.0 2.0 3.0 3 10 20 30 {} host {}"
    (tmp_path / "a.log").write_text("\n".join(line.format(i, i) for i in range(4)))
    run = logs.read(tmp_path / "a.log")
    assert run.intensities.shape == (4, 3)
    assert_ten_times(run)


def test_inspect_states_their_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag2(tmp_path / "bag", [bright(0.1 * i) for i in range(3)])
    assert command(["inspect", str(tmp_path / "bag")]) == 0
    assert "intensities from 10 to 52 (median 31), in the unit of the driver" in capsys.readouterr().out
