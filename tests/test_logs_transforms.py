"""Planar poses: composition and inversion as matrices, of one pose as of many."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from logs.transforms import compose, difference, distances_along, invert
from sensorgraph.types import Floats

RNG = np.random.default_rng(0)
A, B = (RNG.normal(size=(50, 3)) * [5.0, 5.0, 4.0] for _ in range(2))


def matrix(pose: Floats) -> Floats:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def test_composition_is_the_product_of_matrices() -> None:
    for a, b, both in zip(A, B, compose(A, B), strict=True):
        np.testing.assert_allclose(matrix(both), matrix(a) @ matrix(b), atol=1e-12)
        np.testing.assert_allclose(compose(a, b), both, atol=1e-12)
        assert -np.pi < both[2] <= np.pi


def test_inversion_is_that_of_matrices() -> None:
    for a, back in zip(A, invert(A), strict=True):
        np.testing.assert_allclose(matrix(back), np.linalg.inv(matrix(a)), atol=1e-12)
        np.testing.assert_allclose(invert(a), back, atol=1e-12)


@pytest.mark.parametrize("heading", [np.nan, np.inf])
def test_a_heading_that_is_not_finite_gives_no_pose(heading: float) -> None:
    lost = np.array([1.0, 2.0, heading])
    assert np.isnan(compose(lost, A[0])).all() and np.isnan(invert(lost)).all()


def test_a_half_turn_is_positive() -> None:
    half = np.array([0.0, 0.0, np.pi])
    assert compose(half, np.zeros(3))[2] == invert(half)[2] == np.pi
    np.testing.assert_array_equal(compose(half[None], np.zeros((1, 3)))[0], compose(half, np.zeros(3)))


def test_difference_takes_the_shorter_turn() -> None:
    off = difference(A, B)
    assert (np.abs(off[:, 2]) <= np.pi).all()
    np.testing.assert_allclose(np.exp(1j * (B + off)[:, 2]), np.exp(1j * A[:, 2]), atol=1e-12)
    np.testing.assert_array_equal(difference(A[0], B[0]), off[0])


def test_distances_along_a_path_add_up() -> None:
    along = distances_along(A)
    assert along[0] == 0.0 and (np.diff(along) > 0).all()
    np.testing.assert_allclose(along[-1], sum(np.hypot(*(b - a)[:2]) for a, b in pairwise(A)))
