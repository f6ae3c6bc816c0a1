"""Odometry in other units is noticed and named; a mirrored laser is refused; a sound run is left as it is."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from localization_samples import loop_poses, room_run, seen, timed

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.course import direction_of
from sensorgraph.localization.locate import locate
from sensorgraph.localization.odometry_check import check_turns, with_checked_odometry
from sensorgraph.localization.result import WheelParameters

TRUTH = loop_poses(90, laps=1.0)
RUN = room_run(TRUTH, way_scale=0.97, heading_bias=0.02)


def drive(run: Run) -> np.ndarray:
    return np.hypot(*np.diff(run.odometry[:, :2], axis=0).T)


def test_sound_odometry_is_left_alone() -> None:
    run, notes = with_checked_odometry(RUN)
    assert run is RUN and notes == ()


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres")])
def test_ways_in_other_units_are_named_and_mended(factor: float, unit: str) -> None:
    run, notes = with_checked_odometry(replace(RUN, odometry=RUN.odometry * [factor, factor, 1.0]))
    assert len(notes) == 1 and unit in notes[0] and "times too large" in notes[0]
    np.testing.assert_allclose(drive(run), drive(RUN), rtol=1e-6)


def test_turns_in_degrees_are_named_and_mended() -> None:
    run, notes = with_checked_odometry(replace(RUN, odometry=RUN.odometry * [1.0, 1.0, 180 / np.pi]))
    assert "read as degrees" in notes[0]
    assert np.ptp(run.odometry[:, 2]) == pytest.approx(np.ptp(RUN.odometry[:, 2]), rel=1e-6)


def test_mirrored_laser_is_refused_in_one_line() -> None:
    mirrored = replace(RUN, ranges=np.roll(RUN.ranges[:, ::-1], 1, axis=1))
    with pytest.raises(
        SensorgraphError, match="turn in opposite directions: the laser counts its rays clockwise"
    ):
        with_checked_odometry(mirrored)


def test_a_laser_that_is_turned_by_less_than_is_refused_is_noted_with_the_angle() -> None:
    x = np.linspace(1.0, 7.0, 90)
    poses = np.column_stack([x, 1.2 + 0.4 * np.sin(2 * x), np.arctan(0.8 * np.cos(2 * x))])
    given = room_run(poses)
    ranges = seen(compose(poses, np.array([0.0, 0.0, 0.2])), given.sensor.bearings)
    assert with_checked_odometry(given)[1] == ()
    run, (note,) = with_checked_odometry(replace(given, ranges=ranges))
    assert run.sensor is given.sensor
    assert re.search(r"to the right of the odometry's motion: the laser is turned by \+1[012]\.", note)


def test_a_laser_of_unknown_mount_gets_the_yaw_that_the_wheels_show() -> None:
    for yaw in (np.pi, np.pi / 2, -2.2):
        sensor = replace(RUN.sensor, mount=np.zeros(3))
        ranges = seen(compose(TRUTH, np.array([0.0, 0.0, yaw])), sensor.bearings)
        turned = replace(RUN, sensor=sensor, ranges=ranges, meta={"mount": "unknown"})
        run, notes = with_checked_odometry(turned)
        # a yaw within 0.1 rad of a right angle is exactly that; others are estimated from 90 scans
        assert wrap(run.sensor.mount[2] - yaw) == pytest.approx(0.0, abs=1e-9 if yaw > 0 else 0.02)
        assert len(notes) == 1 and "is turned by" in notes[0] and "±" in notes[0]
        np.testing.assert_array_equal(run.odometry, RUN.odometry)


def test_direction_is_found_beside_an_unknown_place_of_the_laser() -> None:
    """Hand-eye equation in the plane: both the laser's yaw and its place change what it sees of a motion that turns."""
    rng = np.random.default_rng(4)
    driven = np.column_stack([rng.uniform(0.06, 0.2, 40), np.zeros(40), rng.uniform(-0.5, 0.5, 40)])
    for yaw, place in ((0.5, (0.3, 0.1)), (-0.2, (-0.2, 0.0)), (3.0, (0.15, -0.3))):
        mount = np.array([*place, yaw])
        steps = compose(compose(invert(mount), driven), mount) + rng.normal(0, 0.002, (40, 3))
        jumped = driven.copy()
        jumped[7] += [2.0, -1.0, 0.7]
        for odometry in (driven, jumped):
            found = direction_of(steps, odometry)
            assert found is not None
            assert wrap(found[0] + yaw) == pytest.approx(0.0, abs=0.02)


