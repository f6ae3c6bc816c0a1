"""A driver that believes in another angle between rays; wheels that turn too much, and a sweep, are not that."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import further
from localization_samples import loop_poses, room_run, seen

from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization import tracked_run
from sensorgraph.localization.bearing_scale import estimated_scale
from sensorgraph.localization.locate import locate, located_run
from sensorgraph.localization.range_offset import OffsetOfRanges
from sensorgraph.localization.turning_pieces import TimeEstimate, TurningPieces, sweep_basis
from sensorgraph.types import Floats

TRUTH = loop_poses(200)
FOV = np.radians(270.0)


def front() -> Run:
    """Return a run of a laser that sees 270 degrees."""
    run = room_run(TRUTH, n_rays=160)
    seen = np.abs(run.sensor.bearings) <= FOV / 2
    sensor = replace(run.sensor, bearings=run.sensor.bearings[seen])
    ranges = np.ascontiguousarray(run.ranges[:, seen])  # kernels are compiled for rows, as of a log
    return replace(run, sensor=sensor, ranges=ranges)


@pytest.fixture(params=["bearings", *further("bearings and older rays")])
def _sought(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the search for older rays, four fifths of the time, which the claim is not about, in the quick suite."""
    if request.param == "bearings":
        monkeypatch.setattr("sensorgraph.localization.tracked_run.identify_older_rays", lambda *_: None)


@pytest.mark.usefixtures("_sought")
@pytest.mark.parametrize(("factor", "kept"), [(1.03, 0), *further((0.975, 60), (1.03, -1))])
def test_a_wrong_step_of_the_bearings_is_found_and_corrected(factor: float, kept: int) -> None:
    run = front()
    true = run.sensor.bearings
    stated = true[kept] + factor * (true - true[kept])
    run = replace(run, sensor=replace(run.sensor, bearings=stated))
    found = locate(run)
    assert any("step of the bearings" in note for note in found.notes)
    off = compose(compose(TRUTH[0], invert(found.poses[0])), found.poses) - TRUTH
    assert np.hypot(*off[:, :2].T).max() < 0.03  # [m] three times the noise of a range
    assert np.abs(wrap(off[:, 2])).max() < np.radians(0.5)
    # [rad] 0.2 % of the field of view
    np.testing.assert_allclose(located_run(run, found).sensor.bearings, true, atol=0.01)


@pytest.mark.usefixtures("_sought")
@pytest.mark.parametrize("factor", [1.04, *further(0.95, 1.0)])
def test_wheels_that_turn_too_much_leave_the_bearings_as_stated(factor: float) -> None:
    run = front()
    steps = compose(invert(run.odometry[:-1]), run.odometry[1:]) * [1.0, 1.0, factor]
    odometry = [run.odometry[0]]
    for step in steps:
        odometry.append(compose(odometry[-1], step))
    found = locate(replace(run, odometry=np.array(odometry)))
    assert not any("step of the bearings" in note for note in found.notes)


@pytest.mark.slow
def test_the_scans_alone_show_it_and_the_first_bearing_is_believed() -> None:
    run = front()
    true = run.sensor.bearings
    stated = true[0] + 1.03 * (true - true[0])
    alone = replace(
        run,
        sensor=replace(run.sensor, bearings=stated),
        odom_stamps=np.zeros(0),
        odometry=np.zeros((0, 3)),
        odom_twists=np.zeros((0, 2)),
    )
    found = locate(alone)
    assert any("bearing of the first ray as stated" in note for note in found.notes)
    np.testing.assert_allclose(located_run(alone, found).sensor.bearings, true, atol=0.01)


@pytest.mark.slow
def test_a_sweep_that_the_log_does_not_state_leaves_the_bearings() -> None:
    """On a robot that always turns to the left, a sweep of 0.15 s narrows the view by 1.5 %."""
    run, laps = front(), 3.0
    n, bearings = len(run.stamps), run.sensor.bearings
    per_scan = n / (2 * np.pi * laps) / run.sensor.rate  # [s] per rad of the loop
    late = 0.15 * np.linspace(0.0, 1.0, len(bearings)) / per_scan  # [rad] of the loop
    columns = []
    for bearing, more in zip(bearings, late, strict=True):
        t = np.linspace(0.0, 2 * np.pi * laps, n) + more
        poses = np.column_stack([3.2 + 1.5 * np.cos(t), 2.6 + 1.5 * np.sin(t), t + np.pi / 2])
        columns.append(seen(poses, np.array([bearing])))
    noise = 0.01 * np.random.default_rng(1).normal(size=run.ranges.shape)
    odometry = compose(invert(loop_poses(n, laps=laps)[0]), loop_poses(n, laps=laps))
    odometry[:, 2] = np.unwrap(odometry[:, 2])
    swept = replace(run, ranges=np.concatenate(columns, axis=1) + noise, odometry=odometry)
    assert not any("step of the bearings" in note for note in locate(swept).notes)


def test_a_view_that_shows_any_step_leaves_the_bearings() -> None:
    """In a narrow view one step of the estimate may turn the order of the rays round."""
    sensor = front().sensor

    class Anything:
        def estimate(self, basis: Floats, bearings: Floats) -> TimeEstimate:
            k = basis.shape[1] + bearings.shape[1]
            one = np.eye(k)
            return TimeEstimate(
                change=np.full(k, -1.2),
                covariance=one,
                information=one,
                range_offset=0.0,
                range_offset_sd=1.0,
            )

    start: Any = Anything()
    motion: Any = None
    assert estimated_scale(sensor, start, start, motion) is None


@pytest.mark.slow
@pytest.mark.usefixtures("_sought")
def test_a_robot_that_only_spins_leaves_the_bearings() -> None:
    turn = np.linspace(0, 2 * np.pi, 60)
    run = room_run(np.column_stack([np.full(60, 2.0), np.full(60, 1.5), turn]))
    alone = replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))
    assert not any("step of the bearings" in note for note in locate(alone).notes)


def test_noise_of_the_ranges_neither_stretches_nor_delays_the_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of a range is in its residual and in the derivatives at the measured point: their product has a mean."""
    found: list[TimeEstimate] = []

    def estimated(
        sensor: RangeSensor, pieces: TurningPieces, motion: Motion, _: float | None, *, is_given: bool
    ) -> Any:
        bearings = (sensor.bearings - sensor.bearings.mean())[:, None]
        start = pieces.linearised(sensor.ray_delays, motion)
        found.append(start.estimate(sweep_basis(sensor.n_rays), bearings))
        return sensor, OffsetOfRanges(), ()

    monkeypatch.setattr(tracked_run, "_corrected", estimated)
    run = room_run(loop_poses(120), n_rays=360, sigma=0.03, seed=1)
    ahead = np.abs(run.sensor.bearings) <= np.pi / 2
    sensor = replace(run.sensor, bearings=run.sensor.bearings[ahead])
    tracked_run.track_run(replace(run, sensor=sensor, ranges=np.ascontiguousarray(run.ranges[:, ahead])))
    errors = found[0].change / np.sqrt(np.diag(found[0].covariance))
    assert np.abs(errors[[0, -1]]).max() < 3  # sweep, and step of the bearings
