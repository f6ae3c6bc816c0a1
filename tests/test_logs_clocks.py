"""Clocks of a log: a planted difference is found with its size, corrected by the log times, and noted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import further
from rosbag_samples import EPOCH, Message, command, odometry, pose, scan, transform, write_bag2

import logs
from logs.clocks import settle
from logs.notes import assumptions_of
from logs.signals import Signal
from sensorgraph.diagnosis.motion.calibration.laser_motion import with_moving_odometry
from sensorgraph.errors import SensorgraphError

N = 200
T = 0.1 * np.arange(N)
"""[s] true times of the scans; the odometry is twice as fast."""
RNG = np.random.default_rng(5)
LATENCY = RNG.uniform(0.001, 0.03, 2 * N)
TOLERANCE = 0.02  # [s] variation of the latency


def drive(
    scans: Callable[[np.ndarray], np.ndarray] = lambda t: t,
    wheels: Callable[[np.ndarray], np.ndarray] = lambda t: t,
    log: Callable[[np.ndarray], np.ndarray] = lambda t: t,
) -> list[Message]:
    """A drive at 0.5 m/s, whose first range is the true time; each argument is a clock, a function of the true time."""
    times = np.repeat(T, 2)
    times[1::2] += 0.05
    out = [
        scan(float(a), [1 + t, 2, 3], log=float(b), range_max=100)
        for t, a, b in zip(T, scans(T), log(T + LATENCY[::2]), strict=True)
    ]
    out += [
        odometry(float(a), 0.5 * t, 0, 0, 0.5, log=float(b))
        for t, a, b in zip(times, wheels(times), log(times + LATENCY), strict=True)
    ]
    return sorted(out, key=lambda message: message[2])


def run_of(tmp_path: Path, messages: list[Message], **topics: str) -> logs.Run:
    return logs.read(write_bag2(tmp_path / "bag", messages), topics=topics or None)


def apart(run: logs.Run) -> np.ndarray:
    """Return the time by which the odometry is late at each scan, from the contents of the messages."""
    truth = run.ranges[:, 0] - 1
    driven = np.interp(run.stamps, run.odom_stamps, run.odometry[:, 0]) / 0.5
    inside = (run.stamps > run.odom_stamps[0]) & (run.stamps < run.odom_stamps[-1])
    return np.asarray((driven - truth)[inside])


def test_stamps_that_agree_are_never_changed(tmp_path: Path) -> None:
    run = run_of(tmp_path, drive(log=lambda t: 3 * t + 1e6))  # log times of another epoch and rate
    assert np.abs(apart(run)).max() < 1e-5  # float32 of the time
    np.testing.assert_allclose(run.stamps, T, atol=1e-6)
    assert "the header stamps run" not in run.meta.get("notes", "")


@pytest.mark.parametrize(
    ("clock", "words"),
    [
        (lambda t: t - 111.7, "/odom: the stamps are 111.7"),
        (lambda t: t + 1e8, "/odom: the stamps are 100,000,000"),
        (lambda t: 1.02 * t + 5, "drift by -0.4"),
        (lambda t: 1000 * t - EPOCH / 1e9, "/odom: the stamps are in milliseconds, not in seconds"),
        (
            lambda t: t - np.where(t > 9, 812.0, 0),
            "/odom: the clock was reset, 181 of 400 stamps differ by up to 812.0 s",
        ),
        (lambda t: 0 * t, "/odom: the 400 header stamps are all equal, the log times were used"),
        (lambda t: np.floor(t), "/odom: the 400 header stamps have only 20 different values"),
        (lambda t: 0 * t - EPOCH / 1e9, "/odom: 400 messages have stamp 0"),
        (lambda t: np.where(t == 5.0, 4000.0, t), "/odom: the clock was reset, 1 of 400 stamps"),
    ],
    ids=["offset", "epoch", "rate", "milliseconds", "reset", "equal", "coarse", "zero", "outlier"],
)
@pytest.mark.parametrize("epoch", [-2e5, *further(0.0)], ids=["log of another epoch", "one epoch"])
def test_clock_of_the_odometry_is_corrected_by_the_log_times(
    tmp_path: Path, clock: Callable[[np.ndarray], np.ndarray], words: str, epoch: float
) -> None:
    run = run_of(tmp_path, drive(wheels=clock, log=lambda t: t + epoch))
    assert np.abs(apart(run)).max() < 2 * TOLERANCE
    assert len(run.odom_stamps) == 2 * N
    assert any(words in note for note in assumptions_of(run)), run.meta["notes"]


def test_a_clock_keeps_its_rate_after_the_other_has_ended(tmp_path: Path) -> None:
    """The odometry goes on for 2 s; there its stamps are converted as before."""
    end = EPOCH + 1e9 * (T[-1] - 2)
    messages = [one for one in drive(wheels=lambda t: 0.5 * t + 3) if one[0] != "/scan" or one[2] < end]
    run = run_of(tmp_path, messages)
    steps = np.diff(run.odom_stamps)
    np.testing.assert_allclose(steps[-20:].mean(), steps[:-20].mean(), rtol=0.02)


def test_corrected_stamp_of_0_is_not_a_missing_one(tmp_path: Path) -> None:
    """The scans count from the start, in milliseconds; the odometry is brought to their clock, or they to its."""
    run = run_of(tmp_path, drive(scans=lambda t: 1000 * t - EPOCH / 1e9))
    assert np.abs(apart(run)).max() < 2 * TOLERANCE
    assert "stamp 0" not in run.meta["notes"].replace("/scan: 1 messages have stamp 0", "")
    assert "/scan: the stamps are in milliseconds" in run.meta["notes"]


def test_clock_of_the_scans_is_corrected_as_well(tmp_path: Path) -> None:
    for k, clock in enumerate((lambda t: t + 40.0, lambda t: t - np.where(t > 5, 30.0, 0))):
        run = run_of(tmp_path / str(k), drive(scans=clock))
        assert np.abs(apart(run)).max() < 2 * TOLERANCE
        np.testing.assert_allclose(np.diff(run.stamps), 0.1, atol=2 * TOLERANCE)


def test_latency_is_left_to_the_diagnosis(tmp_path: Path) -> None:
    run = run_of(tmp_path, drive(wheels=lambda t: t - 0.4))
    assert apart(run) == pytest.approx(0.4, abs=1e-5)
    note = "the stamps are 0.400 s behind those of /scan according to the log times"
    assert note[:20] in run.meta["notes"] and "which `diagnose` estimates" in run.meta["notes"]


def test_offset_without_log_times_that_decide_leaves_the_odometry_out(tmp_path: Path) -> None:
    bag = [scan(t, [1 + t, 2, 3], range_max=100) for t in T]
    bag += [odometry(t + 111.7, 0.5 * t, 0, 0) for t in T]
    run = run_of(tmp_path, bag)
    assert len(run.odom_stamps) == len(run.pose_stamps) == 0
    with pytest.raises(
        SensorgraphError, match=r"and scans do not overlap in time, .* was left out; the calibration"
    ):
        with_moving_odometry(run)
    assert (
        "odometry and scans do not overlap in time, by stamps and by log times: they are 91.8 s apart"
        in run.meta["notes"]
    )


def test_log_times_that_scatter_more_than_the_clocks_differ_decide_nothing(tmp_path: Path) -> None:
    late = np.random.default_rng(1).uniform(0, 4, N)
    bag = [scan(t, [1 + t, 2, 3], log=t + a, range_max=100) for t, a in zip(T, late, strict=True)]
    bag += [odometry(t, 0.5 * t, 0, 0, log=t + 0.01) for t in T]
    run = run_of(tmp_path, sorted(bag, key=lambda m: m[2]))
    assert np.abs(apart(run)).max() < 1e-5
    assert "which scatter by" in run.meta["notes"]


def test_commands_without_stamps_get_the_clock_of_the_scans(tmp_path: Path) -> None:
    bag = drive(log=lambda t: t - 7.6) + [command(t - 7.6, 0.5, 0) for t in T]
    run = run_of(tmp_path, sorted(bag, key=lambda m: m[2]))
    np.testing.assert_allclose(run.cmd_stamps, T, atol=0.05)
    assert "/cmd_vel: its messages have no stamp" in run.meta["notes"]
    assert "the log times are 7.58" in run.meta["notes"]


def test_transforms_of_another_clock_are_corrected_and_post_dated_ones_are_not(tmp_path: Path) -> None:
    """A localizer stamps map -> odom by up to some seconds in the future; odom -> base_link is a measurement."""
    mount = transform(0, "base_link", "laser", 0, 0, 0, static=True)
    scans = [scan(t, [1 + t, 2, 3], range_max=100) for t in T]
    for k, (early, left) in enumerate(((30.0, 0.0), (-1.5, 0.0), (-0.9, -0.9))):
        moving = [transform(t - early, "odom", "base_link", 0.5 * t, 0, 0, log=t + 0.01) for t in T]
        run = run_of(tmp_path / str(k), [mount, *scans, *moving])
        assert run.meta["odom_topic"] == "/tf odom -> base_link"
        assert np.median(apart(run)) == pytest.approx(left, abs=TOLERANCE)
    moving = [transform(t, "odom", "base_link", 0.5 * t, 0, 0, log=t + 0.01) for t in T]
    for k, (early, left) in enumerate(((30.0, 0.0), (-1.5, 1.5))):
        fix = [transform(t - early, "map", "odom", 0.1 * t, 0, 0, log=t + 0.01) for t in T]
        run = run_of(tmp_path / f"fix{k}", [mount, *scans, *moving, *fix])
        assert run.meta["pose_source"] == "/tf map -> base_link"
        late = np.median((0.6 * run.pose_stamps - run.poses[:, 0]) / 0.1)
        assert late == pytest.approx(left, abs=TOLERANCE)


def test_recorder_whose_clock_was_set_back_keeps_the_order_of_the_file(tmp_path: Path) -> None:
    """Header stamps and log times go back by 5 s together: sorted by stamp, two halves would be interleaved."""

    def back(t: np.ndarray) -> np.ndarray:
        return np.asarray(t - np.where(t >= 10.04, 5.0, 0.0))

    times = np.repeat(T, 2)
    times[1::2] += 0.05
    bag = [odometry(float(back(t)), 0.5 * t, 0, 0) for t in times]
    for k, t in reversed(list(enumerate(T))):
        bag.insert(2 * k, scan(float(back(t)), [1 + t, 2, 3], range_max=100))
    run = run_of(tmp_path, bag)
    assert (np.diff(run.ranges[:, 0]) > 0).all() and (np.diff(run.odometry[:, 0]) > 0).all()
    assert np.abs(apart(run)).max() < 0.06  # the length of the step is known to one period
    assert "the log times go back once, by 5.0 s" in run.meta["notes"]


def test_messages_that_are_there_twice_count_once(tmp_path: Path) -> None:
    bag = drive()
    wave = [pose(t, t, 0, 0) for t in T]
    plain = run_of(tmp_path / "a", [*bag, *wave])
    twice = run_of(tmp_path / "b", [*bag, *wave, *bag[::2], *wave[:7]])
    for name in ("stamps", "ranges", "odom_stamps", "odometry", "pose_stamps", "poses"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(plain, name))
    assert "/pose: 7 of 207 messages are there twice, the copies were dropped" in assumptions_of(twice)


def test_messages_that_arrive_late_keep_their_stamps(tmp_path: Path) -> None:
    late = np.random.default_rng(3)
    run = run_of(tmp_path, drive(log=lambda t: t + late.exponential(0.4, len(t))))  # a wireless network
    assert np.abs(apart(run)).max() < 1e-5  # float32 of the time
    np.testing.assert_allclose(run.stamps, T, atol=1e-6)
    assert "the clock was reset" not in run.meta.get("notes", "")


def test_parts_of_a_log_whose_clock_was_set_back_keep_the_order_of_the_file(tmp_path: Path) -> None:
    """The log times of the two parts overlap: they are not the order."""
    messages = sorted(drive(), key=lambda message: message[2])
    at, back = EPOCH + 6 * 10**9, 8 * 10**9
    messages = [(topic, kind, log - back * (log > at), data) for topic, kind, log, data in messages]
    for storage in ("MCAP", "SQLITE3"):
        path = write_bag2(tmp_path / storage, messages, storage)
        run = logs.read(path)
        np.testing.assert_allclose(np.diff(run.stamps), 0.1, atol=2 * TOLERANCE)
        assert np.abs(apart(run)).max() < 2 * TOLERANCE


def test_scans_are_logged_after_their_last_ray(tmp_path: Path) -> None:
    """Scans of 80 ms arrive 80 ms later than odometry of the same time, which is no difference of the clocks."""
    messages = [message for message in drive(wheels=lambda t: t - 50) if message[0] != "/scan"]
    for t in T:
        sweep = scan(float(t), [1 + t, 2, 3], log=float(t) + 0.095, range_max=100, time_increment=0.04)
        messages.append(sweep)
    run = run_of(tmp_path, sorted(messages, key=lambda message: message[2]))
    assert np.abs(np.mean(apart(run))) < 0.005
    assert any("/odom: the stamps are 50.0" in note for note in assumptions_of(run)), run.meta["notes"]


def test_one_signal_alone_is_left_as_it_is() -> None:
    at = np.arange(1, 21, dtype=np.int64) * 10**8
    for stamps in (at, at + 10**12, at * 0):
        found = settle([Signal(name="/scan", stamps=stamps, logged=at)])
        assert found.is_changed == (not stamps.any())
    assert settle([]).notes == []


def compressed(part: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a clock whose seconds go on for this part of each second."""
    return lambda t: np.floor(t) + part * (t % 1.0)


