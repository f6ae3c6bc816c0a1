"""Odometry that stands for a while as its driver hangs: the sweeps of the turning robot are deskewed by the scans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from localization_samples import any_times, looking_about, room_run, seen

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.locate import locate
from sensorgraph.localization.moving_returns import with_motion_of_scans
from sensorgraph.localization.tracked_run import track_run
from sensorgraph.types import Floats

STAMPS, FINE, SWEEP = np.arange(0.0, 16.0, 0.1), np.arange(0.0, 16.2, 0.02), 0.1
TRUTH = looking_about(STAMPS)
HANGS = (5.0, 7.0)
"""[s] meanwhile the robot turns by up to 1 rad/s, and so by up to 6° during a sweep."""


def swept(odometry: Floats) -> Run:
    """A laser whose rays are measured one after the other, each from where the robot is."""
    run = room_run(TRUTH, rate=10.0)
    n, bearings = run.sensor.n_rays, run.sensor.bearings
    at = looking_about(STAMPS[:, None] + SWEEP * np.arange(n) / n)
    at[..., 2] += bearings
    ranges = seen(at.reshape(-1, 3), np.zeros(1)).reshape(len(STAMPS), n)
    ranges += 0.005 * np.random.default_rng(1).normal(size=ranges.shape)
    return replace(
        run, sensor=replace(run.sensor, sweep_time=SWEEP), ranges=ranges,
        odom_stamps=FINE, odometry=odometry, odom_twists=np.zeros((len(FINE), 2)),
    )  # fmt: skip


@any_times
def test_a_sweep_is_located_where_the_odometry_stands_and_the_robot_turns(
    times: Callable[[Run], Run],
) -> None:
    driven = looking_about(FINE)
    first, last = np.searchsorted(FINE, HANGS)
    rest = compose(np.broadcast_to(invert(driven[last]), driven[last:].shape), driven[last:])
    driven[last:] = compose(np.broadcast_to(driven[first], rest.shape), rest)  # it goes on where it hung
    driven[first:last] = driven[first]
    found = locate(times(swept(driven)))
    away = compose(invert(compose(TRUTH[0], invert(found.poses[0]))), TRUTH)
    assert np.hypot(*(away - found.poses)[:, :2].T).max() < 0.03
    assert (
        np.abs(np.degrees(wrap(away[:, 2] - found.poses[:, 2]))).max() < 1.0
    )  # it was 3°, half of the turn in a sweep
    assert any("contradict each other from" in note for note in found.notes)


@any_times
def test_a_run_that_agrees_with_its_odometry_is_unchanged(times: Callable[[Run], Run]) -> None:
    followed = track_run(times(swept(looking_about(FINE))))
    assert with_motion_of_scans(followed) is followed
