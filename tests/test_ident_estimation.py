"""Noise terms, ratios and free runs: planted coefficients come back, and the intervals say how well."""

from __future__ import annotations

import numpy as np
import pytest
from ident_samples import simulate

from robotmodic_ident import IdentError, Narmax, Record, Terms, fit, lags, polynomial
from robotmodic_ident.estimation.prediction_error import (
    LevenbergMarquardt,
    NonlinearLeastSquares,
    levenberg_marquardt,
)
from robotmodic_ident.estimation.simulation_error import FreeRunLeastSquares

TRUTH = {"1": 0.5, "y(k-1)": 0.6, "y(k-1)*u(k-1)": -0.15, "u(k-2)": 0.9}


def coloured(seed: int, n: int = 500, ma: float = 0.8, sigma: float = 1.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return simulate(TRUTH, {"u": rng.uniform(-1, 1, n)}, rng.normal(0, sigma, n), ma=ma)


def estimates(estimator: str, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and whether the 95 % interval covers the truth, both (n_seeds, n_terms)."""
    error, covered = [], []
    for seed in seeds:
        noise = 0 if estimator == "ls" else 1
        model = fit(coloured(seed), "y", Terms.parse(*TRUTH), n_terms=4, noise=noise, estimator=estimator)
        found = {n: (t, s) for n, t, s in zip(model.terms.names, model.theta, model.stderr, strict=True)}
        error.append([found[n][0] - TRUTH[n] for n in TRUTH])
        covered.append([abs(found[n][0] - TRUTH[n]) < 1.96 * found[n][1] for n in TRUTH])
    return np.array(error), np.array(covered)


def test_least_squares_is_biased_by_coloured_noise_and_prediction_error_is_not() -> None:
    ls, _ = estimates("ls", range(5000, 5040))
    pem, covered = estimates("pem", range(5000, 5040))
    assert ls.mean(axis=0)[1] > 0.1
    assert abs(pem.mean(axis=0)[1]) < 0.01
    assert covered.mean() > 0.9


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say() -> None:
    _, covered = estimates("pem", range(6000, 6400))
    np.testing.assert_allclose(covered.mean(axis=0), 0.95, atol=0.033)  # 3 sigma of 400 repeats


def test_noise_terms_are_kept_in_the_predictor_and_whiten_what_it_leaves() -> None:
    record = coloured(1, n=4000)
    model = fit(record, "y", Terms.parse(*TRUTH), n_terms=4, noise=1)
    assert model.noise_terms.names == ("e(k-1)",)
    assert model.noise_theta[0] == pytest.approx(0.8, abs=3 * model.noise_stderr[0])
    assert model.estimator == "pem"
    assert model.sigma == pytest.approx(1.0, rel=0.05)  # least squares leaves 1.28
    e = model.residuals(record)[2:]
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.04
    assert "0.8" in model.equation(digits=1) and "e(k-1)" in model.equation()


def test_terms_are_found_again_under_coloured_noise() -> None:
    dictionary = polynomial(lags("y", 1, 2) + lags("u", 1, 2), 2)
    exact = 0
    for seed in range(8):
        model = fit(coloured(7000 + seed, n=1500, sigma=0.3), "y", dictionary, noise=1)
        exact += set(model.terms.names) == set(TRUTH)
    assert exact >= 7


def test_armax_is_the_linear_case() -> None:
    rng = np.random.default_rng(3)
    u, e = rng.normal(size=4000), 0.3 * rng.normal(size=4000)
    y = np.zeros(4000)
    for k in range(2, 4000):
        y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + u[k - 1] + 0.5 * u[k - 2] + e[k] - e[k - 1] + 0.2 * e[k - 2]
    model = fit({"y": y, "u": u}, "y", polynomial(lags("y", 1, 2) + lags("u", 1, 2), 1), n_terms=4, noise=2)
    found = dict(zip(model.terms.names, model.theta, strict=True))
    assert found == pytest.approx({"y(k-1)": 1.5, "y(k-2)": -0.7, "u(k-1)": 1.0, "u(k-2)": 0.5}, abs=0.03)
    np.testing.assert_allclose(model.noise_theta, [-1.0, 0.2], atol=0.06)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize(
    "names",
    [
        ["1", "y(k-1)", "u(k-1)*y(k-2)", "y(k-1)^2*y(k-2)", "e(k-1)", "e(k-1)*e(k-2)", "y(k-1)*e(k-2)"],
        ["u(k)", "P2(y(k-1))", "T3(y(k-2))", "e(k-2)"],
        ["u(k)", "B3_2of7(y(k-1))", "W1_1(y(k-1))", "cos(2*y(k-2))", "sin(y(k-1))*u(k-1)"],
        ["y(k-1)", "u(k)", "tanh((y(k-1)-y(k-3))/0.4)", "abs(y(k-1)-y(k-2))*u(k)", "abs(y(k-2))*e(k-1)"],
    ],
)
def test_gradient_of_a_run_equals_finite_differences(names: list[str], free: bool) -> None:
    rng = np.random.default_rng(0)
    record = {"u": rng.uniform(-1, 1, 40), "y": rng.uniform(-0.8, 0.8, 40)}
    record["y"][17] = np.nan
    process = Terms.parse(*(n for n in names if "e(" not in n))
    noise = Terms.parse(*(n for n in names if "e(" in n))
    below = Terms.parse("u(k-1)^2", "y(k-1)^2")
    theta = rng.uniform(-0.4, 0.4, len(names) + 2)
    model = Narmax(
        output="y",
        terms=process,
        theta=theta[: len(process)],
        err=np.zeros(len(process)),
        covariance=np.eye(len(theta)),
        sigma=1.0,
        n_samples=40,
        denominator=below,
        denominator_theta=theta[len(process) : len(process) + 2],
        noise_terms=noise,
        noise_theta=theta[len(process) + 2 :],
    )
    kind = FreeRunLeastSquares if free else NonlinearLeastSquares
    problem = kind(model.recursion(), [Record(signals=record)])
    start = np.r_[model.parameters, problem.measured_start if free else []]
    _, residual, (gradient,) = problem.evaluate(start, gradient=True)
    for i in range(len(start)):
        step = np.zeros(len(start))
        step[i] = 1e-6
        _, (up,), _ = problem.evaluate(start + step)
        _, (down,), _ = problem.evaluate(start - step)
        np.testing.assert_allclose(gradient[:, i], (down - up) / 2e-6, atol=2e-8, rtol=1e-6)
    assert np.abs(gradient).max() > 0.1 and len(residual) == 1


def test_free_run_refinement_lowers_the_error_of_the_free_run_and_removes_the_bias_of_output_noise() -> None:
    rng = np.random.default_rng(2)
    truth = {"y(k-1)": 0.8, "u(k-1)": 0.5, "y(k-1)^2*u(k-1)": -0.1}
    clean = simulate(truth, {"u": rng.uniform(-1, 1, 1500)}, np.zeros(1500))
    record = {
        **clean,
        "y": clean["y"] + 0.2 * rng.normal(size=1500),
    }  # noise on the sensor, not in the system
    terms = Terms.parse(*truth)
    ls = fit(record, "y", terms, n_terms=3)
    free = fit(record, "y", terms, n_terms=3, estimator="simulation")
    value = {m.estimator: dict(zip(m.terms.names, m.theta, strict=True)) for m in (ls, free)}
    assert value["ls"]["y(k-1)"] < 0.75
    assert value["simulation"] == pytest.approx(truth, abs=0.06)
    rmse = [np.nanstd(clean["y"] - m.predict_mpo(record)) for m in (ls, free)]
    assert rmse[1] < 0.5 * rmse[0]
    z = [(value["simulation"][n] - truth[n]) / s for n, s in zip(free.terms.names, free.stderr, strict=True)]
    assert np.abs(z).max() < 3.5


def test_rational_model_comes_back_with_honest_intervals() -> None:
    z = []
    for seed in range(20):
        rng = np.random.default_rng(9000 + seed)
        u = rng.uniform(-1, 1, 600)
        y = np.zeros(600)
        for k in range(1, 600):
            y[k] = (0.5 * y[k - 1] + u[k - 1]) / (1 + 0.8 * u[k - 1] ** 2 + 0.3 * y[k - 1] ** 2)
            y[k] += 0.05 * rng.normal()
        model = fit(
            {"y": y, "u": u},
            "y",
            Terms.parse("1", "y(k-1)", "u(k-1)", "u(k-1)^2"),
            denominator=Terms.parse("u(k-1)", "u(k-1)^2", "y(k-1)^2"),
            criterion="ebic",
        )
        if set(model.terms.names) != {"y(k-1)", "u(k-1)"} or len(model.denominator) != 2:
            continue
        truth = {"y(k-1)": 0.5, "u(k-1)": 1.0, "u(k-1)^2": 0.8, "y(k-1)^2": 0.3}
        names = (*model.terms.names, *model.denominator.names)
        spread = np.sqrt(np.diag(model.covariance))
        z += [(t - truth[n]) / s for n, t, s in zip(names, model.parameters, spread, strict=True)]
        assert " / (1 " in model.equation()
    assert len(z) >= 4 * 15
    assert np.std(z) == pytest.approx(1.0, abs=0.3)
    assert abs(np.mean(z)) < 0.35


def test_robust_covariance_knows_of_changing_variance_and_of_correlation() -> None:
    hits = {"classical": [], "sandwich": [], "hac": []}
    for seed in range(80):
        rng = np.random.default_rng(seed)
        x = rng.normal(size=300)
        y = 1 + 2 * x + np.abs(x) * rng.normal(size=300)
        for kind, list_ in hits.items():
            model = fit({"x": x, "y": y}, "y", Terms.parse("1", "x"), n_terms=2, covariance=kind)
            i = model.terms.names.index("x")
            list_.append(abs(model.theta[i] - 2) < 1.96 * model.stderr[i])
    assert np.mean(hits["classical"]) < 0.85
    assert np.mean(hits["sandwich"]) > 0.9 and np.mean(hits["hac"]) > 0.88


def test_correlated_residuals_widen_hac_intervals_only() -> None:
    ratio = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x, e = np.zeros(500), np.zeros(500)
        for k in range(1, 500):
            x[k] = 0.9 * x[k - 1] + rng.normal()
            e[k] = 0.9 * e[k - 1] + rng.normal()
        models = [
            fit({"x": x, "y": x + e}, "y", Terms.parse("1", "x"), n_terms=2, covariance=kind)
            for kind in ("classical", "hac")
        ]
        i = models[0].terms.names.index("x")
        ratio.append(models[1].stderr[i] / models[0].stderr[i])
    true_ratio = np.sqrt((1 + 0.81) / (1 - 0.81))  # of AR(0.9) regressor and noise
    assert 0.6 * true_ratio < np.median(ratio) < 1.2 * true_ratio


def test_records_and_gaps_restart_the_noise() -> None:
    parts = [coloured(11, n=700), coloured(12, n=700)]
    both = fit(parts, "y", Terms.parse(*TRUTH), n_terms=4, noise=1)
    gap = {name: np.r_[parts[0][name], parts[1][name]] for name in parts[0]}
    stamps = np.arange(1400) * 0.1 + np.where(np.arange(1400) >= 700, 60.0, 0.0)
    one = fit(Record(signals=gap, stamps=stamps), "y", Terms.parse(*TRUTH), n_terms=4, noise=1)
    np.testing.assert_allclose(one.theta, both.theta, atol=1e-7)


def test_descent_with_fewer_samples_than_parameters_ends_in_an_exact_fit() -> None:
    rng = np.random.default_rng(8)
    J, y = rng.normal(size=(3, 5)), rng.normal(size=3)

    def evaluate(theta: np.ndarray, *, gradient: bool = False) -> tuple:
        left = y - J @ theta
        return float(left @ left), [left], [J] if gradient else []

    found = levenberg_marquardt(evaluate, np.zeros(5), LevenbergMarquardt())
    np.testing.assert_allclose(J @ found.theta, y, atol=1e-6)


def test_wrong_wishes_are_refused() -> None:
    record = coloured(0, n=50)
    terms = Terms.parse(*TRUTH)
    with pytest.raises(ValueError, match="estimator is 'best'"):
        fit(record, "y", terms, estimator="best")
    with pytest.raises(IdentError, match="holds no past e"):
        fit(record, "y", terms, noise=Terms.parse("u(k-1)"))
    with pytest.raises(IdentError, match="constant 1 already"):
        fit(record, "y", terms, denominator=Terms.parse("1"))