@pytest.mark.parametrize(("part", "unit"), [(1e-3, "microseconds"), (1e-6, "milliseconds")])
@pytest.mark.parametrize("wheels", [False, True])
def test_parts_of_a_second_in_another_unit_are_converted(
    part: float, unit: str, wheels: bool, tmp_path: Path
) -> None:
    wrong = compressed(part)
    run = run_of(tmp_path, drive(scans=wrong, wheels=wrong if wheels else lambda t: t))
    assert np.abs(apart(run)).max() < 2e-3
    np.testing.assert_allclose(np.diff(run.stamps), 0.1, atol=2e-3)
    notes = [note for note in assumptions_of(run) if f"have {unit} in place of nanoseconds" in note]
    assert len(notes) == 1 + wheels


def test_stamps_shortly_after_each_full_second_are_nanoseconds() -> None:
    """As of a receiver that is triggered once a second, with an error of up to 0.2 ms."""
    t = np.arange(60) + RNG.uniform(0, 2e-4, 60)
    stamps = np.rint(1e9 * (t + 1_700_000_000)).astype(np.int64)
    logged = stamps + np.rint(1e9 * RNG.uniform(0.001, 0.03, 60)).astype(np.int64)
    found = settle([Signal(name="/fix", stamps=stamps, logged=logged)])
    assert not found.is_changed and not found.notes
