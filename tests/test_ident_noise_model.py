"""How many noise terms there are, and which process terms beside them: what was planted comes back."""

from __future__ import annotations

import numpy as np
import pytest
from ident_samples import simulate

from robotmodic_ident import IdentError, Narmax, Terms, fit, lags, polynomial
from robotmodic_ident.estimation.prediction_error import NonlinearLeastSquares
from robotmodic_ident.records import as_records

TRUTH = {"1": 0.5, "y(k-1)": 0.6, "y(k-1)*u(k-1)": -0.15, "u(k-2)": 0.9}
DICTIONARY = polynomial(lags("y", 1, 2) + lags("u", 0, 2), 2)


def moving_average(seed: int, coefficients: tuple[float, ...], n: int = 1000) -> dict[str, np.ndarray]:
    """Return the system of TRUTH driven by e(k) + c1 e(k-1) + c2 e(k-2) + ..., sigma 0.5."""
    rng = np.random.default_rng(seed)
    u, e = rng.uniform(-1, 1, n), 0.5 * rng.normal(size=n)
    return simulate(TRUTH, {"u": u}, np.convolve(e, [1.0, *coefficients])[:n])


def terms_of(model: Narmax) -> set[frozenset[object]]:
    return {frozenset(term) for term in model.terms}


@pytest.mark.parametrize(
    ("coefficients", "order"), [((), 0), ((0.5,), 1), ((0.5, 0.3), 2), ((0.0, 0.5), 2)], ids=str
)
def test_the_planted_order_of_the_noise_is_found(coefficients: tuple[float, ...], order: int) -> None:
    found = [
        len(
            fit(moving_average(3000 + seed, coefficients), "y", Terms.parse(*TRUTH), noise="auto").noise_terms
        )
        for seed in range(6)
    ]
    assert found.count(order) >= 5  # the test that asks for more alarms falsely in 5 % of cases
    assert max(found) <= order + 1


def test_the_number_of_noise_lags_stands_in_the_notes() -> None:
    model = fit(moving_average(1, (0.5, 0.3)), "y", Terms.parse(*TRUTH), noise="auto")
    assert model.noise_terms.names == ("e(k-1)", "e(k-2)")
    assert model.notes[-1] == "noise lags: 0 to 2 tried, 2 kept"
    white = fit(moving_average(1, ()), "y", Terms.parse(*TRUTH), noise="auto")
    assert white.notes[-1] == "noise lags: none needed"


def test_noise_that_no_lag_explains_is_said() -> None:
    rng = np.random.default_rng(5)
    u, e = rng.normal(size=800), rng.normal(size=800)
    echo = e + 0.8 * np.concatenate([np.zeros(9), e[:-9]])  # of nine samples ago, out of patience and reach
    model = fit({"u": u, "y": u + echo}, "y", Terms.parse("u(k)"), noise="auto")
    assert len(model.noise_terms) <= 1
    assert "still correlated" in model.notes[-1]


@pytest.mark.parametrize("coefficients", [(0.5, 0.3), (0.9, 0.5, 0.3)], ids=str)
def test_coloured_noise_does_not_add_past_outputs(coefficients: tuple[float, ...]) -> None:
    truth = {frozenset(term) for term in Terms.parse(*TRUTH)}
    models = [
        fit(moving_average(4000 + seed, coefficients, 2000), "y", DICTIONARY, noise=len(coefficients))
        for seed in range(6)
    ]
    assert sum(terms_of(model) == truth for model in models) >= 5


def test_the_prediction_error_is_linear_in_the_process_coefficients() -> None:
    record = moving_average(2, (0.5,))
    model = fit(record, "y", Terms.parse(*TRUTH), n_terms=4, noise=1)
    problem = NonlinearLeastSquares(model.recursion(), as_records(record))
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.4])
    phi, target = (np.concatenate(part) for part in zip(*problem.linearised(start), strict=True))
    theta = np.linalg.lstsq(phi[:, :4], target - 0.4 * phi[:, 4], rcond=None)[0]
    _, (residual,), (gradient,) = problem.evaluate(np.r_[theta, 0.4], gradient=True)
    np.testing.assert_allclose(
        gradient[:, :4].T @ residual, 0.0, atol=1e-9
    )  # the minimum, from far, in one step


def test_a_ratio_takes_no_noise_terms_however_asked_for() -> None:
    record = moving_average(2, ())
    for noise in (1, "auto"):
        with pytest.raises(IdentError, match="rational"):
            fit(record, "y", Terms.parse("u(k)"), denominator=Terms.parse("u(k-1)^2"), noise=noise)
