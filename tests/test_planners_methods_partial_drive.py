"""The log of a partial drive is that of its curves in one, however it grew; and it can go on from earlier."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from planners_samples import door_arena, task_of

from planners.cars.car_curve import curve_of_arcs
from planners.methods.repair_cars import PartialDrive
from planners.search.log_phases import missed

TASK = task_of(door_arena(9.0), "reeds_shepp", np.array([1.0, 1.4, 0.3]))
PIECES = st.lists(st.tuples(st.floats(0.05, 0.6), st.sampled_from([-1, 0, 1])), min_size=1, max_size=4)


def begun() -> PartialDrive:
    return PartialDrive(
        grid=TASK.coverage, rate=TASK.rate, limits=TASK.vehicle.limits, here=np.array([1.0, 1.4, 0.3])
    )


def going_on(drive: PartialDrive, pieces: list[tuple[float, int]], gear: int) -> PartialDrive:
    length, bend = (np.array(column) for column in zip(*pieces, strict=True))
    return drive.extended(
        curve_of_arcs(drive.here, length, bend, np.full(len(length), gear), TASK.vehicle.limits)
    )


@given(drives=st.lists(st.tuples(PIECES, st.sampled_from([1, -1])), min_size=1, max_size=4))
@settings(max_examples=40, deadline=None)
def test_the_log_of_the_curves_is_that_of_all_in_one(
    drives: list[tuple[list[tuple[float, int]], int]],
) -> None:
    drive = begun()
    for pieces, gear in drives:
        drive = going_on(drive, pieces, gear)
    everything = np.ones_like(TASK.coverage.reachable)
    np.testing.assert_array_equal(~drive.met, missed(drive.curve, everything, TASK.coverage, TASK.rate))
    np.testing.assert_allclose(drive.here, drive.curve.sample(np.array([drive.duration]))[0][0], atol=1e-9)
    assert len(drive.curves) == len(drives)


def test_a_trip_without_its_end_is_as_long_ago_on_the_same_way() -> None:
    drive = going_on(going_on(begun(), [(0.5, 1), (0.4, 0)], 1), [(0.3, 0), (0.3, 1), (0.3, -1)], -1)
    shorter = drive.without_last(1.5)
    assert shorter is not None
    assert drive.duration - 1.5 - 0.7 < shorter.duration < drive.duration  # it stops, and only between pieces
    assert shorter.curves[0] is drive.curves[0]
    ends = drive.curve.poses[:, :2]
    assert np.hypot(*(ends - shorter.here[:2]).T).min() < 1e-6
    assert (shorter.met & ~drive.met).sum() <= 2  # it stays longer where it stops
    assert drive.without_last(0.0) is drive
    assert drive.without_last(60.0) is None
    assert begun().without_last(1.0) is None


def test_a_trip_that_has_not_begun_meets_nothing() -> None:
    drive = begun()
    assert not drive.met.any()
    assert drive.duration == 0.0
