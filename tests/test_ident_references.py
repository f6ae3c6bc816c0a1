"""Systems, data and printed results that others published; each with its source."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from ident_samples import CUBIC, MAO_BILLINGS, PIRODDI_SPINELLI, simulate, slow_input, white_input
from scipy.signal import butter, lfilter

from logs.formats.text import parses_as_number
from robotmodic_ident import Terms, fit, halves, lags, polynomial, scores

REFERENCE = Path(__file__).parents[2] / "shared" / "data" / "narmax-reference"
needs_data = pytest.mark.skipif(not REFERENCE.is_dir(), reason=f"reference data not found at {REFERENCE}")


def coefficients(model) -> dict[str, float]:
    return dict(zip(model.terms.names, model.theta.tolist(), strict=True))


def test_dc_motor_of_2017_comes_back_from_60_samples() -> None:
    """Lacerda Junior, Almeida and Milani, SBAI 2017, written out in NonSysID `Examples/DC_motor_model`."""
    truth = {
        "y(k-1)": 1.7813,
        "y(k-2)": -0.7962,
        "u(k-1)": 0.0339,
        "u(k-2)": 0.0338,
        "y(k-1)*u(k-1)": -0.1597,
        "y(k-1)*u(k-2)": -0.1396,
        "y(k-2)*u(k-1)": 0.1297,
        "y(k-2)*u(k-2)": 0.1086,
        "y(k-2)^2": 0.0085,
    }
    rng = np.random.default_rng(1)
    record = simulate(truth, {"u": rng.uniform(-1, 1, 60)}, np.zeros(60))
    model = fit(record, "y", polynomial(lags("y", 1, 2) + lags("u", 1, 2), 2), n_terms=9)
    assert coefficients(model) == pytest.approx(truth, rel=1e-6)


def test_hysteresis_model_of_2016_with_three_inputs_comes_back() -> None:
    """Martins and Aguirre, Mech. Systems and Signal Processing 75 (2016) 607, as in NonSysID `Examples`."""
    truth = {
        "y(k-1)": 0.8536,
        "u3(k-1)": 0.0388,
        "u2(k-1)*u1(k-1)": 0.6143,
        "u3(k-1)*u2(k-1)*y(k-1)": -0.4407,
    }
    rng = np.random.default_rng(2)
    b, a = butter(4, 5 / 250)
    u1, u2 = lfilter(b, a, rng.normal(size=(2, 5000)))
    inputs = {"u1": 0.5 * u1 + 1.6, "u2": u2, "u3": np.sign(u2)}
    record = simulate(truth, inputs, np.zeros(5000))
    part = {name: values[500:700] for name, values in record.items()}  # 200 samples, as there
    model = fit(part, "y", polynomial(["y(k-1)", "u1(k-1)", "u2(k-1)", "u3(k-1)"], 3), n_terms=4)
    expected = {frozenset(t): v for t, v in zip(Terms.parse(*truth), truth.values(), strict=True)}
    found = {frozenset(t): v for t, v in zip(model.terms, model.theta.tolist(), strict=True)}
    assert found == pytest.approx(expected, rel=1e-6)


def test_fastcan_prints_what_the_free_run_refinement_finds() -> None:
    """Docstring of fastcan.narx.NARX 0.6 (MIT): data from its seed; it prints three digits."""
    rng = np.random.default_rng(12345)
    e = rng.normal(0, 0.1, 1000)
    u = rng.uniform(0, 1, 1003)
    y = np.zeros(1003)
    for i in range(3, 1003):
        y[i] = 0.5 * y[i - 1] + 0.7 * u[i - 2] + 1.5 * u[i - 1] * u[i - 3] + 1
    record = {"y": y[3:] + e, "u": u[3:]}
    terms = Terms.parse("1", "y(k-1)", "u(k-2)", "u(k-1)*u(k-3)")
    model = fit(record, "y", terms, n_terms=4, estimator="simulation")
    printed = {"1": 1.008, "y(k-1)": 0.498, "u(k-2)": 0.701, "u(k-1)*u(k-3)": 1.496}
    assert coefficients(model) == pytest.approx(printed, abs=6e-4)


def test_fastcan_example_with_two_inputs_and_lag_0_comes_back() -> None:
    """fastcan `examples/plot_narx.py` (MIT): noise on the output only, so in free run."""
    rng = np.random.default_rng(12345)
    e = rng.normal(0, 0.1, 1000)
    u0, u1 = rng.uniform(0, 1, 1003), rng.normal(0, 0.1, 1003)
    y = np.zeros(1003)
    for i in range(3, 1003):
        y[i] = 0.5 * y[i - 1] + 0.3 * u0[i] ** 2 + 2 * u0[i - 1] * u0[i - 3] + 1.5 * u0[i - 2] * u1[i - 3] + 1
    record = {"y": y[3:] + e, "u0": u0[3:], "u1": u1[3:]}
    dictionary = polynomial(lags("y", 1, 3) + lags("u0", 0, 3) + lags("u1", 0, 3), 2)
    truth = {"1": 1, "y(k-1)": 0.5, "u0(k)^2": 0.3, "u0(k-1)*u0(k-3)": 2, "u0(k-2)*u1(k-3)": 1.5}
    assert len(dictionary) == 78
    model = fit(record, "y", dictionary, n_terms=5, estimator="simulation", search="forward", keep=["1"])
    assert coefficients(model) == pytest.approx(truth, abs=0.12)


@pytest.mark.parametrize("ma", [0.0, 0.8])
def test_sysidentpy_single_input_generator(ma: float) -> None:
    """sysidentpy.utils.generate_data.get_siso_data 0.9 (BSD-3); coloured noise is e(k) + 0.8 e(k-1)."""
    truth = {"y(k-1)": 0.2, "y(k-1)*x(k-1)": 0.1, "x(k-2)": 0.9}
    rng = np.random.default_rng(3)
    record = simulate(truth, {"x": rng.uniform(-1, 1, 5000)}, rng.normal(0, 0.05, 5000), ma=ma)
    model = fit(record, "y", polynomial(lags("y", 1, 2) + lags("x", 1, 2), 2), noise=1 if ma else 0)
    assert coefficients(model) == pytest.approx(truth, abs=0.01)
    if ma:
        assert model.noise_theta[0] == pytest.approx(0.8, abs=0.03)


def test_constant_is_not_halved_beside_noise_terms() -> None:
    """SysIdentPy 0.9's unbiased least squares returns 0.499 for a constant of 1 here."""
    truth = {"1": 1.0, "y(k-1)": 0.2, "x(k-2)": 0.9}
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        record = simulate(truth, {"x": rng.uniform(-1, 1, 1000)}, rng.normal(0, 0.3, 1000), ma=0.8)
        model = fit(record, "y", Terms.parse(*truth), n_terms=3, noise=1, estimator="els")
        found.append(coefficients(model)["1"])
    assert np.mean(found) == pytest.approx(1.0, abs=0.01)


