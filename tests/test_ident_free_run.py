"""Free-run estimation recovers planted systems where regression is biased; terms, limits and orders are found alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from robotmodic_ident import (
    AutoSettings,
    IdentError,
    Narmax,
    Record,
    Terms,
    auto_fit,
    fit,
    lags,
    output_limits,
    polynomial,
)
from robotmodic_ident.automatic import linear_orders
from robotmodic_ident.estimation.simulation_error import FreeRunLeastSquares
from robotmodic_ident.model import among
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.selection import readable_forms
from robotmodic_ident.selection.free_run_terms import SHORT_DESCENT, TRIAL, FreeRunTerms
from robotmodic_ident.selection.hidden_stretches import HiddenStretches
from robotmodic_ident.selection.readable_forms import friction_models, magnitude_models

FEW = AutoSettings(orders=(2, 3), degrees=(3,), n_folds=2)
TRUTH = {"y(k-1)": 1.2, "y(k-2)": -0.5, "u(k-1)": 0.4, "y(k-1)^3": -0.1}


def duffing(n: int, seed: int, *, sigma: float, high: float = np.inf) -> dict[str, np.ndarray]:
    """Run the planted system, held below `high`, and measure it with white noise."""
    rng = np.random.default_rng(seed)
    u, y = lfilter([1.0], [1.0, -0.6], rng.normal(size=n)), np.zeros(n)
    for k in range(2, n):
        y[k] = min(high, 1.2 * y[k - 1] - 0.5 * y[k - 2] + 0.4 * u[k - 1] - 0.1 * y[k - 1] ** 3)
    noise = sigma * rng.normal(size=n)
    return {"u": u, "y": np.minimum(y + noise, high), "clean": y}


def found(model: Narmax) -> dict[str, float]:
    return dict(zip(model.terms.names, model.theta.tolist(), strict=True))


def test_output_noise_biases_regression_and_not_the_free_run() -> None:
    data, terms = duffing(2000, 1, sigma=0.2), Terms.parse(*TRUTH)
    ls = fit(data, "y", terms, n_terms=4, search="forward")
    free = fit(data, "y", terms, n_terms=4, search="forward", estimator="simulation")
    assert abs(found(ls)["y(k-1)"] - 1.2) > 0.2
    for name, theta, stderr in zip(free.terms.names, free.theta, free.stderr, strict=True):
        assert theta == pytest.approx(TRUTH[name], abs=4 * stderr), name
        assert stderr < 0.03


def test_initial_outputs_are_estimated_better_than_they_are_measured() -> None:
    errors = []
    for seed in range(20):
        data = duffing(60, seed, sigma=0.3)
        exact = fit({**data, "y": data["clean"]}, "y", Terms.parse(*TRUTH), n_terms=4, search="forward")
        run = exact.predict_mpo(data, warm_up=30)
        errors.append([run[:2] - data["clean"][:2], data["y"][:2] - data["clean"][:2]])
    estimated, measured = np.sqrt(np.mean(np.square(errors), axis=(0, 2)))
    assert estimated < 0.8 * measured


def test_normal_equations_are_those_of_all_gradients_with_the_initial_outputs_taken_out() -> None:
    data = duffing(200, 3, sigma=0.1)
    records = [
        Record(signals={k: v[:90] for k, v in data.items()}),
        Record(signals={k: v[90:] for k, v in data.items()}),
    ]
    problem = FreeRunLeastSquares(fit(data, "y", Terms.parse(*TRUTH), n_terms=4).recursion(), records)
    start = problem.measured_start
    gram, cross = problem.normal_equations(problem.recursion.theta, start)
    _, r, J = problem.evaluate(np.r_[problem.recursion.theta, start], gradient=True)
    whole, rest = np.concatenate(J), np.concatenate(r)
    basis = np.linalg.qr(whole[:, 4:])[0]
    own = whole[:, :4] - basis @ (basis.T @ whole[:, :4])
    np.testing.assert_allclose(gram, own.T @ own, rtol=1e-9)
    np.testing.assert_allclose(cross, own.T @ rest, rtol=1e-9, atol=1e-9 * np.abs(own.T @ rest).max())


def test_blocks_of_gradients_join_without_a_seam() -> None:
    data = duffing(9000, 2, sigma=0.1)
    recursion = fit(data, "y", Terms.parse(*TRUTH), n_terms=4).recursion()
    (segment,) = recursion.segments(Record(signals=data))
    for free in (True, False):
        out, _, slopes = recursion.run(segment, free=free, gradient=True)
        parts = list(recursion.gradient_blocks(segment, free=free))
        assert len(parts) > 1
        np.testing.assert_array_equal(np.concatenate([p for _, p, _ in parts]), out[2:])
        np.testing.assert_array_equal(np.concatenate([g for _, _, g in parts]), slopes[2:])


def test_terms_are_found_by_the_simulation_error_where_regression_adds_others() -> None:
    data = duffing(1500, 4, sigma=0.2)
    candidates = polynomial(lags("y", 1, 2) + lags("u", 0, 2), 3)
    linear = Terms(tuple(t for t in candidates if sum(f.power for f in t) <= 1))
    start = fit(data, "y", linear, n_terms=len(linear), search="forward")
    path = FreeRunTerms([Record(signals=data)], candidates).path(start)
    assert {frozenset(t) for t in path[4].model.terms} == {frozenset(t) for t in Terms.parse(*TRUTH)}


def test_what_a_term_is_expected_to_gain_is_what_a_descent_with_it_gains() -> None:
    """A resonance and slow inputs make candidates nearly dependent: what they promise is no rounding error."""
    rng = np.random.default_rng(21)
    u = lfilter([0.02], [1.0, -1.8, 0.82], rng.normal(size=1500))
    x = lfilter([0.0, 0.05, 0.04], [1.0, -1.9, 0.95], u)
    data = {"u": u, "y": x + 0.5 * x**2 + 1e-3 * rng.normal(size=1500)}
    candidates = polynomial(lags("y", 1, 4) + lags("u", 0, 4), 2)
    linear = Terms(tuple(t for t in candidates if sum(f.power for f in t) <= 1))
    search = FreeRunTerms([Record(signals=data)], candidates)
    start = fit(data, "y", linear, n_terms=len(linear), search="forward")
    now = search.minimised(start, start.theta, SHORT_DESCENT)
    gain = search._gains(now)
    assert 0 < gain.max() <= now.rss
    for j in np.argsort(-gain)[:3].tolist():
        larger = among(now.model, now.model.terms + candidates[[j]])
        descended = search.minimised(larger, larger.theta, TRIAL, now.initial)
        assert now.rss - descended.rss > 0.5 * gain[j]


def test_a_start_that_diverges_is_led_back_over_short_stretches() -> None:
    data, terms = duffing(1500, 11, sigma=0.1), Terms.parse(*TRUTH)
    good = fit(data, "y", terms, n_terms=4, search="forward")
    unstable = replace(good, theta=np.array([{"y(k-1)^3": 0.3}.get(n, t) for n, t in found(good).items()]))
    with pytest.raises(IdentError, match="diverge"):
        FreeRunLeastSquares(unstable.recursion(), [Record(signals=data)]).minimise(unstable.theta)
    path = FreeRunTerms([Record(signals=data)], terms).path(unstable)
    for name, theta in found(path[4].model).items():
        assert theta == pytest.approx(TRUTH[name], abs=0.02), name


def test_a_limit_is_seen_in_the_data_and_held_in_prediction() -> None:
    data = duffing(3000, 5, sigma=0.0, high=0.9)
    assert output_limits(data, "y") == (-np.inf, 0.9)
    model = fit(data, "y", Terms.parse(*TRUTH), n_terms=4, search="forward", limits=(-np.inf, 0.9))
    for name, theta in found(model).items():  # what is held at the limit misleads no regression
        assert theta == pytest.approx(TRUTH[name], abs=1e-9)
    np.testing.assert_allclose(model.predict_mpo(data)[2:], data["y"][2:], atol=1e-9)
    assert model.equation().startswith("y(k) = min(0.9, ")
    assert Narmax.from_dict(model.to_dict()).limits == (-np.inf, 0.9)
    unlimited = replace(model, limits=(-np.inf, np.inf))
    assert np.nanmax(unlimited.predict_osa(data)) > 1.0


def test_levels_of_a_quantised_output_are_no_limit() -> None:
    y = np.round(np.sin(np.arange(3000) * 0.03), 1)
    assert output_limits({"y": y}, "y") == (-np.inf, np.inf)


def test_order_degree_and_terms_are_found_alone() -> None:
    data = duffing(1200, 6, sigma=0.05)
    result = auto_fit({"u": data["u"], "y": data["y"]}, "y", ["u"], settings=FEW)
    assert result.chosen.order >= 2
    assert {frozenset(t) for t in Terms.parse(*TRUTH)} <= {frozenset(t) for t in result.model.terms}
    fresh = duffing(1000, 7, sigma=0.0)
    error = result.model.predict_mpo(fresh, warm_up=50)[50:] - fresh["y"][50:]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.std(fresh["y"])
    assert np.isfinite(result.model.stderr).all()


def test_short_constant_and_tiny_records_end_in_a_model_or_in_one_line() -> None:
    data = duffing(40, 12, sigma=0.05)
    for record in (data, {"u": data["u"], "y": np.ones(40)}, {"u": data["u"][:9], "y": data["y"][:9]}):
        try:
            result = auto_fit({"u": record["u"], "y": record["y"]}, "y", ["u"], settings=FEW)
        except IdentError as exc:
            assert str(exc)
        else:
            assert np.isfinite(result.model.theta).all()


def test_a_run_starts_from_fewer_samples_than_the_model_looks_back() -> None:
    data = duffing(400, 13, sigma=0.0)
    names = ["y(k-1)", "y(k-2)", "y(k-6)", "u(k-1)", "y(k-1)^3"]
    model = fit(data, "y", Terms.parse(*names), n_terms=5, search="forward")
    for known in (1, 4):
        y = np.full(400, np.nan)
        y[:known] = data["y"][:known]
        run = model.predict_mpo({"u": data["u"], "y": y}, warm_up=known)
        assert np.isfinite(run).all()
        np.testing.assert_allclose(run[50:], data["y"][50:], atol=1e-3)  # what it stood at has died away


@pytest.mark.slow
def test_a_long_record_of_an_integrator_ends_in_a_model_that_does_not_run_away() -> None:
    """Pieces of it do not show how far a free run drifts."""

    def motor(seed: int) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.normal(size=60), 50)
        y, v = np.zeros(3000), 0.0
        for k in range(1, 3000):
            u[k] -= 40.0 * y[k - 1]  # closed loop
            v += 0.02 * (0.05 * u[k] - 2.0 * v - 0.02 * np.sign(v))
            y[k] = y[k - 1] + 0.02 * v
        return {"u": u, "y": y}

    few = AutoSettings(orders=(2,), degrees=(2,), n_folds=2, max_rows=600, min_unexplained=np.inf)
    fresh = motor(2)
    run = auto_fit(motor(1), "y", ["u"], settings=few).model.predict_mpo(fresh, warm_up=20)
    assert np.sqrt(np.mean((run - fresh["y"])[20:] ** 2)) < 2.0 * np.std(fresh["y"])


def coasting(n: int, seed: int) -> dict[str, np.ndarray]:
    """Run a motor against dry friction, driven in both directions; its position is measured with little noise."""
    rng = np.random.default_rng(seed)
    u, y, v = np.repeat(rng.uniform(-1, 1, n // 50), 50), np.zeros(n), 0.0
    for k in range(1, n):
        v += 0.02 * (u[k] - y[k - 1] - 0.3 * v - 0.25 * np.tanh(v / 0.01))
        y[k] = y[k - 1] + 0.02 * v
    return {"u": u, "y": y + 1e-4 * rng.normal(size=n)}


@pytest.mark.slow
def test_dry_friction_is_found_alone_where_a_slope_does_not_do() -> None:
    few = AutoSettings(orders=(2,), degrees=(1,), n_folds=2)
    train, fresh = coasting(1500, 31), coasting(1500, 32)

    def error(model: Narmax) -> float:
        run = model.predict_mpo(fresh, warm_up=20)
        return float(np.sqrt(np.mean((run - fresh["y"])[20:] ** 2)) / np.std(fresh["y"]))

    model = auto_fit(train, "y", ["u"], settings=few).model
    (friction,) = [i for i, name in enumerate(model.terms.names) if name.startswith("tanh((y(k-1)-y(k-")]
    assert model.theta[friction] == pytest.approx(-(0.02**2) * 0.25, rel=0.2)
    without = auto_fit(train, "y", ["u"], settings=replace(few, min_unexplained=np.inf)).model
    assert error(model) < 0.05 < 0.1 < error(without)


def pendulum(n: int, seed: int) -> dict[str, np.ndarray]:
    """Return a resonance of which the magnitude alone is measured."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 10 + 1), 10)[:n]
    x = lfilter([0.0, 0.05, 0.04], [1.0, -1.8, 0.9], u)
    return {"u": u, "y": np.abs(x) + 0.005 * rng.normal(size=n)}


