"""Resampling: what a scan shows at other bearings than its own, against a room in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs.resampling import resample


def room(bearings: np.ndarray, x: float = 0.3, y: float = -0.4) -> np.ndarray:
    """Range from (x, y) in a room of 4 x 3 m around the origin."""
    cos, sin = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore"):  # along a wall
        across = (2 - np.sign(cos) * x) / np.abs(cos)
        along = (1.5 - np.sign(sin) * y) / np.abs(sin)
    return np.minimum(across, along)


def turn(n: int, start: float = 0.0) -> np.ndarray:
    return start + 2 * np.pi * np.arange(n) / n


@given(n=st.integers(340, 380), start=st.floats(-3.2, 3.2).map(lambda start: round(start, 3)))
def test_a_full_turn_of_any_count_is_the_room_at_the_wanted_bearings(n: int, start: float) -> None:
    wanted = turn(360)
    got = resample(room(turn(n, start))[None], turn(n, start), wanted)[0]
    step = 2 * np.pi / n
    corners = np.arctan2([1.9, 1.9, -1.1, -1.1], [1.7, -2.3, -2.3, 1.7])
    far = np.abs(np.angle(np.exp(1j * (wanted[:, None] - corners)))).min(axis=1) > step
    np.testing.assert_allclose(
        got[far], room(wanted)[far], rtol=step**2
    )  # a wall: 1/r is a sine of the bearing
    np.testing.assert_allclose(got, room(wanted), rtol=2 * step)


def test_a_bearing_that_is_there_keeps_its_reading_to_the_bit() -> None:
    bearings = np.radians(np.arange(-90.0, 91.0))
    ranges = np.random.default_rng(0).uniform(0.1, 8, (3, 181))
    np.testing.assert_array_equal(resample(ranges, bearings, bearings[:180]), ranges[:, :180])
    np.testing.assert_array_equal(resample(ranges[:, ::-1], bearings[::-1], bearings), ranges)


def test_rays_more_than_a_turn_apart_are_the_first_alone() -> None:
    """What a damaged angle_increment says."""
    found = resample(np.array([[1.0, 2.0, 3.0]]), np.array([0.0, 1e9, 2e9]), np.array([0.0, 1.0]))
    assert found[0, 0] == 1.0


def test_beyond_the_scan_is_nan_and_beside_a_missing_return_the_nearest_counts() -> None:
    bearings = np.array([0.0, 0.1, 0.2, 0.3])
    wanted = np.array([-0.2, -0.04, 0.04, 0.08, 0.14, 0.16, 0.34, 0.36])
    got = resample(np.array([[1.0, np.inf, np.nan, 3.0]]), bearings, wanted)[0]
    np.testing.assert_array_equal(got, [np.nan, 1, 1, np.inf, np.inf, np.nan, 3, np.nan])


def test_no_return_is_made_up_between_two_surfaces() -> None:
    got = resample(np.array([[1.0, 4.0]]), np.array([0.0, 0.01]), np.array([0.003, 0.0049, 0.0051]))
    np.testing.assert_array_equal(got, [[1, 1, 4]])


@pytest.mark.parametrize("n", [1, 2])
def test_few_rays_are_resampled_too(n: int) -> None:
    got = resample(np.full((2, n), 2.0), np.arange(float(n)), np.array([0.0, 2.5]))
    np.testing.assert_array_equal(got, [[2, np.nan]] * 2)