def test_column_that_starts_at_zero_keeps_its_err() -> None:
    """SysIdentPy 0.9's Householder step takes sign(0) = 0, so ERR is wrong for a first sample of exactly 0."""
    rng = np.random.default_rng(4)
    x = np.r_[0.0, rng.normal(size=999)]
    data = {"x": x, "w": np.r_[0.0, rng.normal(size=999)]}
    y = 2 * data["x"] + 0.4 * data["w"] + 0.1 * data["w"] ** 2
    model = fit({**data, "z": y}, "z", polynomial(["x", "w"], 2), n_terms=3)
    assert model.err.sum() == pytest.approx(1.0, abs=1e-12)
    assert model.terms.names[0] == "x" and model.err[0] > 0.9


def test_sysidentpy_two_input_generator() -> None:
    """sysidentpy.utils.generate_data.get_miso_data 0.9 (BSD-3)."""
    truth = {"y(k-1)^2": 0.4, "y(k-1)*x1(k-1)": 0.1, "x2(k-1)": 0.6, "x1(k-1)*x2(k-2)": -0.3}
    rng = np.random.default_rng(5)
    inputs = {"x1": rng.uniform(-1, 1, 5000), "x2": rng.uniform(-1, 1, 5000)}
    record = simulate(truth, inputs, rng.normal(0, 0.05, 5000))
    model = fit(record, "y", polynomial(lags("y", 1, 2) + lags("x1", 1, 2) + lags("x2", 1, 2), 2))
    assert coefficients(model) == pytest.approx(truth, abs=0.02)


@pytest.mark.parametrize(
    "truth,source,sigma", [(MAO_BILLINGS, white_input, 0.02), (PIRODDI_SPINELLI, slow_input, 0.02**0.5)]
)
def test_benchmark_systems_of_structure_detection(truth, source, sigma) -> None:
    """Mao and Billings 1997; Piroddi and Spinelli 2003."""
    rng = np.random.default_rng(6)
    record = simulate(truth, {"u": source(rng, 2000)}, rng.normal(0, sigma, 2000))
    model = fit(record, "y", CUBIC)
    assert coefficients(model) == pytest.approx(truth, abs=0.03)


def column(name: str, index: int | None = None) -> np.ndarray:
    with gzip.open(REFERENCE / name, "rt") as file:
        rows = [line.replace(",", " ").split() for line in file]
    numbers = [row for row in rows if row and parses_as_number(row[0])]
    return np.array([float(row[index or 0]) for row in numbers])


@needs_data
def test_buck_converter_is_followed_in_free_run_on_other_data() -> None:
    """Aguirre, Donoso-Garcia and Santos-Filho, IEEE Trans. CAS-I 47 (2000): identification and validation files."""

    def data(name: str) -> dict[str, np.ndarray]:
        return {"u": column(name, 1), "y": column(name, 2)}

    model = fit(data("buck_id.csv.gz"), "y", polynomial(lags("y", 1, 2) + lags("u", 1, 2), 1))
    (free,) = scores(model, data("buck_valid.csv.gz"), ["free"])
    assert free.model.rrse < 0.5 < free.persistence.rrse


@needs_data
def test_f16_ground_vibration_is_followed_as_closely_as_published() -> None:
    """SysIdentPy tutorial "F-16 aircraft" (data: Noel and Schoukens 2017): free run, RRSE .291070, 39 candidates."""
    x1, x2, y = (column("f-16.txt.gz", i) for i in range(3))
    first, second = halves({"x1": x1, "x2": x2, "y": y})
    terms = polynomial(lags("y", 1, 20) + lags("x1", 1, 9) + lags("x2", 1, 9), 1)
    assert len(terms) == 39 and len(first) == 16384
    greedy = fit(first, "y", terms, search="forward", criterion="bic")
    assert greedy.terms.names[0] == "y(k-1)" and greedy.err[0] == pytest.approx(0.94338, abs=6e-6)
    (free,) = scores(greedy, second, ["free"])
    assert free.model.rrse == pytest.approx(0.29107, abs=5e-4)
