"""Residual tests raise as many false alarms as they say, and see what is missing; scores know of correlation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from ident_samples import simulate
from scipy.signal import lfilter

from robotmodic_ident import (
    IdentError,
    Record,
    Terms,
    blocks,
    extrapolation,
    false_discoveries,
    fit,
    halves,
    lags,
    polynomial,
    score,
    scores,
    validate,
)
from robotmodic_ident.validation.score import effective_samples

TRUTH = {"1": 0.5, "y(k-1)": 0.6, "y(k-1)*u(k-1)": -0.15, "u(k-2)": 0.9}


def record(seed: int, n: int = 1000, *, ma: float = 0.0, extra: dict[str, float] | None = None) -> dict:
    rng = np.random.default_rng(seed)
    u = 0.5 * lfilter([1], [1, -0.7], rng.normal(size=n))
    return simulate({**TRUTH, **(extra or {})}, {"u": u}, rng.normal(0, 0.5, n), ma=ma)


def alarms(seeds: range, *, noise: int = 0, max_lag: int = 20, **kind) -> dict[str, tuple[float, float]]:
    """Return of every test the share of lags out of bounds and the share of joint p-values below 5 %."""
    single: dict[str, list[float]] = {}
    joint: dict[str, list[bool]] = {}
    for seed in seeds:
        data = record(seed, **kind)
        model = fit(data, "y", Terms.parse(*TRUTH), n_terms=4, noise=noise)
        for check in validate(model, data, max_lag=max_lag):
            single.setdefault(check.test, []).append(len(check.alarms) / len(check.lags))
            joint.setdefault(check.test, []).append(check.p_value < 0.05)
    return {test: (float(np.mean(single[test])), float(np.mean(joint[test]))) for test in single}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0, 1])
def test_false_alarms_are_5_percent_a_lag_and_jointly(noise: int) -> None:
    rates = alarms(range(20000, 20400), noise=noise, ma=0.5 * noise)
    assert set(rates) == {"e-e", "e-u", "e-u^2", "e-eu", "e^2-u^2"}
    for single, joint in rates.values():
        assert single == pytest.approx(0.05, abs=0.01)
        assert joint == pytest.approx(0.05, abs=0.033)  # 3 sigma of 400 repeats


def test_first_lag_has_its_size_although_fitting_has_shrunk_its_correlation() -> None:
    out, plain = [], []
    for seed in range(21000, 21150):
        data = record(seed, 300)
        check = validate(fit(data, "y", Terms.parse("1", "y(k-1)"), n_terms=2), data, max_lag=1, inputs=())[0]
        out.append(check.bound[0])
        plain.append(1.96 / np.sqrt(check.n))
    assert np.mean(out) < 0.97 * np.mean(plain)  # where 1.96 / sqrt(n) would all but never alarm


@pytest.mark.parametrize(
    "kind,test",
    [
        ({"ma": 0.4}, "e-e"),
        ({"extra": {"u(k-4)": 0.2}}, "e-u"),
        ({"extra": {"u(k-1)^2": 0.15}}, "e-u^2"),
    ],
)
def test_what_is_missing_is_seen_by_the_test_made_for_it(kind, test) -> None:
    assert alarms(range(30), max_lag=5, **kind)[test][1] > 0.9


def test_variance_that_goes_with_the_input_is_seen_by_squares_only() -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=2000)
    data = {"u": u, "y": 2 * u + (0.2 + 0.5 * u**2) * rng.normal(size=2000)}
    checks = {c.test: c.p_value for c in validate(fit(data, "y", Terms.parse("u(k)")), data, max_lag=3)}
    assert checks["e^2-u^2"] < 1e-6 and checks["e-e"] > 0.01


def test_held_out_records_have_the_size_too() -> None:
    out = []
    for seed in range(22000, 22060):
        first, second = halves(record(seed, 2000))
        model = fit(first, "y", Terms.parse(*TRUTH), n_terms=4)
        out += [len(c.alarms) / len(c.lags) for c in validate(model, second, fitted=False)]
    assert np.mean(out) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize("seeds", [range(24000, 24060), *further(range(24060, 24460))])
def test_errors_of_the_coefficients_raise_no_alarm_on_held_out_records(seeds: range) -> None:
    single: dict[str, list[float]] = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        # slow: the second half leaves the range of the first
        u = 0.2 * lfilter([1], [1, -0.98], rng.normal(size=1000))
        first, second = halves(simulate(TRUTH, {"u": u}, rng.normal(0, 0.5, 1000)))
        model = fit(first, "y", Terms.parse(*TRUTH), n_terms=4)
        for check in validate(model, second, fitted=False):
            single.setdefault(check.test, []).append(len(check.alarms) / len(check.lags))
    rates = {test: float(np.mean(values)) for test, values in single.items()}
    # neighbouring lags of a slow input are one lag: 3 sigma of as many independent cases as seeds
    assert max(rates.values()) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(seeds)), rates


def test_no_residual_is_paired_across_a_gap() -> None:
    data = record(1, 600)
    cut = Record(signals=data, stamps=np.arange(600.0) + np.where(np.arange(600) >= 300, 1e4, 0.0))
    model = fit(data, "y", Terms.parse(*TRUTH), n_terms=4)
    whole, parted = (validate(model, d, max_lag=10)[0] for d in (data, cut))
    assert (whole.n, parted.n) == (600 - 2 - 10, 600 - 2 * 12)


def test_hundreds_of_rays_do_not_cry_wolf() -> None:
    rng = np.random.default_rng(5)
    wrong, found = [], []
    for _ in range(200):
        p = rng.uniform(size=361)
        p[:36] = 10 ** -rng.uniform(3, 8, 36)  # these rays do miss something
        p[-1] = np.nan
        believed = false_discoveries(p, 0.05)
        wrong.append(believed[36:].sum() / max(believed.sum(), 1))
        found.append(believed[:36].mean())
        assert not believed[-1]
    assert np.mean(wrong) < 0.05 and np.mean(found) > 0.95
    assert false_discoveries(rng.uniform(0.2, 1, 50)).sum() == 0


def test_too_few_residuals_and_unknown_inputs_are_said() -> None:
    data = record(0, 50)
    model = fit(data, "y", Terms.parse("u(k-2)", "y(k-1)"), n_terms=2)
    with pytest.raises(IdentError, match="too few to test 30 lags"):
        validate(model, data, max_lag=30)
    with pytest.raises(IdentError, match="no signal w"):
        validate(model, data, inputs=["w"])


def test_correlation_of_two_slow_series_is_not_mistaken_for_a_relation() -> None:
    naive, honest = [], []
    for seed in range(300):
        a, b = lfilter([1], [1, -0.95], np.random.default_rng(seed).normal(size=(2, 1200)))[:, 200:]
        result = score(a, b)
        honest.append(result.p_value < 0.05)
        naive.append(abs(result.r) > 1.96 / np.sqrt(1000))
        assert result.r_low < result.r < result.r_high
    assert np.mean(naive) > 0.5
    assert np.mean(honest) < 0.1


def test_white_series_keep_nearly_all_their_samples() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 2000))
    assert effective_samples(a, b) > 1800
    slow = lfilter([1], [1, -0.9], a), lfilter([1], [1, -0.9], b)
    expected = 2000 * (1 - 0.81) / (1 + 0.81)  # Bartlett's closed form for two AR(0.9)
    assert effective_samples(*slow) == pytest.approx(expected, rel=0.35)


def test_score_of_a_perfect_and_of_the_mean_prediction() -> None:
    y = np.random.default_rng(1).normal(size=300)
    assert score(y, y).rrse == 0 and score(y, y).r == pytest.approx(1)
    mean = score(y, np.full(300, y.mean()))
    assert mean.rrse == pytest.approx(1) and np.isnan(mean.r)
    holed = np.where(np.arange(300) % 3 == 0, np.nan, y)
    assert score(holed, y).n == 200
    with pytest.raises(IdentError, match="3 or more"):
        score(y[:2], y[:2])


def test_persistence_stands_beside_every_score() -> None:
    t = np.arange(3000) / 30
    x = np.sin(0.5 * t) + 0.02 * np.random.default_rng(2).normal(size=3000)  # slow: one step is no test
    model = fit({"x": x}, "x", Terms.parse("1", "x(k-1)", "x(k-2)"))
    one, ten, free = scores(model, {"x": x}, (1, 10, "free"))
    assert one.model.r > 0.99 and one.persistence.r > 0.99
    assert one.persistence.rmse == pytest.approx(np.std(x[2:] - x[1:-1]), rel=0.02)
    assert ten.model.rmse > one.model.rmse and ten.persistence.n == ten.model.n
    assert free.horizon == "free" and free.model.rrse > 0.5  # and in free run it is useless


def test_k_step_prediction_lies_between_one_step_and_free_run() -> None:
    data = record(3, 800, ma=0.6)
    model = fit(data, "y", Terms.parse(*TRUTH), n_terms=4, noise=1)
    rmse = [np.std((data["y"] - model.predict_k(data, k))[110:]) for k in (1, 2, 5, 100)]
    assert rmse[:3] == sorted(rmse[:3]) and rmse[3] == pytest.approx(rmse[2], rel=0.02)  # memory of 2 samples
    np.testing.assert_allclose(model.predict_k(data, 1)[2:], model.predict_osa(data)[2:], atol=1e-12)
    np.testing.assert_allclose(model.predict_k(data, 798)[-1], model.predict_mpo(data)[-1], atol=1e-9)


@pytest.mark.parametrize("centre", [0.0, 1e5])
def test_leverage_is_the_diagonal_of_the_hat_matrix(centre: float) -> None:
    rng = np.random.default_rng(2)
    x = centre + rng.uniform(-1, 1, 60)
    y = 1 + 2 * (x - centre) - (x - centre) ** 2 + 0.1 * rng.normal(size=60)
    y[7] = np.nan
    model = fit({"x": x, "y": y}, "y", polynomial(["x"], 2), n_terms=3)
    hat = model.leverage({"x": x, "y": y})
    known = np.isfinite(y)
    Q, _ = np.linalg.qr(np.vander(x - centre, 3)[known])
    np.testing.assert_allclose(hat[known], (Q**2).sum(axis=1), rtol=1e-8)
    assert hat[known].sum() == pytest.approx(3)
    assert np.isfinite(hat[7])  # where the output is not known the equation still holds


def test_what_lies_outside_the_fit_is_told_and_is_worse_there() -> None:
    rng = np.random.default_rng(3)
    u = np.r_[rng.uniform(0, 1, 400), rng.uniform(0.05, 0.95, 300), rng.uniform(2, 3, 100)]
    y = np.sin(2 * u) + 0.01 * rng.normal(size=800)
    near, test = {"u": u[:400], "y": y[:400]}, {"u": u[400:], "y": y[400:]}
    model = fit(near, "y", polynomial(lags("u", 0, 0), 4))
    told = extrapolation(model, near, test)
    assert told.share == pytest.approx(100 / 400)
    assert told.rmse_inside == pytest.approx(0.01, rel=0.2)
    assert told.rmse_outside > 10 * told.rmse_inside
    assert extrapolation(model, near, near).share == 0
    assert np.isnan(extrapolation(model, near, near).rmse_outside)


def test_exact_data_have_no_leverage() -> None:
    u = np.linspace(0, 1, 20)
    exact = {"u": u, "y": 0.5 * u}
    told = extrapolation(replace(fit(exact, "y", Terms.parse("u(k)")), sigma=0.0), exact, exact)
    assert np.isnan(told.share)
    assert np.isnan(told.largest)


def test_blocks_are_contiguous_and_cover_the_record() -> None:
    data = Record(signals={"u": np.arange(11.0)}, stamps=np.arange(11.0) * 0.1)
    parts = blocks(data, 3)
    assert [len(p) for p in parts] == [4, 3, 4]
    np.testing.assert_array_equal(np.concatenate([p.signals["u"] for p in parts]), np.arange(11))
    with pytest.raises(ValueError, match="1 to 11"):
        blocks(data, 12)


@pytest.mark.parametrize("unit", [2.0**-300, 2.0**400])
def test_units_change_no_test(unit: float) -> None:
    plain = record(3)
    judged = []
    for factor in (1.0, unit):
        scaled = {name: factor * values for name, values in plain.items()}
        model = fit(scaled, "y", Terms.parse("y(k-1)", "u(k-2)"), n_terms=2)
        judged.append([(one.test, one.p_value) for one in validate(model, scaled, max_lag=5)])
    for (test, one), (_, other) in zip(*judged, strict=True):
        assert one == pytest.approx(other, rel=1e-6), test


@pytest.mark.parametrize("unit", [2.0**-600, 2.0**560, 2.0**900])
def test_scores_and_shares_hold_where_squares_overflow_or_vanish(unit: float) -> None:
    x, noise = np.random.default_rng(4).normal(size=(2, 60))
    plain, scaled = score(x, x + 0.1 * noise), score(unit * x, unit * (x + 0.1 * noise))
    assert scaled.rmse == pytest.approx(unit * plain.rmse, rel=1e-12)
    for name in ("rrse", "r", "r_low", "p_value", "n_effective"):
        assert getattr(scaled, name) == pytest.approx(getattr(plain, name), rel=1e-9), name


def test_held_out_values_whose_squares_overflow_are_outside_the_fit() -> None:
    u, noise = np.random.default_rng(5).normal(size=(2, 200))
    near = {"u": u, "y": 0.5 * u + 0.1 * noise}
    far = {name: 2.0**490 * values for name, values in near.items()}
    model = fit(near, "y", Terms.parse("1", "u(k)"))
    told = extrapolation(model, near, far)
    assert told.share > 0.9
    assert np.isfinite(told.rmse_outside)
    assert all(np.isfinite(one.p_value) for one in validate(model, far, max_lag=5))
