"""Odometry that begins late, ends early or has gaps: the scans fill them, as the truth moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from localization_samples import any_times, loop_poses, room_run

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.locate import locate
from sensorgraph.localization.missing_odometry import with_missing_stretches, without_jumps
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.types import Bools

TRUTH = loop_poses(90, laps=1.0)
RUN = room_run(TRUTH)


def thinned(run: Run, keep: Bools) -> Run:
    """A run with some poses of its odometry."""
    return replace(
        run, odom_stamps=run.odom_stamps[keep], odometry=run.odometry[keep], odom_twists=run.odom_twists[keep]
    )


def cut(first: float, last: float) -> Run:
    """The run with the odometry between two stamps alone."""
    return thinned(RUN, (RUN.odom_stamps >= first) & (RUN.odom_stamps <= last))


@pytest.mark.parametrize(("first", "last", "n_notes"), [(6.0, 99.0, 1), (0.0, 12.0, 1), (5.0, 13.0, 2)])
def test_scans_continue_the_odometry(first: float, last: float, n_notes: int) -> None:
    run = cut(first, last)
    motion = odometry_of(run)
    assert motion is not None
    filled, notes = with_missing_stretches(run, motion)
    assert len(notes) == n_notes and all("has no odometry" in note for note in notes)
    steps = compose(invert(filled.at(RUN.stamps[:-1])), filled.at(RUN.stamps[1:]))
    wanted = compose(invert(TRUTH[:-1]), TRUTH[1:])
    assert np.abs(steps[:, :2] - wanted[:, :2]).max() < 0.05
    assert np.abs(wrap(steps[:, 2] - wanted[:, 2])).max() < np.radians(2.0)
    inside = (RUN.stamps >= run.odom_stamps[0]) & (RUN.stamps <= run.odom_stamps[-1])
    np.testing.assert_allclose(filled.at(RUN.stamps[inside]), motion.at(RUN.stamps[inside]), atol=1e-6)


@pytest.mark.parametrize(("first", "last", "end"), [(6.0, 99.0, 0), (0.0, 12.0, -1)], ids=["before", "after"])
def test_a_sweep_at_the_end_has_the_motion_of_the_scans(first: float, last: float, end: int) -> None:
    run = cut(first, last)
    rare = odometry_of(run)
    assert rare is not None
    often = np.arange(run.odom_stamps[0], run.odom_stamps[-1], 0.02)
    motion = Motion(stamps=often, poses=rare.at(often))
    filled, _ = with_missing_stretches(run, motion)
    period = float(np.median(np.diff(run.stamps)))
    middle = run.stamps[end] + np.array([-0.5, 0.5]) * period * (1 if end else -1)
    inner, outer = filled.at(middle)
    known = filled.at(run.stamps[[0, 1] if end == 0 else [-1, -2]])
    turned, usual = abs(outer[2] - inner[2]), abs(known[0, 2] - known[1, 2])
    assert usual > np.radians(1) and turned == pytest.approx(usual, rel=0.3)


UNEVEN = loop_poses(900, laps=1.0)[
    (10 * np.arange(90) + 30 * np.sin(np.arange(90) / 3)).clip(0, 899).astype(int)
]
"""The same loop at a speed that changes."""
UNEVEN_RUN = room_run(UNEVEN)


@pytest.mark.parametrize(
    ("keep", "said"),
    [
        ((UNEVEN_RUN.odom_stamps < 6.0) | (UNEVEN_RUN.odom_stamps > 9.0), "from 5."),
        (np.arange(len(UNEVEN_RUN.odom_stamps)) % 12 == 0, "stretches of up to"),
    ],
    ids=["gap", "rare"],
)
def test_scans_fill_gaps_within_the_odometry(keep: Bools, said: str) -> None:
    run = thinned(UNEVEN_RUN, keep)
    motion = odometry_of(run)
    assert motion is not None
    filled, notes = with_missing_stretches(run, motion)
    assert len(notes) == 1 and said in notes[0]
    wanted = compose(invert(UNEVEN[:-1]), UNEVEN[1:])

    def error(motion: Motion) -> float:
        steps = compose(invert(motion.at(run.stamps[:-1])), motion.at(run.stamps[1:]))
        return float(np.abs(wrap(steps[:, 2] - wanted[:, 2])).max())

    assert error(filled) < error(motion) / 5
    np.testing.assert_allclose(filled.at(run.odom_stamps), motion.at(run.odom_stamps), atol=1e-6)


def test_the_sweep_before_a_pause_of_the_recording_has_the_motion_before_it() -> None:
    """A bag that was paused for an hour: the last sweep ends in the gap, and turns on there, not slowly for an hour."""
    fine = np.arange(0.0, 10.0, 0.02)
    spin = np.column_stack([0 * fine, 0 * fine, -1.2 * fine])
    stamps, pause = np.arange(0.05, 9.8, 0.1), 3600.0
    late = np.where(fine > 5.1, pause, 0.0)
    run = replace(
        RUN, stamps=stamps + np.where(stamps > 5.1, pause, 0.0), ranges=np.ones((len(stamps), RUN.sensor.n_rays)),
        odom_stamps=fine + late, odometry=spin, odom_twists=np.full((len(spin), 2), np.nan),
    )  # fmt: skip
    filled, notes = with_missing_stretches(run, Motion(stamps=fine + late, poses=spin))
    assert notes == ()
    times = 5.05 + np.linspace(0.0, 0.1, 11)  # of the rays of the last sweep before the pause
    np.testing.assert_allclose(filled.at(times)[:, 2], -1.2 * times, atol=0.002)
    times = 5.15 + pause - np.linspace(0.0, 0.1, 11)  # and of the first one after it, stamped at its end
    np.testing.assert_allclose(filled.at(times)[:, 2], -1.2 * (times - pause), atol=0.002)


def test_odometry_that_starts_again_goes_on_where_it_was() -> None:
    stamps = np.arange(0.0, 10.0, 0.02)
    truth = np.column_stack([3.0 * np.sin(0.4 * stamps), 3.0 - 3.0 * np.cos(0.4 * stamps), 0.4 * stamps])
    poses = truth.copy()
    for first in (200, 330):  # each time from 0
        poses[first:] = compose(invert(truth[first])[None], truth[first:])
    poses[:, 2] = np.unwrap(poses[:, 2])
    joined = without_jumps(Motion(stamps=stamps, poses=poses))
    off = compose(invert(truth), joined.poses)
    assert np.abs(off[:, :2]).max() < 1e-3 and np.abs(wrap(off[:, 2])).max() < 1e-3
    whole = Motion(stamps=stamps, poses=truth)
    assert without_jumps(whole) is whole


def test_whole_odometry_is_unchanged() -> None:
    motion = odometry_of(RUN)
    assert motion is not None
    filled, notes = with_missing_stretches(RUN, motion)
    assert filled is motion and notes == ()


@any_times
def test_located_poses_are_right_where_the_odometry_is_missing(times: Callable[[Run], Run]) -> None:
    found = locate(times(cut(5.0, 13.0)))
    away = compose(invert(compose(TRUTH[40], invert(found.poses[40]))), TRUTH)
    assert np.hypot(*(away - found.poses)[:, :2].T).max() < 0.05
    assert np.abs(wrap(away[:, 2] - found.poses[:, 2])).max() < np.radians(1.5)
    assert any("has no odometry before" in note for note in found.notes)
