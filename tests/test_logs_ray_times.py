"""The times of the rays of a scan: one sweep, interlaced sweeps, and a stamp that is not the first ray's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_building_sweep import N_RAYS, path, run_of

import logs
from logs.motion import Motion
from logs.run import RangeSensor, pair
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.world.robot import default_robot, parse_robot
from sensorgraph.world.sweep import sweep_warning, with_sweep_of

SENSOR = RangeSensor(
    bearings=np.linspace(-1.5, 1.5, 8),
    sweep_time=0.008,
    interlaced_sweeps=2,
    sweep_period=0.0125,
    first_ray_delay=-0.01,
)
YAML = "sensor: {n_rays: 8, fov: 3.0, sweep_time: 0.008, interlaced_sweeps: 2, sweep_period: 0.0125, first_ray_delay: -0.01}"


def test_rays_take_turns_between_interlaced_sweeps() -> None:
    expected = [-0.010, 0.0035, -0.008, 0.0055, -0.006, 0.0075, -0.004, 0.0095]
    np.testing.assert_allclose(SENSOR.ray_delays, expected, atol=1e-12)
    np.testing.assert_allclose(parse_robot(YAML).sensor.ray_delays, expected, atol=1e-12)
    assert SENSOR.scan_duration == pytest.approx(0.0205)


def test_some_of_the_rays_keep_their_turns_or_are_one_sweep() -> None:
    assert SENSOR.take(slice(2, 6)).interlaced_sweeps == 2
    odd = SENSOR.take(slice(1, None, 2))
    assert (odd.interlaced_sweeps, odd.sweep_period) == (1, 0.0)


@pytest.mark.parametrize("ending", [".mcap", ".csv"])
def test_files_keep_the_times(tmp_path: Path, ending: str) -> None:
    run = run_of(0, duration=3.0)
    timed = replace(SENSOR, bearings=run.sensor.bearings, sweep_time=0.008, range_max=3.5)
    logs.write(replace(run, sensor=timed), tmp_path / f"run{ending}")
    again = logs.read(tmp_path / f"run{ending}").sensor
    np.testing.assert_array_equal(again.ray_delays, timed.ray_delays)


def test_graph_keeps_the_times(tmp_path: Path) -> None:
    run = run_of(0, duration=10.0)
    timed = replace(run.sensor, sweep_time=0.1, interlaced_sweeps=2, sweep_period=0.1)
    graph = build([replace(run, sensor=timed)], model="polynomial", degree=1, harmonics=1, n_terms=4)
    graph.save(tmp_path / "g.sensorgraph")
    np.testing.assert_array_equal(
        Sensorgraph.load(tmp_path / "g.sensorgraph").sensor.ray_delays, timed.ray_delays
    )


@pytest.mark.parametrize(
    "text",
    [
        "interlaced_sweeps: 2",
        "sweep_period: 0.0133",
        "sweep_time: 0.02, interlaced_sweeps: 2, sweep_period: 0.0133",
    ],
)
def test_interlaced_sweeps_that_cannot_be_are_refused_in_a_line(text: str) -> None:
    with pytest.raises(SensorgraphError, match=r"interlaced_sweeps is .*sweep_period .*expected") as caught:
        parse_robot(f"sensor: {{{text}}}")
    assert "\n" not in str(caught.value)
    assert default_robot().sensor.interlaced_sweeps == 1


def test_robot_file_overrules_the_times_of_a_log() -> None:
    run = run_of(0, duration=3.0, sweep_time=0.0)
    robot = parse_robot(YAML)
    assert "sweep" in (sweep_warning(run, robot) or "")
    np.testing.assert_allclose(
        with_sweep_of(run, robot).sensor.ray_delays[:2], [-0.01, -0.01 + 0.008 / N_RAYS + 0.0125]
    )


def test_scan_that_begins_before_the_poses_is_dropped() -> None:
    run = run_of(5, duration=10.0, sweep_time=0.0)
    late = replace(run, sensor=replace(run.sensor, first_ray_delay=-0.05))
    assert pair(run).paired[0] and not pair(late).paired[0]
    assert pair(late).dropped["sweeping beyond the poses"] == 1


def test_motion_keeps_a_steady_velocity_and_bears_stamps_in_bursts() -> None:
    stamps = np.arange(0.0, 20.0, 0.2)
    motion, times = Motion(stamps=stamps, poses=path(stamps)), np.linspace(1.0, 18.0, 400)
    straight = np.stack([np.interp(times, stamps, column) for column in path(stamps).T], axis=-1)
    assert np.abs(motion.at(times) - path(times)).max() < 0.5 * np.abs(straight - path(times)).max()
    bursts = np.sort(np.concatenate([stamps, stamps[1:] - 0.199]))  # 1 ms after the one before
    line = Motion(stamps=bursts, poses=np.column_stack([np.arange(len(bursts))] * 3) * 0.1)
    assert (np.diff(line.at(np.linspace(0.0, 19.8, 5000)), axis=0) >= 0).all()  # never beyond the next pose


def test_motion_continues_for_one_step_beyond_its_ends() -> None:
    """Without odometry, the rays of the last scan are beyond the last pose."""
    stamps = np.arange(0.0, 3.0, 0.1)
    motion = Motion(stamps=stamps, poses=path(stamps))
    for end, beyond in ((0.0, -0.1), (stamps[-1], 0.1)):
        there = motion.at(end + beyond * np.array([0.5, 1.0, 5.0]))
        kept = np.abs(motion.at(end) - path(np.array(end + beyond)))
        assert (np.abs(there[1] - path(np.array(end + beyond))) < 0.2 * kept + 1e-3).all()
        np.testing.assert_allclose(there[2], there[1])
    burst = Motion(
        stamps=np.append(stamps, stamps[-1] + 1e-5), poses=path(np.append(stamps, stamps[-1] + 0.1))
    )
    moved = np.abs(burst.at(stamps[-1] + 0.1) - burst.poses[-1])
    assert (moved < 2.5 * np.abs(path(stamps[-1:] + 0.1) - path(stamps[-1:]))).all()
