"""Narmax: planted systems come back, predictions are what the equation says, files round-trip."""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotmodic_ident import IdentError, Narmax, Record, Scale, Terms, fit, lags, polynomial


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


REFERENCE = Path(__file__).parents[2] / "shared" / "data" / "narmax-reference"
DICTIONARY = polynomial(lags("y", 1, 3) + lags("u", 0, 3), 2)


def planted(rng: np.random.Generator, n: int = 400, noise: float = 0.0) -> dict[str, np.ndarray]:
    """Run y(k) = 0.5 y(k-1) + u(k-2) + 0.1 u(k-1)^2 + e(k)."""
    u, y = rng.uniform(-1, 1, n), np.zeros(n)
    e = noise * rng.normal(size=n)
    for k in range(2, n):
        y[k] = 0.5 * y[k - 1] + u[k - 2] + 0.1 * u[k - 1] ** 2 + e[k]
    return {"y": y, "u": u}


@pytest.mark.parametrize("seed", range(3))
def test_planted_system_is_recovered_and_printed(seed: int) -> None:
    model = fit(planted(np.random.default_rng(seed)), "y", DICTIONARY)
    assert model.equation() == "y(k) = u(k-2) + 0.5*y(k-1) + 0.1*u(k-1)^2"
    assert model.err.sum() == pytest.approx(1.0)
    assert model.stop == "ebic" and model.notes == ()


def test_coefficients_lie_within_their_standard_errors() -> None:
    truth = {"u(k-2)": 1.0, "y(k-1)": 0.5, "u(k-1)^2": 0.1}
    scores = []
    for seed in range(40):
        model = fit(planted(np.random.default_rng(seed), noise=0.05), "y", Terms.parse(*truth), n_terms=3)
        scores += [
            (t - truth[n]) / s for n, t, s in zip(model.terms.names, model.theta, model.stderr, strict=True)
        ]
    assert np.std(scores) == pytest.approx(1.0, abs=0.2)  # 120 scores: 0.065 at one sigma
    assert model.sigma == pytest.approx(0.05, rel=0.1)


def test_two_records_give_what_each_gives_and_no_lag_crosses_between(rng) -> None:
    first, second = planted(rng, 150), planted(rng, 150)
    second["y"] = second["y"]
    both = fit([first, second], "y", DICTIONARY)
    assert both.equation() == fit(first, "y", DICTIONARY).equation()
    assert both.n_samples == 2 * (150 - 3)


def test_free_run_follows_a_noise_free_system_and_osa_uses_the_measured_past(rng) -> None:
    record = planted(rng)
    model = fit(record, "y", DICTIONARY)
    free, osa = model.predict_mpo(record), model.predict_osa(record)
    assert np.isnan(free[:2]).all() and np.isfinite(free[2:]).all()
    np.testing.assert_allclose(free[2:], record["y"][2:], atol=1e-9)
    np.testing.assert_allclose(osa[2:], record["y"][2:], atol=1e-12)
    shifted = {**record, "y": record["y"] + np.where(np.arange(400) == 200, 1.0, 0.0)}
    assert model.predict_osa(shifted)[201] == pytest.approx(osa[201] + 0.5)
    np.testing.assert_allclose(model.predict_mpo(shifted)[2:], free[2:])  # only the start is measured


def test_free_run_restarts_after_a_gap(rng) -> None:
    record = planted(rng, 100)
    stamps = np.arange(100) * 0.1 + np.where(np.arange(100) >= 50, 5.0, 0.0)
    model = fit(record, "y", DICTIONARY)
    free = model.predict_mpo(Record(signals=record, stamps=stamps))
    assert np.flatnonzero(np.isnan(free)).tolist() == [0, 1, 50, 51]
    np.testing.assert_allclose(free[52:], record["y"][52:], atol=1e-9)


