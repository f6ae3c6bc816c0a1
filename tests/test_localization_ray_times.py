"""When each ray was taken, found from scans of a robot that turns: interlaced sweeps, one sweep, or none."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import further
from localization_samples import ROOM, seen
from localization_samples import looking_about as path

from logs.run import RangeSensor, Run
from logs.transforms import compose, invert, wrap
from sensorgraph.diagnosis.motion.calibration.estimate import calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import laser_motion
from sensorgraph.localization.locate import locate, located_run, summary
from sensorgraph.localization.ray_times import _judge, hypotheses
from sensorgraph.localization.result import Localization
from sensorgraph.localization.scan_lag import ScanLag, with_stamp_of
from sensorgraph.localization.tracked_run import TrackedRun, track_run
from sensorgraph.show.figures.localization import _returns
from sensorgraph.types import Floats

N_RAYS, RATE, SECONDS, SIGMA = 120, 5.0, 60.0, 0.01
BEARINGS = np.linspace(-np.pi / 2, np.pi / 2, N_RAYS)
LMS = 1 / 75  # [s] a turn of the mirror
HALF = LMS / 2 * N_RAYS / (N_RAYS - 1)  # [s] a sweep over 180°, plus a ray


GIVEN = {"ray_times": "robot.yaml"}
"""Of a run whose ray times a robot.yaml states, which are used as they are."""


def run_of(times: Floats, seed: int = 0) -> Run:
    """Return a run whose rays were taken at their times (n_rays,) [s] after the stamp, which the log does not say."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, SECONDS, 1 / RATE)
    ranges = np.concatenate(
        [seen(path(stamps + times[i]), BEARINGS[i : i + 1]) for i in range(N_RAYS)], axis=1
    )
    return Run(
        sensor=RangeSensor(bearings=BEARINGS, range_max=20.0, sigma=SIGMA, rate=RATE),
        stamps=stamps,
        ranges=ranges + SIGMA * rng.normal(size=ranges.shape),
        odom_stamps=stamps,
        odometry=path(stamps),
        odom_twists=np.zeros((len(stamps), 2)),
    )


def interlaced(way: float = 1.0) -> Floats:
    ray = np.arange(N_RAYS)
    return way * HALF * ray / N_RAYS + np.where(ray % 2 == 1, LMS, 0.0)


