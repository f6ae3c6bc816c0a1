"""Odometry whose positions and heading contradict each other is corrected where the scans confirm the cause, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from localization_samples import Floats, room_run, seen

from logs.run import Run
from logs.transforms import compose, dead_reckoning, invert
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.odometry_check import with_checked_odometry


def winding(n: int) -> Floats:
    """Return poses (n, 3) of a winding drive, ahead."""
    x = np.linspace(1.0, 7.0, n)
    return np.column_stack([x, 1.6 + 0.8 * np.sin(1.5 * x), np.arctan(1.2 * np.cos(1.5 * x))])


RUN, DENSE = room_run(winding(90)), winding(1781)
"""The drive at 5 Hz, and its odometry at 100 Hz."""


def with_odometry(poses: Floats) -> Run:
    stamps = np.linspace(0.0, RUN.stamps[-1], len(poses))
    return replace(RUN, odom_stamps=stamps, odometry=poses, odom_twists=np.zeros((len(poses), 2)))


def integrated(turn: float = 1.0, in_odometry: bool = False) -> Floats:
    """Return the twists of the drive, integrated as those of the robot: turns in another unit, or ways along x and y."""
    rate = np.gradient(DENSE, axis=0)
    ways = (rate[:, 0] + 1j * rate[:, 1]) * (1.0 if in_odometry else np.exp(-1j * DENSE[:, 2]))
    found = dead_reckoning(np.arange(1781.0), np.column_stack([ways.real, ways.imag, turn * rate[:, 2]]))
    return np.column_stack([found[:, :2], np.unwrap(found[:, 2])])


CASES = {
    "mirrored": DENSE * [1.0, -1.0, 1.0],
    "exchanged": DENSE[:, [1, 0, 2]],
    "twist": integrated(in_odometry=True),
    "degrees": integrated(turn=180 / np.pi),
    "compass": DENSE + [0.0, 0.0, 0.8],
    "compass, sideways": DENSE + [0.0, 0.0, -2.2],
}


@pytest.mark.parametrize(
    "case", ["mirrored", "twist", "degrees", *further("exchanged", "compass", "compass, sideways")]
)
def test_positions_and_heading_are_brought_together_as_the_scans_confirm(case: str) -> None:
    run, notes = with_checked_odometry(with_odometry(CASES[case]))
    assert any("does not move along its heading" in note for note in notes)
    steps, true = (compose(invert(poses[:-20:20]), poses[20::20]) for poses in (run.odometry, DENSE))
    np.testing.assert_allclose(steps[:, :2], true[:, :2], atol=2e-3)  # 3 % of a step
    np.testing.assert_allclose(steps[:, 2], true[:, 2], atol=2e-3)


def test_a_robot_that_drives_sideways_keeps_its_odometry() -> None:
    """Its base_link looks to the left of its way: scans and odometry agree."""
    sideways = compose(winding(90), np.array([0.0, 0.0, np.pi / 2]))
    given = replace(room_run(sideways), odometry=sideways)
    run, notes = with_checked_odometry(given)
    assert run is given and notes == ()


@pytest.mark.parametrize("turned", [np.pi / 2, np.pi])
def test_a_laser_that_is_turned_is_no_error_of_the_odometry(turned: float) -> None:
    ranges = seen(compose(winding(90), np.array([0.0, 0.0, turned])), RUN.sensor.bearings)
    with pytest.raises(SensorgraphError, match="the laser is turned by"):
        with_checked_odometry(replace(RUN, ranges=ranges, odometry=winding(90)))


def test_an_odometry_that_counts_backwards_has_no_other_cause() -> None:
    with pytest.raises(SensorgraphError, match="counts its distance backwards"):
        with_checked_odometry(with_odometry(winding(90) * [-1.0, -1.0, 1.0]))
