"""Least squares with bounds reaches the optimum: against scipy's BVLS, by its own multipliers, and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from sensorgraph.diagnosis.motion.regression import BoundedPrior, Regression
from sensorgraph.diagnosis.scan import normal_equations as bounded_least_squares
from sensorgraph.diagnosis.scan.normal_equations import BorderedProblem, boxed, solve_bounded
from sensorgraph.types import Floats


def correlated(rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """Return rows A (m, k), y (m,) and bounds of a problem whose columns are alike, in units that are not."""
    k = int(rng.integers(1, 17))
    m, rank = k + int(rng.integers(0, 20)), int(rng.integers(1, k + 1))
    alike = rng.normal(size=(m, rank)) @ rng.normal(size=(rank, k))
    A = rng.normal(size=(m, k)) + rng.choice([0, 1, 5, 30]) * alike
    y = A @ (3 * rng.normal(size=k)) + rng.normal(size=m)
    low, high = -rng.uniform(0, 3, k), rng.uniform(0, 3, k)
    low[rng.random(k) < 0.15], high[rng.random(k) < 0.15] = -np.inf, np.inf
    units = 10 ** rng.uniform(-3, 3, k) if rng.random() < 0.5 else np.ones(k)
    return A * units, y, low / units, high / units


def cost(A: Floats, y: Floats, x: Floats) -> float:
    """Return half the sum of squares."""
    return 0.5 * float(np.sum((A @ x - y) ** 2))


@pytest.mark.parametrize("seed", [0, 1, *further(2, 3)])
def test_no_correlated_problem_ends_above_the_optimum_of_bvls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(250):
        A, y, low, high = correlated(rng)
        x = solve_bounded(A.T @ A, A.T @ y, low, high).x
        best = lsq_linear(A, y, (low, high), method="bvls", tol=1e-14, max_iter=1000).cost
        assert (low <= x).all() and (x <= high).all()
        assert cost(A, y, x) <= best + 1e-6 * max(1.0, cost(A, y, 0 * x))


def test_both_methods_end_at_the_same_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks are exchanged for certain here, and never there."""
    rng = np.random.default_rng(9)
    problems = [correlated(rng) for _ in range(200)]
    found = [solve_bounded(A.T @ A, A.T @ y, low, high).x for A, y, low, high in problems]
    monkeypatch.setattr(bounded_least_squares, "_exchange_blocks", lambda *_: False)
    for (A, y, low, high), x in zip(problems, found, strict=True):
        alone = solve_bounded(A.T @ A, A.T @ y, low, high).x
        assert cost(A, y, x) == pytest.approx(cost(A, y, alone), rel=1e-6, abs=1e-6 * cost(A, y, 0 * x))


def test_numbers_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        solve_bounded(np.eye(2), np.array([np.nan, 1.0]), -np.ones(2), np.ones(2))


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_slope_is_zero_where_free_and_points_outward_at_bounds(seed: int) -> None:
    """The conditions of Karush, Kuhn and Tucker, each slope against the terms it is summed from."""
    A, y, low, high = correlated(np.random.default_rng(seed))
    H, c = A.T @ A, A.T @ y
    found = solve_bounded(H, c, low, high)
    x, free = found.x, found.is_free
    slope = (c - H @ x) / (np.abs(c) + np.abs(H) @ np.abs(x) + 1e-300)
    assert (np.abs(slope[free]) < 1e-9).all()
    assert ((x == low) | (x == high))[~free].all()
    assert (slope[~free & (x == high) & (low < high)] > -1e-9).all()
    assert (slope[~free & (x == low) & (low < high)] < 1e-9).all()


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_more_unknowns_than_rows_are_solved_within_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = int(rng.integers(2, 20))
    A = rng.normal(size=(int(rng.integers(1, k)), k))
    y, high = 5 * rng.normal(size=len(A)), rng.uniform(0.1, 2, k)
    x = solve_bounded(A.T @ A, A.T @ y, -high, high).x
    best = lsq_linear(A, y, (-high, high), method="bvls", tol=1e-14, max_iter=1000).cost
    assert (np.abs(x) <= high).all()
    assert cost(A, y, x) <= best + 1e-6 * max(1.0, cost(A, y, 0 * x))


# Without bounds the optimum is (2, -1.5). Both lie beyond ±1; with x1 held at 1, x2 = 0.3 - 0.9 x1 is inside again.
H2, C2, OPTIMUM2 = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([0.65, 0.3]), [1.0, -0.6]


def test_a_bound_that_another_makes_superfluous_is_released() -> None:
    found = solve_bounded(H2, C2, -np.ones(2), np.ones(2))
    np.testing.assert_allclose(found.x, OPTIMUM2, rtol=1e-12)
    assert found.is_free.tolist() == [False, True]


def test_tolerances_of_the_scan_channel_release_it_too() -> None:
    g, p = np.split(boxed(H2, C2, np.full(2, 1e8), np.ones(2), np.zeros(2, dtype=np.bool_)).x, [2])
    np.testing.assert_allclose(g, OPTIMUM2, rtol=1e-9)
    assert len(p) == 0


def test_tolerances_of_the_motion_channels_release_it_too() -> None:
    A = np.linalg.cholesky(H2).T
    prior = BoundedPrior(mean=np.zeros(2), sigma=np.full(2, 1e8), reach=np.ones(2))
    solution = Regression.of(A, np.linalg.solve(A.T, C2)).solve(prior)
    np.testing.assert_allclose(solution.theta, OPTIMUM2, rtol=1e-9)
    assert solution.covariance[0, 0] == 0.0
    assert solution.covariance[1, 1] == pytest.approx(1.0)


def test_an_unknown_between_equal_bounds_stays_there_and_the_rest_makes_up_for_it() -> None:
    x = solve_bounded(H2, C2, np.array([0.5, -np.inf]), np.array([0.5, np.inf])).x
    np.testing.assert_allclose(x, [0.5, 0.3 - 0.45], rtol=1e-12)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_problem_asked_again_with_further_unknowns_is_solved_as_a_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, y, low, high = correlated(rng)
    further = 10 ** rng.uniform(-2, 2) * rng.normal(size=(len(A), int(rng.integers(1, 4))))
    problem = BorderedProblem(A.T @ A, A.T @ y, low, high)
    x = problem.with_border(A.T @ further, further.T @ further, further.T @ y)
    own = x[: A.shape[1]]
    assert (low <= own).all()
    assert (own <= high).all()
    whole, infinite = np.hstack([A, further]), np.full(further.shape[1], np.inf)
    box = np.concatenate([low, -infinite]), np.concatenate([high, infinite])
    best = lsq_linear(whole, y, box, method="bvls", tol=1e-14, max_iter=1000).cost
    assert cost(whole, y, x) <= best + 1e-6 * max(1.0, cost(A, y, 0 * own))
    asked_before = problem.with_border(A.T @ further, further.T @ further, further.T @ y)
    np.testing.assert_array_equal(asked_before, x)
