"""Sums by corner, the bounded solve and the best run of rays, each against its plain definition."""

from __future__ import annotations

import numpy as np
import pytest
from plain_kernels import plain_corner_sums

from sensorgraph.diagnosis.scan.corner_sums import SHARE_OF_PLACE, Corners, corner_sums
from sensorgraph.diagnosis.scan.normal_equations import boxed
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.proposals import best_run


def test_compiled_sums_by_corner_are_the_plain_ones() -> None:
    rng = np.random.default_rng(4)
    shape, k, n_walls, count = (7, 11), 5, 6, 4
    w = np.where(rng.random(shape) < 0.3, 0.0, rng.random(shape))
    wall = rng.integers(0, n_walls, shape)
    rows = rng.normal(size=(7, 3 + k, 11))
    ends, y = rng.normal(size=(2, 7, 11)), rng.normal(size=shape)
    walls = rng.normal(size=(n_walls, 2)), rng.integers(0, count, (n_walls, 2)), count
    got, plain = (sums(w, rows, ends, wall, y, *walls) for sums in (corner_sums, plain_corner_sums))
    for one, other in zip(got, plain, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_the_box_holds_and_binds_only_where_it_must() -> None:
    rng = np.random.default_rng(3)
    a = rng.normal(size=(30, 6))
    matrix, tau = a.T @ a, np.full(5, 0.1)
    right = matrix @ np.array([0.02, -0.01, 3.0, 0.0, 0.03, 2.0])
    locked = np.array([False, False, False, True, False])
    g, p = np.split(boxed(matrix, right, tau, SCAN.nuisance.max_tolerances * tau, locked).x, [len(tau)])
    assert (np.abs(g) <= SCAN.nuisance.max_tolerances * tau * (1 + 1e-9)).all()
    assert g[3] == 0.0
    assert abs(abs(g[2]) - SCAN.nuisance.max_tolerances * 0.1) < 1e-9
    x = np.concatenate([g, p])
    slope = right - matrix @ x - np.concatenate([g / tau**2, [0.0]])
    free = np.array([abs(v) < SCAN.nuisance.max_tolerances * 0.1 - 1e-9 for v in g] + [True]) & ~np.append(
        locked, False
    )
    np.testing.assert_allclose(slope[free], 0.0, atol=1e-5)


def test_best_run_is_the_best_of_all_runs() -> None:
    values = np.random.default_rng(5).normal(size=(7, 12))
    first, last, total = best_run(values)
    for row, i, j, s in zip(values, first, last, total, strict=True):
        plain = max(row[a : b + 1].sum() for a in range(12) for b in range(a, 12))
        assert s == pytest.approx(plain)
        assert row[i : j + 1].sum() == pytest.approx(plain)


def test_corners_of_an_obstacle_shift_together_and_others_alone() -> None:
    ring = np.array([(0.0, 0.0), (1.0, 0.0), (1.2, 0.7), (0.5, 1.1), (-0.2, 0.7)])
    rings = [10 * ring - 4, ring, ring + 2.5]
    walls = np.concatenate([np.stack([one, np.roll(one, -1, axis=0)], axis=1) for one in rings])
    obstacle = np.repeat([2, 0, 1], len(ring))
    corners = Corners.of(walls).of_obstacles(obstacle, 2)
    owner = np.zeros(corners.count)
    owner[corners.ends[:, 0]] = obstacle
    rng = np.random.default_rng(6)
    shifts = np.array([corners.shifts(u) for u in rng.normal(size=(20_000, 2 * corners.n_unknowns))])
    together = (owner[:, None] == owner) & (owner < 2)
    expected = np.where(np.eye(corners.count) > 0, 1.0, np.where(together, SHARE_OF_PLACE, 0.0))
    found = np.cov(shifts[:, ::2].T)
    np.testing.assert_allclose(found, expected, atol=0.03)
    np.testing.assert_allclose(np.cov(shifts[:, 1::2].T), expected, atol=0.03)
    some = rng.normal(size=(2 * corners.count, 1))
    np.testing.assert_allclose(corners.shifts(corners.unknowns(some)[:, 0]), some[:, 0], atol=1e-12)
    for u in np.eye(2 * corners.n_unknowns):
        assert corners.of_unknowns(some[:, 0]) @ u == pytest.approx(some[:, 0] @ corners.shifts(u))