def test_a_stated_mount_that_the_wheels_contradict_is_refused() -> None:
    ranges = seen(compose(TRUTH, np.array([0.0, 0.0, np.pi])), RUN.sensor.bearings)
    with pytest.raises(
        SensorgraphError, match=r"the laser is turned by -?180° .* relative to its specified mount"
    ):
        with_checked_odometry(replace(RUN, ranges=ranges))


def test_odometry_that_counts_backwards_is_not_taken_for_a_mirrored_laser() -> None:
    steps = compose(invert(RUN.odometry[:-1]), RUN.odometry[1:])
    poses = [np.zeros(3)]
    for step in -steps:
        poses.append(compose(poses[-1], step))
    with pytest.raises(SensorgraphError, match="the odometry counts backwards"):
        with_checked_odometry(replace(RUN, odometry=np.array(poses)))


def test_odometry_that_disagrees_with_the_scans_is_left_out_in_one_line() -> None:
    """Degrees that went through a quaternion: turns modulo a circle, which no factor mends."""
    turned = RUN.odometry * [1.0, 1.0, 180 / np.pi]
    turned[:, 2] = (turned[:, 2] + np.pi) % (2 * np.pi) - np.pi
    run, notes = with_checked_odometry(replace(RUN, odometry=turned))
    assert len(notes) == 1 and "disagree step by step: not used; check that they are in radians" in notes[0]
    assert len(run.odometry) == 0


def test_one_jump_does_not_make_the_odometry_useless() -> None:
    jumped = RUN.odometry.copy()
    jumped[40:] = compose(np.array([3.0, -2.0, 1.0]), jumped[40:])
    run, notes = with_checked_odometry(replace(RUN, odometry=jumped))
    assert notes == () and len(run.odometry)


@pytest.mark.parametrize("part", [slice(0, 35), slice(55, None)], ids=["ends early", "begins late"])
def test_scans_without_odometry_are_not_compared_with_it(part: slice) -> None:
    """They are the most, and do not move by the odometry, so that rounding would give their direction."""
    some = replace(
        RUN,
        odom_stamps=RUN.odom_stamps[part],
        odometry=RUN.odometry[part] + 1e-9,
        odom_twists=RUN.odom_twists[part],
    )
    run, notes = with_checked_odometry(some)
    assert run is some and notes == ()


def test_jumps_that_add_up_to_a_unit_are_no_unit() -> None:
    way, jumped = drive(RUN).sum(), RUN.odometry.copy()
    for at in (30, 60):  # together 3.28 times the way: as if in feet
        apart = np.array([1.14 * way, 0.0, 0.0])
        jumped[at:] = compose(np.broadcast_to(apart, jumped[at:].shape), jumped[at:])
    jumped_run = replace(RUN, odometry=jumped)
    run, notes = with_checked_odometry(jumped_run)
    assert run is jumped_run and notes == ()


def test_turns_that_only_the_whole_drive_shows_to_be_opposite_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A narrow laser cannot be followed by its scans alone, so that no stretch is compared before."""
    monkeypatch.setattr("sensorgraph.localization.locate.with_checked_odometry", lambda run: (run, ()))
    with pytest.raises(SensorgraphError, match="scans and odometry turn in opposite directions"):
        locate(timed(replace(RUN, ranges=np.roll(RUN.ranges[:, ::-1], 1, axis=1))))
    check_turns(WheelParameters(turn_scale=-0.1, turn_scale_sd=0.1))