@pytest.fixture(autouse=True)
def _sought(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the search for older rays, a fit or more of the track, in the quick suite; it has tests of its own."""
    if request.node.get_closest_marker("slow") is None:
        monkeypatch.setattr("sensorgraph.localization.tracked_run.identify_older_rays", lambda *_: None)


def followed(run: Run) -> TrackedRun:
    return track_run(run)


def scatter(found: TrackedRun) -> float:
    """Return the scatter [m] of the returns of scans around the key frames before."""
    return float(np.nanmedian(found.track.noise))


@cache
def followed_at_once() -> TrackedRun:
    """Return the track of a run whose rays were all taken at the stamp."""
    return followed(run_of(np.zeros(N_RAYS)))


@cache
def run_as_stated() -> Run:
    """Return a run whose log states its ray times as they are."""
    return stated(run_of(ALONG), SWEEP)


@cache
def followed_as_stated() -> TrackedRun:
    return followed(run_as_stated())


@pytest.fixture(scope="module")
def two_sweeps() -> TrackedRun:
    return followed(run_of(interlaced()))


def test_interlaced_sweeps_are_found_and_named(two_sweeps: TrackedRun) -> None:
    sensor = two_sweeps.run.sensor
    assert sensor.interlaced_sweeps == 2
    assert sensor.sweep_period == pytest.approx(LMS)
    assert sensor.sweep_time == pytest.approx(HALF)
    # all but their mean, which scans alone do not tell
    np.testing.assert_allclose(
        sensor.ray_delays - sensor.ray_delays.mean(), interlaced() - interlaced().mean(), atol=1e-9
    )
    (line,) = two_sweeps.notes
    assert line.startswith("a scan is 2 interlaced sweeps of 6.7 ms, +13.3 ms apart, as in SICK LMS 2xx")
    assert " ± " in line and line.count(" ms") == 3


def test_with_its_times_the_scatter_is_the_noise_and_without_it_is_not(two_sweeps: TrackedRun) -> None:
    at_once = scatter(followed_at_once())
    assert scatter(two_sweeps) < 1.05 * at_once
    blind = two_sweeps.run.sensor.take(slice(None))
    at_stamp = replace(blind, sweep_time=0.0, interlaced_sweeps=1, sweep_period=0.0, first_ray_delay=0.0)
    run = replace(run_of(interlaced()), sensor=at_stamp, meta=GIVEN)
    assert scatter(followed(run)) > 1.12 * at_once


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "sweep_time", "name"),
    [
        (-HALF * np.arange(N_RAYS) / N_RAYS, -HALF, "SICK LMS"),
        (3 * HALF * np.arange(N_RAYS) / N_RAYS, 3 * HALF, "SICK PLS"),
        (15 * HALF * np.arange(N_RAYS) / N_RAYS, 15 * HALF, "turns once per scan"),
    ],
    ids=["LMS upside down", "PLS", "spinning"],
)
def test_one_sweep_is_found_with_its_direction(times: Floats, sweep_time: float, name: str) -> None:
    found = followed(run_of(times))
    assert found.run.sensor.sweep_time == pytest.approx(sweep_time)
    assert found.run.sensor.interlaced_sweeps == 1
    assert name in found.notes[0]


def test_rays_of_one_time_are_left_so() -> None:
    found = followed_at_once()
    assert found.notes == () and not found.run.sensor.has_ray_delays


def stated(run: Run, sweep_time: float, first_ray_delay: float = 0.0) -> Run:
    """Return the run with ray times that the log states."""
    return replace(run, sensor=replace(run.sensor, sweep_time=sweep_time, first_ray_delay=first_ray_delay))


SWEEP = 0.1  # [s] of a lidar that turns ten times a second
ALONG = SWEEP * np.arange(N_RAYS) / N_RAYS


def test_true_ray_times_of_a_log_stay() -> None:
    found = followed_as_stated()
    assert found.run.sensor is run_as_stated().sensor and found.notes == ()


@pytest.mark.parametrize(
    ("times", "sweep_time", "words"),
    [
        (ALONG[::-1], -SWEEP, "opposite to the log"),
        *further((np.zeros(N_RAYS), 0.0, "all rays of a scan have the time of its stamp")),
    ],
    ids=["reversed array", "no sweep"],
)
def test_ray_times_that_the_run_contradicts_are_mended_and_said(
    times: Floats, sweep_time: float, words: str
) -> None:
    run = stated(run_of(times), SWEEP)
    found = followed(run)
    assert found.run.sensor.sweep_time == pytest.approx(sweep_time)
    assert words in found.notes[0] and "the log states 100.0 ms" in found.notes[0]
    np.testing.assert_allclose(found.run.sensor.ray_delays, times, atol=2e-3)
    assert scatter(found) < 1.1 * scatter(followed_as_stated())


def test_a_stamp_at_the_end_of_the_sweep_shows_against_the_odometry() -> None:
    found = followed(stated(run_of(ALONG - SWEEP), SWEEP))
    assert found.run.sensor.first_ray_delay == pytest.approx(-ALONG[-1])
    assert "stamped at the end of the sweep" in found.notes[-1]


@pytest.mark.parametrize(
    ("first", "last"), [(15.0, 45.0), *further((0.0, 59.75))], ids=["half the log", "all but the end"]
)
def test_scans_beyond_the_odometry_show_no_lag_and_are_placed_as_well(first: float, last: float) -> None:
    run = run_as_stated()
    keep = (run.odom_stamps >= first) & (run.odom_stamps <= last)
    cut = replace(
        run, odom_stamps=run.odom_stamps[keep], odometry=run.odometry[keep], odom_twists=run.odom_twists[keep]
    )
    found = followed(cut)
    assert found.run.sensor is run.sensor
    assert not any("lag" in note or "stamped" in note for note in found.notes)
    truth = path(run.stamps)
    off = compose(invert(compose(truth[150], invert(found.track.poses[150]))), truth) - found.track.poses
    assert np.hypot(*off[:, :2].T).max() < 0.03
    assert np.abs(wrap(off[:, 2])).max() < np.radians(0.6)


@pytest.mark.parametrize(
    ("lag", "where"),
    [(-0.155, "end"), (-0.12, "end"), (-0.065, "middle"), (-0.092, ""), (0.03, ""), (-0.25, ""), (-0.03, "")],
)
def test_latency_of_the_odometry_leaves_a_stamp_where_drivers_put_it(lag: float, where: str) -> None:
    run = stated(run_of(np.zeros(N_RAYS)), 0.125)
    shifted, (note,) = with_stamp_of(run, ScanLag(value=lag, stderr=0.001))
    if where:
        assert f"stamped at the {where} of the sweep of 125 ms" in note
        assert shifted.sensor.first_ray_delay < run.sensor.first_ray_delay
    else:
        assert "poses are given at the stamps" in note and shifted is run


def test_scans_without_wheels_are_deskewed_by_the_velocity_of_the_track() -> None:
    run = run_as_stated()
    alone = replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))
    found = followed(alone)
    assert found.notes == () and found.odometry is None
    assert scatter(found) < 1.1 * scatter(followed_as_stated())
    rigid = replace(alone, sensor=replace(run.sensor, sweep_time=0.0), meta=GIVEN)
    assert scatter(found) < 0.8 * scatter(followed(rigid))


def test_a_picture_draws_each_ray_from_where_the_robot_was_at_its_time() -> None:
    run = run_as_stated()
    truth = Localization(
        t=run.stamps,
        poses=path(run.stamps),
        covariances=np.zeros((run.n_scans, 3, 3)),
        status=("ok",) * run.n_scans,
    )
    drawn = _returns(run, truth, np.arange(1, run.n_scans - 1))
    a, b = np.array(ROOM)[:, :2], np.array(ROOM)[:, 2:]
    along = np.clip(((drawn[:, None] - a) * (b - a)).sum(axis=2) / ((b - a) ** 2).sum(axis=1), 0.0, 1.0)
    off = np.hypot(*np.moveaxis(drawn[:, None] - a - along[..., None] * (b - a), 2, 0)).min(axis=1)
    assert np.sqrt(np.mean(off**2)) < 1.1 * SIGMA  # 6 cm if all rays of a scan start from one pose


@pytest.mark.slow
def test_located_run_carries_the_times_and_poses_lie_where_they_were() -> None:
    run = run_of(interlaced())
    found = locate(run)
    assert found.sensor is not None and located_run(run, found).sensor.interlaced_sweeps == 2
    assert summary(found)["ray_times"]["sweep_period"] == pytest.approx(LMS)
    truth = path(run.stamps + interlaced().mean())
    truth[:, 2] -= truth[0, 2] - found.poses[0, 2]
    off = (found.poses[:, 2] - truth[:, 2] + np.pi) % (2 * np.pi) - np.pi
    assert np.std(off) < np.radians(0.1)


@pytest.mark.slow
def test_a_drive_of_half_a_minute_shows_its_ray_times() -> None:
    """Its key frames are taken closer together, so that there are enough for the pieces."""
    sweep = 0.15
    run = run_of(-sweep * np.arange(N_RAYS) / N_RAYS).take_scans(slice(0, 110))
    run = replace(run, sensor=replace(run.sensor, sweep_time=sweep))
    kept = followed(run)
    assert kept.run.sensor.sweep_time == pytest.approx(-sweep, rel=0.05)
    assert "clockwise" in kept.notes[0] and "the log states 150.0 ms" in kept.notes[0]


@pytest.mark.slow
def test_opposite_times_of_a_slow_laser_are_mended_though_the_first_step_is_wide() -> None:
    """A scan smeared by 0.2 s the wrong way hides most of the effect, so that the first step seems to confirm the log."""
    sweep = 1 / RATE
    run = stated(run_of(-sweep * np.arange(N_RAYS) / N_RAYS), sweep)
    found = followed(run)
    assert found.run.sensor.sweep_time == pytest.approx(-sweep)
    assert "opposite to the log" in found.notes[0]


@pytest.mark.slow
def test_scans_without_wheels_keep_their_heading_where_the_turn_changes() -> None:
    """Velocities from the differences of the poses at the stamps would alternate from scan to scan."""
    sweep = 1 / RATE
    run = stated(run_of(sweep * np.arange(N_RAYS) / N_RAYS), sweep)
    found = followed(
        replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))
    )
    assert found.run.sensor.sweep_time == sweep
    off = np.unwrap(found.track.poses[:, 2]) - np.unwrap(path(run.stamps)[:, 2])
    assert np.std(off) < np.radians(0.13)


def test_wheels_are_compared_with_scans_that_have_the_times_which_the_run_shows() -> None:
    run = run_of(-SWEEP * np.arange(N_RAYS) / N_RAYS)
    located = replace(
        stated(run, -SWEEP), pose_stamps=run.stamps, poses=path(run.stamps), pose_frame="base_link"
    )
    found = calibrate(laser_motion(run, located))
    assert found.of("turn_scale")[0] == pytest.approx(1.0, abs=1e-3)
    assert found.of("delay")[0] == pytest.approx(0.0, abs=0.002)


def test_a_laser_that_sees_a_full_turn_and_a_ray_more_has_candidates() -> None:
    sensor = RangeSensor(
        bearings=np.linspace(-np.pi, np.pi, 1440) * (1 + 1e-9), range_max=20.0, sigma=0.01, rate=10.0
    )
    for _, one in hypotheses(sensor):
        assert abs(one.sweep_time) <= 0.1 + 1e-12


def test_a_long_lag_is_found_whole_and_the_odometry_is_taken_at_the_times_of_the_scans() -> None:
    run = run_of(np.zeros(N_RAYS))
    found = followed(replace(run, odom_stamps=run.odom_stamps + 0.2, meta={}))
    (note,) = (note for note in found.notes if "lag of the scans" in note)
    value = float(re.search(r"odometry: \+(\d+)", note)[1])  # type: ignore[index]
    assert value == pytest.approx(200, abs=12)
    assert found.odometry is not None
    inside = slice(5, -5)
    off = wrap(found.odometry[:, 2] - path(run.stamps)[:, 2])[inside]
    assert np.abs(off - off.mean()).max() < 0.03


def test_clocks_that_drift_apart_say_nothing_of_where_a_sweep_is_stamped() -> None:
    """The mean lag of 50 ms is that of a stamp in the middle of the sweep of 0.1 s."""
    run = run_as_stated()
    found = followed(replace(run, odom_stamps=run.odom_stamps + 0.1 * (run.odom_stamps / SECONDS - 1.0)))
    (note,) = (note for note in found.notes if "lag of the scans" in note)
    drift = float(re.search(r"drifting by \+(\d+)", note)[1])  # type: ignore[index]
    assert drift == pytest.approx(100, abs=10)
    assert found.run.sensor is run.sensor


def test_a_small_error_of_the_delays_of_classes_does_not_keep_an_invented_sweep() -> None:
    """The run shows no sweep; 0.4 ms between the ray classes is 3 % of a mirror period, and the motion has an error of 10 %."""
    stated = replace(run_of(np.zeros(N_RAYS)).sensor, sweep_time=0.1)
    values, errors = np.array([-0.7e-3, 0.0, 0.4e-3, 0.1e-3]), np.array([1.4e-3, 6e-5, 6e-5, 6e-5])
    found = _judge(stated, values, errors, np.diag(errors**2))
    assert found is not None and abs(found.sensor.sweep_time) < 2e-3
    values[[1, 3]] = LMS  # a whole period, as of interlaced sweeps
    found = _judge(stated, values, errors, np.diag(errors**2))
    assert found is None or found.sensor.interlaced_sweeps > 1
