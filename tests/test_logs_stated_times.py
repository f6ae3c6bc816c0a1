"""The times that a driver states where its scans change shape, arrive in bursts, or are sent again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import Message, odometry, read, scan

from logs.notes import assumptions_of
from logs.ros.bearings import seconds_to_first_ray
from logs.ros.stated_times import even_times

N, PERIOD = 120, 0.1
STEP, PER_RAY = 2 * np.pi / N, PERIOD / N
RANGES = np.random.default_rng(3).uniform(1.0, 5.0, (40, N)).astype(np.float32)
"""(40, N) [m] of a laser that never stops: ray i of scan k is measured at (k + i / N) PERIOD, at the bearing i STEP - pi."""


def part(k: int, rays: range) -> Message:
    """Return some rays of scan k, in the order in which they are stated."""
    sign = rays.step
    return scan(
        PERIOD * (k + rays[0] / N), RANGES[k, rays], angle_min=rays[0] * STEP - np.pi, increment=sign * STEP,
        time_increment=sign * PER_RAY,
    )  # fmt: skip


@pytest.mark.parametrize("rays", [range(30, 90), range(119, -1, -1), range(90, 29, -1)])
def test_a_scan_of_other_bearings_keeps_the_times_of_its_rays(rays: range, tmp_path: Path) -> None:
    """A driver that is started again sends a part of the turn, or the same rays in the opposite order."""
    run = read(tmp_path, [part(k, range(N)) for k in range(25)] + [part(k, rays) for k in range(25, 40)])
    assert run.sensor.sweep_time == pytest.approx(PERIOD, rel=1e-6)
    assert run.stamps - run.stamps[0] == pytest.approx(PERIOD * np.arange(40), abs=1e-6)
    is_seen = np.isin(np.arange(N), rays)
    np.testing.assert_array_equal(np.isfinite(run.ranges[30]), is_seen)
    np.testing.assert_allclose(run.ranges[30, is_seen], RANGES[30, is_seen], rtol=1e-6)


def test_bearings_that_no_stamp_brings_together_keep_theirs() -> None:
    turn = STEP * np.arange(N)
    assert seconds_to_first_ray(turn - np.pi, PER_RAY, turn, PER_RAY) == 0.0  # half a turn each way
    assert seconds_to_first_ray(turn[30:60], PER_RAY, turn, 2 * PER_RAY) == 0.0  # another rotation
    assert seconds_to_first_ray(turn[30:60], 0.0, turn, 0.0) == 0.0
    assert seconds_to_first_ray(turn[30:31], PER_RAY, turn, PER_RAY) == 0.0
    assert seconds_to_first_ray(turn[30:60], PER_RAY, turn, PER_RAY) == pytest.approx(-30 * PER_RAY)


@pytest.mark.parametrize("burst", [2, 3, 5])
def test_scans_that_are_stamped_as_they_arrive_in_bursts_have_the_rate_of_the_laser(
    burst: int, tmp_path: Path
) -> None:
    at = [PERIOD * (k // burst + 1) * burst + 0.002 * (k % burst) for k in range(40)]
    bag = [
        scan(t, RANGES[k], angle_min=-np.pi, increment=STEP, time_increment=PER_RAY) for k, t in enumerate(at)
    ]
    run = read(tmp_path, bag)
    assert run.sensor.rate == pytest.approx(10.0, rel=1e-3)
    assert run.sensor.sweep_time == pytest.approx(PERIOD, rel=1e-6)
    np.testing.assert_allclose(np.diff(run.stamps), PERIOD, atol=1e-3)
    notes = [note for note in assumptions_of(run) if "scan" in note]
    assert len(notes) == 1 and f"as they arrive, {burst} at once" in notes[0]


def test_a_burst_that_lacks_a_scan_or_is_late_shifts_no_other() -> None:
    k = np.arange(60)
    true = 100_000_000 * k
    arrival = true[k // 3 * 3 + 2] + 2_000_000 * (k % 3)
    arrival[30:33] += 40_000_000
    kept = k != 16
    found = even_times(arrival[kept])
    assert found is not None and found[1] == 3
    off = (found[0] - true[kept]) / 1e6
    np.testing.assert_allclose(off[(k[kept] < 15) | (k[kept] > 32)], off[0], atol=0.1)
    assert (np.diff(found[0]) >= 0).all() and np.abs(off - off[0]).max() < 101


@pytest.mark.parametrize("kind", ["even", "jitter", "gaps", "pairs by chance"])
def test_single_arrivals_are_no_bursts(kind: str) -> None:
    rng, k = np.random.default_rng(0), np.arange(400)
    stamps = 100_000_000 * k
    if kind == "jitter":
        stamps = stamps + rng.integers(0, 60_000_000, len(k))
    elif kind == "gaps":
        stamps = stamps[np.flatnonzero(rng.random(len(k)) < 0.6)]
    elif kind == "pairs by chance":
        stamps = np.sort(stamps + np.where(rng.random(len(k)) < 0.2, 99_000_000, 0))
    assert even_times(np.sort(stamps)) is None


@pytest.mark.parametrize("speed", [0.05, 0.6])
def test_of_scans_that_are_sent_again_with_new_stamps_the_first_count(speed: float, tmp_path: Path) -> None:
    bag = []
    for k, ranges in enumerate(RANGES):
        for t in (PERIOD * k, PERIOD * (k + 0.5)):
            bag.append(scan(t, ranges, angle_min=-np.pi, increment=STEP, time_increment=PER_RAY))
            bag.append(odometry(t, speed * t, 0.0, 0.0, speed, omega=0.0))
    run = read(tmp_path, bag)
    assert run.sensor.sweep_time == pytest.approx(PERIOD, rel=1e-6)
    assert np.isfinite(run.ranges).all(axis=1).tolist() == 40 * [True, False]
