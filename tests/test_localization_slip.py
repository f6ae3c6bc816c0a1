"""Scans and odometry that contradict each other: a robot that is pushed, a trailer in view, a laser that is mounted elsewhere or sways."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from localization_samples import any_times, room_run

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.contrast import contrast_notes
from sensorgraph.localization.locate import locate
from sensorgraph.localization.result import WheelParameters

PUSHED = slice(125, 155)


def drive() -> np.ndarray:
    """Return poses (200, 3) at 10 Hz around the box of the room."""
    t = np.arange(0.0, 20.0, 0.1)
    around = np.column_stack([3.2 + 1.5 * np.cos(0.25 * t), 2.6 + 1.5 * np.sin(0.25 * t)])
    return np.column_stack([around, 0.25 * t + np.pi / 2 + np.sin(0.9 * t)])


@cache
def pushed() -> tuple[Run, np.ndarray]:
    """Return a drive that looks about at up to 1.2 rad/s, with wheels that stand for 3 s, and its true poses."""
    truth = drive()
    run = room_run(truth, rate=10.0, n_rays=90)
    odometry = run.odometry.copy()
    odometry[PUSHED] = odometry[PUSHED.start]
    missed = compose(odometry[PUSHED.start], invert(odometry[PUSHED.stop]))
    odometry[PUSHED.stop :] = compose(missed, odometry[PUSHED.stop :])
    return replace(run, odometry=odometry), truth


@any_times
def test_a_robot_that_is_pushed_keeps_its_pose(times: Callable[[Run], Run]) -> None:
    run, truth = pushed()
    found = locate(times(run))
    off = compose(compose(truth[0], invert(found.poses[0])), found.poses) - truth
    assert set(found.status) == {"ok"}
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.03
    assert np.abs(wrap(off[:, 2])).max() < np.radians(1)
    note = next(note for note in found.notes if "contradict" in note)
    assert re.search(
        r"from 1[12]\.\d s to 1[56]\.\d s, by up to 0\.\d m and \d+° within 1 s: there the scans move by [12]\.\d m and \d+°, the odometry by 0\.\d m",
        note,
    )


def notes_of(poses: np.ndarray, odometry: np.ndarray, rate: float = 10.0) -> tuple[str, ...]:
    """Return the notes on located poses at 10 Hz and an odometry that is logged at a rate [Hz]."""
    every = round(10.0 / rate)
    run = room_run(odometry, n_rays=4, rate=10.0)
    run = replace(
        run,
        odom_stamps=run.odom_stamps[::every],
        odometry=odometry[::every],
        odom_twists=run.odom_twists[::every],
    )
    return contrast_notes(run, poses, odometry, ["ok"] * len(poses), WheelParameters())


def test_scans_of_a_trailer_that_stand_while_the_odometry_drives_are_said() -> None:
    odometry, poses = drive(), drive()
    poses[:60] = poses[60] * [1, 1, 0] + poses[:60] * [0, 0, 1]
    (note,) = notes_of(poses, odometry)
    assert "the scans move by 0.0 m" in note and "trailer" in note


def test_a_laser_that_sways_is_said() -> None:
    t = 0.1 * np.arange(200)
    sway = np.column_stack([0.07 * np.sin(4 * t), 0.07 * np.sin(5 * t), 0.02 * np.sin(5 * t)])
    (note,) = notes_of(compose(drive(), sway), drive())
    assert "mast that sways" in note


def test_a_laser_beside_its_stated_place_is_said_with_its_offset() -> None:
    """On a robot that turns, it moves as its lever; the located poses are those of a point beside base_link."""
    noise = np.random.default_rng(1).normal(size=(200, 3)) * [0.003, 0.003, 0.001]
    (note,) = notes_of(compose(drive(), np.array([0.2, -0.1, 0.0])) + noise, drive())
    assert re.search(
        r"laser is (19|20|21) cm ahead of and (9|10|11) cm right of its stated place: either the mount is wrong",
        note,
    )
    assert notes_of(compose(drive(), np.array([0.02, -0.01, 0.0])) + noise, drive()) == ()


def test_wheels_that_agree_with_the_scans_have_no_note() -> None:
    noise = np.random.default_rng(0).normal(size=(200, 3)) * [0.01, 0.01, 0.005]
    assert notes_of(drive() + noise, drive()) == ()
    assert notes_of(drive()[:1], drive()[:1]) == ()
    assert contrast_notes(pushed()[0], drive(), None, ["ok"] * 200, None) == ()


def test_odometry_that_is_missing_contradicts_nothing() -> None:
    coarse = drive()
    coarse[:, 0] += 0.5 * (np.arange(200) // 10 % 2)
    assert notes_of(drive(), coarse) != () and notes_of(drive(), coarse, rate=1.0) == ()