def test_diverging_free_run_ends_without_a_warning() -> None:
    model = Narmax(
        output="y",
        terms=Terms.parse("y(k-1)^2"),
        theta=np.array([2.0]),
        covariance=np.zeros((1, 1)),
        err=np.array([1.0]),
        sigma=0.0,
        n_samples=1,
    )
    free = model.predict_mpo({"y": np.full(50, 3.0)})
    assert free[1] == 18.0 and np.isnan(free[-1])


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("centre", [0.0, 3.0, 1e3, -1e6])
def test_the_printed_equation_says_what_the_model_says(centre: float, noise: float) -> None:
    rng = np.random.default_rng(6)
    x, u = centre + rng.uniform(-1, 1, 400), rng.uniform(-1, 1, 400)
    y = 2 - (x - centre) ** 2 + 0.5 * (x - centre) * u + noise * rng.normal(size=400)
    model = fit({"x": x, "u": u, "y": y}, "y", polynomial(["x", "u"], 2))
    text = model.equation(digits=6)
    right = text.partition(" = ")[2].replace("^", "**")
    said = np.array([eval(right, {}, {"x": a, "u": b}) for a, b in zip(x, u, strict=True)])
    np.testing.assert_allclose(said, model.predict_osa({"x": x, "u": u, "y": y}), atol=0.02)  # 1 % of 2
    assert ("(x" in text) == (abs(centre) > 3)


def test_a_known_offset_is_multiplied_out_where_digits_allow() -> None:
    form = Narmax(
        output="z", terms=Terms.parse("1", "x^2"), theta=np.array([1.0, 2.0]), covariance=np.eye(2),
        err=np.zeros(2), sigma=0.1, n_samples=9, scale=Scale(("x",), (50.0,), (1.0,)),
    )  # fmt: skip
    assert form.equation(digits=4) == "z = 1 + 2*(x - 50)^2"
    assert form.equation(digits=8) == "z = 5001 - 200*x + 2*x^2"
    assert form.equation(scaled=True) == "z = 1 + 2*x^2"


def test_centred_model_is_the_same_function_in_the_users_units(rng) -> None:
    data = {"x": rng.uniform(90, 110, 500)}
    data["z"] = 3 - 0.2 * data["x"] + 0.01 * data["x"] ** 2
    model = fit(data, "z", polynomial(["x"], 2), n_terms=3, scale=Scale.of({"x": data["x"]}))
    plain = model.in_user_units()
    assert dict(zip(plain.terms.names, plain.theta, strict=True)) == pytest.approx(
        {"1": 3.0, "x": -0.2, "x^2": 0.01}, rel=1e-6
    )
    np.testing.assert_allclose(plain.predict_osa(data), model.predict_osa(data), rtol=1e-10)
    assert model.equation(digits=4) == "z = 3 - 0.2*x + 0.01*x^2"


class Frame:
    """A table of columns, as pandas has it: no Mapping."""

    def __init__(self, columns: dict[str, list[float]]) -> None:
        self.columns = columns

    def items(self) -> Iterable[tuple[str, list[float]]]:
        return self.columns.items()

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)


def test_a_data_frame_is_a_record(rng: np.random.Generator) -> None:
    data = planted(rng)
    frame: Any = Frame({name: values.tolist() for name, values in data.items()})
    assert fit(frame, "y", DICTIONARY).equation() == fit(data, "y", DICTIONARY).equation()


@pytest.mark.parametrize(
    ("records", "words"),
    [
        ("run.csv", "a record is of type str, expected a mapping of names of signals to arrays"),
        (None, "a record is of type NoneType"),
        (np.zeros((9, 2)), "a record is of type ndarray"),
        ({"y": ["a"] * 9, "u": np.zeros(9)}, "signal y holds no real numbers"),
        ({"y": np.zeros(9), "u": 1j * np.zeros(9)}, "signal u holds no real numbers"),
    ],
)
def test_what_is_no_record_is_refused(records: Any, words: str) -> None:
    with pytest.raises(IdentError, match=f"^{words}"):
        fit(records, "y", DICTIONARY)


