"""Readings that go along with the robot, and fill so much of the view that the scans seem to stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from localization_samples import any_times, room_run

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.locate import locate
from sensorgraph.localization.moving_returns import confirms_odometry
from sensorgraph.localization.odometry_check import with_checked_odometry
from sensorgraph.localization.scans import ScanPoints, scan_points

TRAILER = [(-1.1, -1.0), (-1.1, 1.0), (-2.5, 1.0), (-2.5, -1.0)]
"""[m] Corners of a wide trailer behind the laser, in base_link; nearer ones are parts of the robot (`robot_parts.py`)."""


def ranges_to(corners: list[tuple[float, float]], bearings: np.ndarray) -> np.ndarray:
    """Return the ranges (n_rays,) to a convex polygon around which the laser looks; +inf beside it."""
    a, b = np.array(corners), np.roll(corners, -1, axis=0)
    d, u = b - a, np.column_stack([np.cos(bearings), np.sin(bearings)])[:, None]
    across = u[..., 0] * d[:, 1] - u[..., 1] * d[:, 0]
    with np.errstate(divide="ignore"):
        way = (a[:, 0] * d[:, 1] - a[:, 1] * d[:, 0]) / across
        along = (a[:, 0] * u[..., 1] - a[:, 1] * u[..., 0]) / across
    return np.where((way > 0) & (along >= 0) & (along <= 1), way, np.inf).min(axis=1)


@cache
def drive() -> tuple[Run, np.ndarray]:
    """Return a drive along the room, and its true poses."""
    t = np.arange(0.0, 12.0, 0.1)
    truth = np.column_stack([1.9 + 0.45 * t, 1.2 + 0.0 * t, 0.05 * np.sin(0.5 * t)])
    return room_run(truth, rate=10.0, n_rays=180), truth


@cache
def with_trailer() -> tuple[Run, np.ndarray]:
    """Return the drive with a trailer in view."""
    run, truth = drive()
    rng = np.random.default_rng(3)
    box = ranges_to(TRAILER, run.sensor.bearings) + 0.01 * rng.normal(size=run.ranges.shape)
    return replace(run, ranges=np.minimum(run.ranges, box)), truth


def errors(run: Run, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return errors (n,) [m] and [rad] of the located poses, and the notes."""
    found = locate(run)
    assert set(found.status) == {"ok"}
    off = compose(compose(truth[0], invert(found.poses[0])), found.poses) - truth
    return np.hypot(off[:, 0], off[:, 1]), np.abs(wrap(off[:, 2])), found.notes


@any_times
def test_a_trailer_in_view_does_not_stop_the_robot(times: Callable[[Run], Run]) -> None:
    run, truth = with_trailer()
    way, turn, notes = errors(times(run), truth)
    assert way.max() < 0.06 and turn.max() < np.radians(1)
    assert any("contradict the odometry" in note for note in notes)


@any_times
def test_scans_that_a_driver_turns_for_two_seconds_do_not_move_the_robot(times: Callable[[Run], Run]) -> None:
    run, truth = drive()
    ranges = run.ranges.copy()
    ranges[60:80] = np.roll(ranges[60:80], 30, axis=1)  # by 60 degrees
    way, turn, notes = errors(times(replace(run, ranges=ranges)), truth)
    assert way.max() < 0.1 and turn.max() < np.radians(1)
    assert any("contradict the odometry" in note for note in notes)


def test_readings_decide_whether_scans_or_odometry_are_right() -> None:
    """A trailer fits a robot that stands; the walls confirm the one that moved, whoever says so."""
    run, truth = with_trailer()
    scans, stands = scan_points(run), np.zeros_like(truth)
    assert confirms_odometry(scans, run.stamps, stands, truth)
    assert not confirms_odometry(scans, run.stamps, truth, stands)  # pushed, with wheels that stand
    assert not confirms_odometry(scans, run.stamps, truth, truth * [0.2, 0.2, 3.0])
    assert not confirms_odometry(scans, run.stamps, truth, truth)  # nothing to decide


def test_good_odometry_stays_where_a_trailer_fills_most_of_the_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scans alone then move at random: their steps are not those of the odometry."""
    run, truth = with_trailer()
    rng = np.random.default_rng(5)
    at_random = np.cumsum(rng.normal(size=truth.shape) * [0.5, 0.5, 0.01], axis=0)

    def tracked(some: Run, part: slice) -> tuple[ScanPoints, Any]:
        n = len(some.stamps[part])
        sure = np.broadcast_to(np.eye(3), (n, 3, 3))
        facts = {
            "poses": at_random[part],
            "matched": np.ones(n),
            "projections": sure,
            "piece": np.zeros(n, dtype=int),
        }
        return scan_points(some.take_scans(part)), SimpleNamespace(**facts)

    monkeypatch.setattr("sensorgraph.localization.odometry_check.track_part", tracked)
    kept, notes = with_checked_odometry(run)
    np.testing.assert_array_equal(kept.odometry, run.odometry)
    assert any("confirm the odometry" in note for note in notes)