def test_friction_of_a_motor_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    record = Record(signals=coasting(800, 33))
    monkeypatch.setattr(readable_forms, "SPANS", (1,))
    monkeypatch.setattr(readable_forms, "WIDTH_SHARES", (0.03,))
    (model,) = friction_models([record], "y", ["u"], 2, UNLIMITED)
    (friction,) = [i for i, name in enumerate(model.terms.names) if name.startswith("tanh((y(k-1)-y(k-2))/")]
    assert model.theta[friction] == pytest.approx(-(0.02**2) * 0.25, rel=0.2)


def test_the_lost_sign_of_an_output_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    record, fresh = Record(signals=pendulum(400, 41)), pendulum(300, 42)
    monkeypatch.setattr(readable_forms, "TIME_CONSTANTS", (4.0,))
    monkeypatch.setattr(readable_forms, "DELAYS", (2,))
    (model,) = magnitude_models([record], "y", ["u"], 2)
    names = found(model)
    assert names["y(k-1)"] == pytest.approx(1.8, abs=0.01)
    assert names["y(k-2)"] == pytest.approx(-0.9, abs=0.01)
    assert model.equation().startswith("|y(k)| is measured, y(k) = ")
    again = Narmax.from_dict(model.to_dict())
    run = again.predict_mpo(fresh, warm_up=15)
    assert np.sqrt(np.mean((run - fresh["y"])[15:] ** 2)) < 0.03 * np.std(fresh["y"])
    assert (again.predict_osa(fresh)[2:] >= 0).all()
    signed = {**fresh, "y": fresh["y"] - 1.0}
    assert magnitude_models([Record(signals=signed)], "y", ["u"], 2) == []