def test_terms_that_are_a_list_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(IdentError, match="terms is of type list, expected Terms, as `polynomial"):
        fit(planted(rng), "y", ["y(k-1)"])  # type: ignore[arg-type]


def test_file_gives_the_same_model(rng, tmp_path: Path) -> None:
    record = planted(rng, noise=0.01)
    model = fit(record, "y", DICTIONARY)
    model.save(tmp_path / "model.json")
    again = Narmax.load(str(tmp_path / "model.json"))
    assert again.equation() == model.equation()
    np.testing.assert_array_equal(again.predict_mpo(record), model.predict_mpo(record))
    np.testing.assert_array_equal(again.covariance, model.covariance)
    (tmp_path / "bad.json").write_text('{"format": "robotmodic-narmax-1"}')
    with pytest.raises(IdentError, match="not a model"):
        Narmax.load(tmp_path / "bad.json")


# SysIdentPy tutorial "electromechanical system identification - overview": every 500th sample (its table reader
# takes the first line for a header), first half, degree 2, five lags each; the order is the published one
PUBLISHED = (
    ("y(k-1)", 9.86000310e-01),
    ("x1(k-1)", 7.94813324e-03),  # published as x1(k-1)^2: the input has two levels, so both are one column
    ("y(k-2)^2", 2.50921747e-03),
    ("y(k-1)*x1(k-1)", 1.43297462e-03),
    ("y(k-2)", 1.02774988e-03),
    ("y(k-2)*x1(k-1)", 5.35195948e-04),
    ("y(k-1)*y(k-3)", 3.46258211e-04),
    ("x1(k-4)", 6.91218347e-05),  # published as x1(k-4)^2
    ("y(k-3)*x1(k-1)", 2.83751722e-05),
    ("y(k-1)*y(k-4)", 2.01620114e-05),
    ("x1(k-1)*x1(k-4)", 1.09189469e-05),
    ("y(k-2)*y(k-4)", 1.27131624e-05),
    ("y(k-1)*x1(k-5)", 6.53111914e-06),
    ("x1(k-2)*x1(k-3)", 4.24331903e-06),
    ("x1(k-1)*x1(k-2)", 6.41299982e-06),
    ("x1(k-3)", 6.43059002e-06),
    ("y(k-5)*x1(k-1)", 2.76577885e-06),
    ("y(k-1)*x1(k-3)", 2.79523223e-06),
    ("y(k-1)*x1(k-4)", 1.62218750e-06),
    ("1", 1.13359933e-06),
)


@pytest.mark.skipif(not REFERENCE.is_dir(), reason=f"reference data not found at {REFERENCE}")
def test_published_err_of_the_electromechanical_generator() -> None:
    def column(name: str) -> np.ndarray:
        with gzip.open(REFERENCE / name, "rt") as file:
            return np.array(file.read().split()[1:], dtype=np.float64)[::500]

    x, y = column("x_cc.csv.gz"), column("y_cc.csv.gz")
    half = len(x) // 2
    terms = polynomial(lags("y", 1, 5) + lags("x1", 1, 5), 2)
    assert len(terms) == 66
    model = fit({"y": y[:half], "x1": x[:half]}, "y", terms, n_terms=20, search="forward")
    assert model.terms.names == tuple(name for name, _ in PUBLISHED)
    published = np.array([value for _, value in PUBLISHED])
    np.testing.assert_allclose(model.err, published, rtol=1e-8, atol=5e-15)  # nine digits are printed
    free = model.predict_mpo({"y": y[half:], "x1": x[half:]})[5:]
    rest = y[half + 5 :]
    rrse = np.sqrt(((rest - free) ** 2).sum() / ((rest - rest.mean()) ** 2).sum())
    assert rrse < 0.07  # published .0568 with recursive least squares
