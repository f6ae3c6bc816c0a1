"""What an equation says, held against what its simulation does and against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further

from robotmodic_ident import IdentError, Narmax, Terms, fit, polynomial
from robotmodic_ident.analysis import (
    Distribution,
    antiderivative_model,
    correlation_dimension,
    derivative,
    gfrf,
    integral,
    jacobian,
    lyapunov,
    lyapunov_along,
    lyapunov_of_series,
    partial_model,
    rest_point,
    sensitivity,
    sobol,
    states_of,
    surface,
    without_noise,
)
from robotmodic_ident.analysis.algebra import evaluate, sum_of
from robotmodic_ident.analysis.embedding import surrogate


def model(output: str, terms: dict[str, float]) -> Narmax:
    n = len(terms)
    return Narmax(
        output=output, terms=Terms.parse(*terms), theta=np.array(list(terms.values())),
        covariance=1e-4 * np.eye(n), err=np.zeros(n), sigma=0.1, n_samples=1000,
    )  # fmt: skip


SPEED = model(
    "v", {"1": 0.2, "v(k-1)": 0.5, "u(k-1)": 0.3, "u(k-1)*v(k-1)": 0.1, "u(k-2)^2": -0.2, "v(k-2)^2": 0.05}
)
STATIC = model("v", {"1": 0.2, "u(k)": 0.5, "u(k-1)^2": 0.3, "u(k)*u(k-2)": -0.1})
SMOOTH = model(
    "y",
    {
        "y(k-1)": 0.5, "u(k-1)": 1.0, "u(k-1)^2": 0.1, "y(k-1)^2": -0.05,
        "y(k-1)*u(k-1)": 0.07, "y(k-2)^3": 0.02, "u(k-1)^2*y(k-1)": 0.03,
    },
)  # fmt: skip


def inputs(n: int = 200, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, n)


@pytest.mark.parametrize("speed", [SPEED, STATIC], ids=["with past outputs", "of inputs alone"])
def test_the_derivative_over_time_predicts_the_differences_of_the_output(speed: Narmax) -> None:
    u = inputs()
    v = speed.predict_mpo({"u": u, "v": np.zeros(len(u))})
    a = np.diff(v, prepend=np.nan) / 0.1
    np.testing.assert_allclose(
        derivative(speed, 0.1, "a").predict_osa({"u": u, "v": v, "a": a})[10:], a[10:], atol=1e-12
    )


@pytest.mark.parametrize("speed", [SPEED, STATIC], ids=["with past outputs", "of inputs alone"])
def test_speed_to_acceleration_and_back_is_the_same_motion(speed: Narmax) -> None:
    u = inputs()
    v = speed.predict_mpo({"u": u, "v": np.zeros(len(u))})
    again = integral(derivative(speed, 0.1, "a"), 0.1, "v")
    np.testing.assert_allclose(again.predict_osa({"u": u, "v": v})[10:], v[10:], atol=1e-12)


def test_the_integral_of_a_model_with_past_outputs_sums_its_free_run() -> None:
    acceleration = model("a", {"a(k-1)": 0.6, "u(k)": 1.0, "a(k-1)*u(k-1)": -0.2, "a(k-2)^2": 0.05})
    u = inputs()
    a = acceleration.predict_mpo({"u": u, "a": np.zeros(len(u))})
    v = np.concatenate([np.zeros(2), np.cumsum(a[2:])]) * 0.1
    speed = integral(acceleration, 0.1, "v")
    np.testing.assert_allclose(speed.predict_osa({"u": u, "v": v})[5:], v[5:], atol=1e-12)


def test_stderr_of_a_derivative_is_scaled_by_the_period() -> None:
    assert derivative(SPEED, 0.1, "a").stderr == pytest.approx(np.full(6, 0.1))  # 0.01 / 0.1 s


@pytest.mark.parametrize("signal", ["u(k-1)", "v(k-1)", "phi"])
def test_partial_derivatives_are_those_of_finite_differences(signal: str) -> None:
    m = model("y", {"u(k-1)^3*v(k-1)": 0.4, "cos(2*phi)*u(k-1)": 0.7, "sin(phi)^2*v(k-1)^2": -0.3, "1": 1.0})
    rng, h = np.random.default_rng(2), 1e-6
    at = {s: rng.uniform(-1, 1, 50) for s in m.terms.signals}
    total = sum_of(m)
    up, down = ({**at, signal: at[signal] + d} for d in (h, -h))
    slope = (evaluate(total, up) - evaluate(total, down)) / (2 * h)
    np.testing.assert_allclose(sensitivity(m, at)[signal], slope, atol=1e-8)
    np.testing.assert_allclose(evaluate(sum_of(partial_model(m, signal)), at), slope, atol=1e-8)
    assert set(jacobian(m)) == set(m.terms.signals)


@pytest.mark.parametrize("signal", ["u(k-1)", "phi"])
def test_differentiating_an_antiderivative_gives_the_model_back(signal: str) -> None:
    m = model("y", {"u(k-1)^3*v(k-1)": 0.4, "cos(2*phi)": 0.7, "v(k-1)": -0.3, "1": 1.0})
    again = partial_model(antiderivative_model(m, signal), signal)
    want, got = sum_of(m), sum_of(again)
    assert want.keys() == got.keys()
    assert all(got[t] == pytest.approx(want[t], rel=1e-14) for t in want)


def test_a_surface_is_the_model_at_every_pair_of_values() -> None:
    u, v = np.linspace(-1, 1, 5), np.linspace(0, 2, 4)
    z = surface(SPEED, ("u(k-1)", u), ("v(k-1)", v), {"u(k-2)": 0.5, "v(k-2)": 0.0})
    assert z.shape == (4, 5)
    assert z[2, 3] == pytest.approx(0.2 + 0.5 * v[2] + 0.3 * u[3] + 0.1 * u[3] * v[2] - 0.05)
    with pytest.raises(IdentError, match=r"u\(k-2\)"):
        surface(SPEED, ("u(k-1)", u), ("v(k-1)", v), {"v(k-2)": 0.0})


def test_sobol_indices_of_a_polynomial_are_those_worked_out_by_hand() -> None:
    m = model("y", {"x1": 1.0, "x2": 2.0, "x1*x2": 3.0, "x3^2": 1.0})
    spread = Distribution("uniform", -1.0, 1.0)
    found = sobol(m, dict.fromkeys(("x1", "x2", "x3"), spread))
    parts = np.array([1 / 3, 4 / 3, 9 / 9, 4 / 45])  # Var x = 1/3, Var x1 x2 = 1/9, Var x² = 4/45
    assert found.variance == pytest.approx(parts.sum(), rel=1e-12)
    share = parts / parts.sum()
    assert found.first == pytest.approx(dict(zip(("x1", "x2", "x3"), share[[0, 1, 3]], strict=True)))
    assert found.total["x1"] == pytest.approx(share[0] + share[2])
    assert found.pairs["x1", "x2"] == pytest.approx(share[2])


def test_sobol_indices_agree_with_monte_carlo() -> None:
    m = model("y", {"x^2*z": 1.0, "cos(phi)*x": 2.0, "z^3": 0.5, "1": 4.0, "sin(2*phi)": 1.0})
    spread = {
        "x": Distribution("uniform", -1.0, 2.0),
        "z": Distribution("normal", 0.5, 1.0),
        "phi": Distribution("uniform", -np.pi, np.pi),
    }
    rng, n = np.random.default_rng(3), 400_000

    def draw() -> dict[str, np.ndarray]:
        return {
            "x": rng.uniform(-1, 2, n),
            "z": rng.normal(0.5, 1.0, n),
            "phi": rng.uniform(-np.pi, np.pi, n),
        }

    a, b, total = draw(), draw(), sum_of(m)
    at_a, at_b = evaluate(total, a), evaluate(total, b)
    found = sobol(m, spread)
    assert found.variance == pytest.approx(at_a.var(), rel=0.02)
    for s in a:  # Saltelli's and Jansen's estimators
        mixed = evaluate(total, {**a, s: b[s]})
        assert found.first[s] == pytest.approx((at_b * (mixed - at_a)).mean() / at_a.var(), abs=0.02)
        assert found.total[s] == pytest.approx(((at_a - mixed) ** 2).mean() / 2 / at_a.var(), abs=0.02)


def test_sobol_says_when_signals_are_not_independent() -> None:
    x = inputs(500)
    m = model("y", {"a": 1.0, "b": 1.0})
    assert sobol(m, {"a": x, "b": x + 0.1 * inputs(500, 2)}).dependence == pytest.approx(1.0, abs=0.02)
    assert "independent" in str(sobol(m, {"a": x, "b": x + 0.1 * inputs(500, 2)}))
    assert "independent" not in str(sobol(m, {"a": x, "b": inputs(500, 2)}))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_frequency_response_is_the_harmonic_of_the_simulated_model(order: int) -> None:
    n, amplitude, cycle = 4096, 0.02, 20
    omega = 2 * np.pi * cycle / 256
    k = np.arange(n + 2048)
    u = amplitude * np.cos(omega * k)
    y = SMOOTH.predict_mpo({"u": u, "y": np.zeros(len(u))})[-n:]
    seen = np.fft.rfft(y)[order * cycle * 16] / n * np.exp(-1j * order * omega * 2048)
    said = (amplitude / 2) ** order * gfrf(SMOOTH, *[omega] * order, input="u")
    assert abs(seen - said) < 3e-4 * abs(said)  # the next order of the same harmonic is amplitude² smaller


def test_linear_frequency_response_is_the_transfer_function() -> None:
    m = model("y", {"y(k-1)": 0.5, "u(k-1)": 2.0, "u(k)": 0.3})
    w = np.linspace(0, np.pi, 9)
    z = np.exp(-1j * w)
    np.testing.assert_allclose(gfrf(m, w, input="u"), (2 * z + 0.3) / (1 - 0.5 * z), rtol=1e-13)
    assert np.abs(gfrf(m, w, w, input="u")).max() == 0


def test_frequency_response_needs_a_rest_point() -> None:
    m = model("y", {"1": 0.3, "y(k-1)": 0.5, "u(k-1)": 1.0, "y(k-1)^2": -0.1})
    with pytest.raises(IdentError, match="rest point"):
        gfrf(m, 0.1, input="u")
    at = rest_point(m, "u", 0.2)
    assert at[1] == pytest.approx(0.3 + 0.5 * at[1] + 0.2 - 0.1 * at[1] ** 2, abs=1e-12)
    slope = 0.5 - 0.2 * at[1]
    assert gfrf(m, 0.0, input="u", at=at) == pytest.approx(1 / (1 - slope))


HENON = model("y", {"1": 1.0, "y(k-1)^2": -1.4, "y(k-2)": 0.3})


def henon(n: int) -> np.ndarray:
    y = [0.1, 0.1]
    for _ in range(n + 100):
        y.append(1 - 1.4 * y[-1] ** 2 + 0.3 * y[-2])
    return np.array(y[-n:])


def logistic(n: int) -> np.ndarray:
    y = [0.3]
    for _ in range(n + 100):
        y.append(4 * y[-1] * (1 - y[-1]))
    return np.array(y[-n:])


def test_lyapunov_exponents_of_henon_sum_to_the_contraction() -> None:
    found = lyapunov(HENON, states_of(HENON, henon(2000), 64, np.random.default_rng(4)))
    assert found.values.sum() == pytest.approx(math.log(0.3), abs=1e-9)
    assert found.values[0] == pytest.approx(0.4192, abs=5 * float(found.stderr[0]))
    assert found.dimension == pytest.approx(1.258, abs=0.01)
    assert found.lost == 0


def test_lyapunov_exponent_of_a_linear_model_is_its_slowest_pole() -> None:
    m = model("y", {"y(k-1)": 1.2, "y(k-2)": -0.35})  # poles 0.7 and 0.5
    found = lyapunov(m, [[1.0, 0.3]], period=0.5, n_steps=400, transient=100)
    assert found.values == pytest.approx(np.log([0.7, 0.5]) / 0.5, abs=1e-9)


@pytest.mark.parametrize("seed", [11, *further(12, 13)])
def test_henon_identified_at_one_percent_noise_keeps_its_exponent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = henon(3000)
    measured = y + 0.01 * y.std() * rng.normal(size=len(y))
    found = fit({"y": measured}, "y", polynomial(["y(k-1)", "y(k-2)"], 2))
    exponent = lyapunov(found, states_of(found, measured, 64, rng)).values[0]
    assert exponent == pytest.approx(0.4192, rel=0.02)


@pytest.mark.parametrize("seed", [14, *further(15, 16)])
def test_henon_at_five_percent_noise_is_found_with_its_orbit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = henon(3000)
    measured = y + 0.05 * y.std() * rng.normal(size=len(y))
    first = fit({"y": measured}, "y", polynomial(["y(k-1)", "y(k-2)"], 2))
    cleaned = without_noise(first, {"y": measured})
    assert cleaned.sigma == pytest.approx(0.05 * y.std(), rel=0.05)
    assert np.std(cleaned.series - y) < 0.2 * np.std(measured - y)
    exponent = lyapunov(cleaned.model, states_of(cleaned.model, cleaned.series, 64, rng)).values[0]
    assert exponent == pytest.approx(0.4192, rel=0.02)


@pytest.mark.slow
def test_intervals_of_a_cleaned_model_cover_what_was_planted() -> None:
    y, truth, inside = henon(1000), {"1": 1.0, "y(k-1)^2": -1.4, "y(k-2)": 0.3}, []
    terms = Terms.parse(*truth)
    for seed in range(60):
        measured = y + 0.02 * y.std() * np.random.default_rng(100 + seed).normal(size=len(y))
        cleaned = without_noise(fit({"y": measured}, "y", terms, n_terms=3), {"y": measured}).model
        off = cleaned.theta - np.array([truth[name] for name in cleaned.terms.names])
        inside.append(np.abs(off) < 1.96 * cleaned.stderr)
    assert 0.85 < np.mean(inside) < 0.99


@pytest.mark.parametrize("seed", [17, 18, 19])
def test_the_logistic_map_at_one_percent_noise_keeps_its_exponent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = logistic(3000)
    measured = y + 0.01 * y.std() * rng.normal(size=len(y))
    cleaned = without_noise(fit({"y": measured}, "y", polynomial(["y(k-1)"], 2)), {"y": measured})
    found = lyapunov_along(cleaned.model, {"y": cleaned.series})  # at 4 a free run leaves by the least error
    assert found.values[0] == pytest.approx(math.log(2), rel=0.02)


def lorenz(n: int, period: float) -> np.ndarray:
    def flow(s: np.ndarray) -> np.ndarray:
        return np.array([10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]])

    h, s, out = period / 10, np.ones(3), []
    for k in range(10 * (n + 500)):
        a = flow(s)
        b = flow(s + h / 2 * a)
        c = flow(s + h / 2 * b)
        s = s + h / 6 * (a + 2 * b + 2 * c + flow(s + h * c))
        if k % 10 == 9:
            out.append(s)
    return np.array(out[500:])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 21])
def test_lorenz_identified_at_one_percent_noise_keeps_its_exponent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = lorenz(5000, 0.03)
    measured = clean + 0.01 * clean.std(axis=0) * rng.normal(size=clean.shape)
    data = dict(zip("xyz", measured.T, strict=True))
    terms = polynomial(["x(k-1)", "y(k-1)", "z(k-1)"], 3)
    models = [fit(data, v, terms, search="forward") for v in "xyz"]
    found = lyapunov(models, states_of(models, measured, 64, rng), period=0.03, n_steps=4000)
    assert found.values[0] == pytest.approx(0.9056, rel=0.02)  # [1/s], Sprott 2003
    assert found.values[1] == pytest.approx(0.0, abs=0.02)  # along the flow


def test_exponents_along_an_orbit_are_those_of_the_free_run() -> None:
    along = lyapunov_along(HENON, {"y": henon(4000)})
    assert along.values[0] == pytest.approx(0.4192, abs=4 * float(along.stderr[0]))
    assert along.values.sum() == pytest.approx(math.log(0.3), abs=1e-9)


def test_a_driven_model_forgets_its_start_at_its_conditional_exponent() -> None:
    m = model("y", {"y(k-1)": 0.5, "u(k)": 1.0, "u(k)*y(k-1)": 0.3})
    u = inputs(2000)
    found = lyapunov_along(m, {"u": u, "y": m.predict_mpo({"u": u, "y": np.zeros(2000)})})
    assert found.values[0] == pytest.approx(np.log(np.abs(0.5 + 0.3 * u[2:])).mean(), abs=1e-9)


def test_a_model_that_runs_away_has_no_exponent() -> None:
    with pytest.raises(IdentError, match="infinity"):
        lyapunov(model("y", {"y(k-1)^2": 2.0, "1": 1.0}), [[1.0]])
    with pytest.raises(IdentError, match=r"u\(k\)"):
        lyapunov(model("y", {"y(k-1)": 0.5, "u(k)": 1.0}), [[1.0]])


def test_neighbours_of_the_logistic_map_part_by_ln_2() -> None:
    found = lyapunov_of_series(logistic(5000), dimension=2, theiler=5, fit=(0, 5))
    assert found.exponent == pytest.approx(math.log(2), rel=0.05)


def test_a_circle_has_dimension_one_and_a_square_two() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(3000) * 0.7391
    circle = correlation_dimension(np.column_stack([np.cos(t), np.sin(t)]), dimension=1, theiler=5, rng=rng)
    square = correlation_dimension(rng.uniform(size=(1500, 2)), dimension=1, theiler=5, rng=rng)
    assert circle.interval[0] <= 1.0 <= circle.interval[1] + 0.01
    assert circle.value == pytest.approx(1.0, abs=0.03)
    assert square.value == pytest.approx(2.0, abs=0.15)  # pairs near the edge count too few


def test_henon_is_told_from_linear_noise_and_linear_noise_is_not() -> None:
    rng = np.random.default_rng(6)
    found = correlation_dimension(henon(500), dimension=2, theiler=5, n_surrogates=19, rng=rng)
    assert found.p_value == pytest.approx(0.05)
    assert found.value == pytest.approx(1.22, abs=0.1)
    noise = np.convolve(rng.normal(size=502), [1, 0.8, 0.5], mode="valid")
    said = correlation_dimension(noise, dimension=2, theiler=5, n_surrogates=19, rng=rng)
    assert said.p_value is not None
    assert said.p_value > 0.05


def test_surrogates_keep_values_and_spectrum() -> None:
    y = henon(512)
    other = surrogate(y, np.random.default_rng(7))
    np.testing.assert_array_equal(np.sort(other), np.sort(y))
    a, b = np.abs(np.fft.rfft(y)), np.abs(np.fft.rfft(other))
    assert np.linalg.norm(a - b) < 0.05 * np.linalg.norm(a)
    assert abs(np.corrcoef(y, other)[0, 1]) < 0.3


@pytest.mark.parametrize(
    "asked",
    [
        lambda m: lyapunov(m, [0.1, 0.2]),
        lambda m: gfrf(m, [0.1], input="u"),
        lambda m: sobol(m, {"y(k-1)": np.linspace(0, 1, 9), "u(k)": np.linspace(0, 1, 9)}),
        lambda m: derivative(m, 0.1, "dy"),
    ],
    ids=["lyapunov", "gfrf", "sobol", "derivative"],
)
def test_what_holds_the_output_is_not_left_out_in_silence(asked: Callable[[Narmax], object]) -> None:
    plain = model("y", {"y(k-1)": 0.5, "u(k)": 0.3})
    with pytest.raises(IdentError, match=r"limits y to -inf \.\.\. 10"):
        asked(replace(plain, limits=(-np.inf, 10.0)))
    with pytest.raises(IdentError, match="predicts only the magnitude of y"):
        asked(replace(plain, is_magnitude=True))