@pytest.mark.slow
def test_a_lost_sign_is_found_alone() -> None:
    few = AutoSettings(orders=(2,), degrees=(1,), n_folds=2, max_magnitude_order=2)
    data = pendulum(500, 41)
    assert auto_fit(data, "y", ["u"], settings=few).model.is_magnitude
    counted = {**data, "y": np.where(data["y"] < 0.02, 0.0, data["y"])}  # a counter of pulses rests at 0
    assert output_limits(counted, "y")[0] == 0.0
    assert auto_fit(counted, "y", ["u"], settings=few).model.is_magnitude


def test_long_dynamics_are_found_by_linear_models_first() -> None:
    """Of a cube between two filters short lags say little, and with products they say what is not there."""
    rng = np.random.default_rng(51)
    first, second = butter(2, 0.3), butter(2, 0.35)
    u = rng.normal(size=1500)
    x = lfilter(*first, u)
    record = Record(signals={"u": u, "y": lfilter(*second, x - 0.05 * x**3)})
    stretches = HiddenStretches(records=[record], output="y", n_folds=3)
    settings = AutoSettings(orders=(1, 2, 4, 8))
    orders = linear_orders([record], stretches, ["u"], UNLIMITED, settings)
    assert orders[0] == 4


def test_several_outputs_and_inputs_as_one_text_are_refused_in_a_line() -> None:
    data = {"volts": np.arange(9.0), "y": np.arange(9.0)}
    with pytest.raises(IdentError, match=r"output is \['y', 'z'\], but a model describes one signal"):
        auto_fit(data, ["y", "z"], ["volts"])  # type: ignore[arg-type]
    with pytest.raises(IdentError, match="inputs is 'volts', expected a list of names"):
        auto_fit(data, "y", "volts")
    with pytest.raises(IdentError, match="identify each signal separately"):
        fit(data, ("y", "z"), polynomial(["volts(k)"], 1))  # type: ignore[arg-type]
