"""How many noise terms there are, and which process terms beside them: what was planted comes back."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from conftest import further
from ident_samples import simulate

from robotmodic_ident import Narmax, Terms, fit, lags, polynomial
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
    ("coefficients", "order"), [((), 0), ((0.5, 0.3), 2), *further(((0.5,), 1), ((0.0, 0.5), 2))], ids=str
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


@pytest.mark.parametrize("coefficients", [(0.9, 0.5, 0.3), *further(((0.5, 0.3),))], ids=str)
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


def ratio(seed: int, noise: tuple[float, ...], n: int = 1000) -> dict[str, np.ndarray]:
    """Return y = (0.5 y1 + u1) / (1 + 0.8 u1^2) driven by e(k) + c1 e(k-1) + ..., sigma 0.1."""
    rng = np.random.default_rng(seed)
    u, e = rng.uniform(-1, 1, n), np.convolve(0.1 * rng.normal(size=n), [1.0, *noise])[:n]
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = (0.5 * y[k - 1] + u[k - 1]) / (1 + 0.8 * u[k - 1] ** 2) + e[k]
    return {"u": u, "y": y}


def fitted_ratio(record: dict[str, np.ndarray], noise: int | str) -> Narmax:
    above = Terms.parse("1", "y(k-1)", "y(k-2)", "u(k-1)", "u(k-2)", "u(k-1)*y(k-1)")
    below = Terms.parse("u(k-1)", "u(k-1)^2", "y(k-1)^2", "u(k-2)^2")
    return fit(record, "y", above, denominator=below, noise=noise)


def test_a_ratio_with_coloured_noise_comes_back_where_plain_fits_are_biased() -> None:
    right, z, biased = 0, [], []
    for seed in range(3):
        record = ratio(7000 + seed, (0.7,))
        model = fitted_ratio(record, 1)
        if set(model.terms.names) == {"y(k-1)", "u(k-1)"} and model.denominator.names == ("u(k-1)^2",):
            right += 1
            truth = dict(zip(("y(k-1)", "u(k-1)"), (0.5, 1.0), strict=True))
            means = [truth[name] for name in model.terms.names] + [0.8, 0.7]
            z += ((model.parameters - means) / np.sqrt(np.diag(model.covariance))).tolist()
        plain = fitted_ratio(record, 0)
        biased.append(dict(zip(plain.terms.names, plain.theta, strict=True)).get("y(k-1)", np.nan) - 0.5)
    assert right == 3
    assert np.std(z) == pytest.approx(1.0, abs=0.5) and abs(np.mean(z)) < 0.8
    assert np.nanmean(biased) > 0.03


@pytest.mark.parametrize("seed", [8003, 8006])
def test_structures_of_a_ratio_are_compared_over_the_same_samples(seed: int) -> None:
    """Of longer lags fewer samples were scored, so terms came in that explained the first ones."""
    model = fitted_ratio(ratio(seed, (0.7,)), 1)
    assert set(model.terms.names) == {"y(k-1)", "u(k-1)"}
    assert model.denominator.names == ("u(k-1)^2",)


def test_auto_finds_the_noise_lags_of_a_ratio() -> None:
    assert len(fitted_ratio(ratio(7100, (0.7,)), "auto").noise_terms) == 1
    assert len(fitted_ratio(ratio(7101, ()), "auto").noise_terms) == 0


def test_auto_finds_noise_that_goes_with_an_input() -> None:
    """e(k) + 0.6 e(k-1) u(k-1): white, for inputs at random, but not independent of them."""
    terms = Terms.parse(*TRUTH)
    found = []
    for seed in range(3):
        rng = np.random.default_rng(7200 + seed)
        u, e, y = rng.uniform(-1, 1, 1500), 0.5 * rng.normal(size=1500), np.zeros(1500)
        for k in range(2, 1500):
            y[k] = 0.5 + 0.6 * y[k - 1] - 0.15 * y[k - 1] * u[k - 1] + 0.9 * u[k - 2]
            y[k] += e[k] + 0.6 * e[k - 1] * u[k - 1]
        model = fit({"u": u, "y": y}, "y", terms, noise="auto")
        found.append(
            {frozenset(term) for term in model.noise_terms} == {frozenset(*Terms.parse("u(k-1)*e(k-1)"))}
        )
        if found[-1]:
            assert model.noise_theta[0] == pytest.approx(0.6, abs=5 * model.noise_stderr[0])
    assert sum(found) >= 2
    white = fit(moving_average(5, ()), "y", terms, noise="auto")
    assert len(white.noise_terms) == 0


@pytest.mark.slow
def test_candidates_beside_noise_are_never_held_for_all_samples() -> None:
    """48,000 samples times 209 candidates are 80 MB; the search beside noise holds a block of them."""
    record = moving_average(6, (0.5,), n=48_000)
    terms = polynomial(lags("y", 1, 3) + lags("u", 0, 3), 4)[range(209)]
    tracemalloc.start()
    fit(record, "y", terms, noise=1, n_terms=6, search="forward")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.7 * 8 * 48_000 * len(terms)


def test_runs_are_the_same_whether_inputs_are_kept_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    record = moving_average(7, (0.5,), n=9000)
    model = fit(record, "y", Terms.parse(*TRUTH), n_terms=4, noise=1)
    monkeypatch.setattr("robotmodic_ident.prediction.recursion.MAX_KEPT", 0)
    (blocked,) = model.recursion().segments(as_records(record)[0])
    monkeypatch.undo()
    (kept,) = model.recursion().segments(as_records(record)[0])
    assert kept.base.is_kept and not blocked.base.is_kept
    for free in (True, False):
        for one, other in zip(
            model.recursion().run(kept, free=free, gradient=True),
            model.recursion().run(blocked, free=free, gradient=True),
            strict=True,
        ):
            np.testing.assert_array_equal(one, other)
