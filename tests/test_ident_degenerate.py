"""What is wrong with the data is said: in an error, or in the notes of the model."""

from __future__ import annotations

import re

import numpy as np
import pytest
from ident_samples import CUBIC, moments_of, simulate

from robotmodic_ident import IdentError, Moments, Terms, fit, independent, lags, polynomial


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_cos_squared_plus_sin_squared_leaves_one_of_them(rng) -> None:
    phi = rng.uniform(-3, 3, 200)
    terms = Terms.parse("1", "sin(phi)^2", "cos(phi)", "cos(phi)^2", "sin(phi)")
    moments = Moments(terms, 1).add({"phi": phi}, np.zeros(200))
    kept, found = independent(moments)
    assert [terms.names[i] for i in kept] == ["1", "cos(phi)", "cos(phi)^2", "sin(phi)"]
    assert [(d.term, d.on) for d in found] == [("sin(phi)^2", ("1", "cos(phi)^2"))]
    for order in (terms, terms[[3, 1, 0, 4, 2]]):  # whatever the order of the dictionary
        model = fit({"phi": phi, "z": 2 + np.sin(phi) ** 2}, "z", order)
        assert dict(zip(model.terms.names, model.theta, strict=True)) == pytest.approx(
            {"1": 3, "cos(phi)^2": -1}
        )
        assert any("sin(phi)^2 is an exact combination of 1, cos(phi)^2" in note for note in model.notes)


def test_input_of_two_levels_has_no_square(rng) -> None:
    u = np.where(rng.random(400) < 0.5, 1.0, 3.0)
    record = simulate({"y(k-1)": 0.5, "u(k-1)^2": 0.1}, {"u": u}, 0.01 * rng.normal(size=400))
    model = fit(record, "y", polynomial(["y(k-1)", "u(k-1)"], 2))
    assert dict(zip(model.terms.names, model.theta, strict=True)) == pytest.approx(
        {"y(k-1)": 0.5, "u(k-1)": 0.4, "1": -0.3}, abs=0.02
    )  # u^2 = 4 u - 3
    assert any(note.startswith("u(k-1)^2 is an exact combination of 1, u(k-1)") for note in model.notes)


def test_constant_and_doubled_columns_are_named(rng) -> None:
    x = rng.normal(size=100)
    record = {"x": x, "twin": x, "still": np.full(100, 4.2), "none": np.zeros(100), "z": 1 + 2 * x}
    model = fit(record, "z", Terms.parse("1", "still", "x", "twin", "none"))
    assert set(model.terms.names) == {"1", "twin"}  # of equals, the first by name
    notes = " ".join(model.notes)
    assert "x is an exact combination of twin" in notes and "still is an exact combination of 1" in notes
    assert "none is zero in every row" in notes


def test_slow_columns_are_not_taken_for_dependent(rng) -> None:
    t = np.arange(2000) / 30
    x = np.sin(0.3 * t) + 0.2 * np.sin(1.1 * t)  # 30 Hz: steps of a hundredth
    rows = {"x(k)": x[2:], "x(k-1)": x[1:-1], "x(k-2)": x[:-2]}
    moments = Moments(Terms.parse("1", *rows), 1).add(rows, np.zeros(1998))
    assert len(independent(moments)[0]) == 4


def test_without_noise_the_law_itself_is_no_dependence(rng) -> None:
    record = simulate(
        {"y(k-1)": 0.5, "u(k-2)": 1.0, "u(k-1)^2": 0.1}, {"u": rng.uniform(-1, 1, 400)}, np.zeros(400)
    )
    model = fit(record, "y", polynomial(lags("y", 1, 3) + lags("u", 0, 3), 2))
    assert model.notes == ()
    assert set(model.terms.names) == {"y(k-1)", "u(k-2)", "u(k-1)^2"}


def test_fewer_samples_than_candidates_are_marked(rng) -> None:
    record = simulate({"y(k-1)": 0.5, "u(k-1)": 1.0}, {"u": rng.normal(size=40)}, 0.1 * rng.normal(size=40))
    model = fit(record, "y", CUBIC)
    assert any("38 samples for 56 candidate terms" in note for note in model.notes)
    assert len(model.terms) <= 19 and np.isfinite(model.stderr).all()


def test_output_that_is_never_known_is_an_error(rng) -> None:
    with pytest.raises(IdentError, match="output y is unknown"):
        fit({"y": np.full(50, np.nan), "u": rng.normal(size=50)}, "y", Terms.parse("1", "u(k)"))


def test_input_that_is_never_known_is_an_error(rng) -> None:
    with pytest.raises(IdentError, match="no row remains"):
        fit({"y": rng.normal(size=50), "u": np.full(50, np.nan)}, "y", Terms.parse("1", "u(k)"))


def test_record_shorter_than_the_lags_is_named_and_all_of_them_are_an_error(rng) -> None:
    long, short = ({"y": rng.normal(size=n), "u": rng.normal(size=n)} for n in (60, 4))
    terms = Terms.parse("1", "u(k-5)")
    model = fit([long, short], "y", terms)
    assert "record 1 gives no sample: 4 samples, look back 5" in model.notes
    with pytest.raises(IdentError, match="look back of 5"):
        fit(short, "y", terms)


def test_output_that_explains_itself_is_refused(rng) -> None:
    record = {"y": rng.normal(size=50)}
    with pytest.raises(IdentError, match="contains the current y"):
        fit(record, "y", Terms.parse("y(k)", "y(k-1)"))


def test_kept_term_that_depends_on_others_is_refused(rng) -> None:
    x = rng.normal(size=50)
    with pytest.raises(IdentError, match="exact combination of other terms"):
        fit({"a": x, "b": x, "z": x}, "z", Terms.parse("a", "b"), keep=["b"])


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_coordinates_100_km_from_the_origin_give_the_same_terms(offset: float) -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-3, 3, 800), rng.uniform(-2, 2, 800)
    z = 1 + 2 * x - x * y + 0.3 * y**3 + 0.01 * rng.normal(size=800)
    record = {"x": x + offset, "y": y - offset, "z": z}
    model = fit(record, "z", polynomial(["x", "y"], 3))
    found = dict(zip(model.terms.names, model.theta, strict=True))
    assert found == pytest.approx({"1": 1.0, "x": 2.0, "x*y": -1.0, "y^3": 0.3}, abs=0.003)
    assert model.scale.pair("x")[0] == offset  # x stands for x - 100 km
    np.testing.assert_allclose(model.predict_osa(record), z, atol=0.05)


@pytest.mark.parametrize("offset", [1e5, 5e6, 1e9])
@pytest.mark.parametrize("noise", [0, 1])
def test_an_output_that_is_a_far_coordinate_gives_the_same_terms(offset: float, noise: int) -> None:
    rng = np.random.default_rng(5)
    v = rng.uniform(-1, 1, 1200)
    truth = {"1": 0.4, "x(k-1)": 0.9, "v(k-1)": 0.5, "v(k-1)^2": -0.2}
    near = simulate(
        {n.replace("x", "y"): t for n, t in truth.items()}, {"v": v}, 0.02 * rng.normal(size=1200)
    )
    record = {"v": v, "x": near["y"] + offset}  # a northing in UTM is 5,000 km and more
    model = fit(record, "x", polynomial(["x(k-1)", "v(k-1)"], 2), noise=noise)
    assert set(model.terms.names) == set(truth)
    found = dict(zip(model.terms.names, model.theta, strict=True))
    assert found["x(k-1)"] == pytest.approx(0.9, abs=0.005)
    assert found["v(k-1)"] == pytest.approx(0.5, abs=0.01)
    assert any("err refers to x - " in note for note in model.notes)
    assert 0.9 < model.err.sum() <= 1
    assert np.nanstd(model.residuals(record)) == pytest.approx(0.02, rel=0.1)
    assert f"(x(k-1) - {offset:.0f})" in model.equation() or offset == 1e5
    constant = re.search(r"= (\d+\.?\d*) ", model.equation())
    assert constant and float(constant[1]) == pytest.approx(found["1"], abs=0.01)  # not 5e+06


def test_agreement_with_a_long_double_oracle_to_12_digits() -> None:
    rng = np.random.default_rng(4)
    record = simulate(
        {"y(k-1)": 0.5, "u(k-2)": 1.0, "u(k-1)^2": 0.1},
        {"u": rng.uniform(-1, 1, 900)},
        0.1 * rng.normal(size=900),
    )
    model = fit(record, "y", CUBIC, n_terms=8)
    rows = moments_of(record, CUBIC).terms.matrix
    columns = {
        f"{v}(k-{lag})" if lag else f"{v}(k)": record[v][2 - lag : 900 - lag]
        for v in "yu"
        for lag in range(3)
    }
    phi = rows(columns)[:, [CUBIC.names.index(n) for n in model.terms.names]].astype(np.longdouble)
    target = record["y"][2:].astype(np.longdouble)
    basis, z = phi.copy(), []
    R = np.eye(8, dtype=np.longdouble)
    for j in range(8):  # modified Gram-Schmidt, twice
        for _ in range(2):
            for i in range(j):
                share = basis[:, i] @ basis[:, j]
                R[i, j] = R[i, j] + share if i < j else share
                basis[:, j] -= share * basis[:, i]
        R[j, j] = np.sqrt(basis[:, j] @ basis[:, j])
        basis[:, j] /= R[j, j]
        z.append(basis[:, j] @ target)
    theta = np.zeros(8, dtype=np.longdouble)
    for i in range(7, -1, -1):
        theta[i] = (z[i] - R[i, i + 1 :] @ theta[i + 1 :]) / R[i, i]
    np.testing.assert_allclose(model.theta, theta.astype(float), rtol=1e-12, atol=1e-13)
    err = np.array([float(v**2) for v in z]) / float(target @ target)
    np.testing.assert_allclose(model.err, err, atol=1e-12)


def test_values_whose_squares_overflow_or_vanish_are_refused(rng) -> None:
    u = rng.normal(size=50)
    with pytest.raises(IdentError, match="use larger units"):
        fit({"u": u, "y": 1e200 * u}, "y", Terms.parse("u(k)"))
    with pytest.raises(IdentError, match="use smaller units"):
        fit({"u": u, "y": 1e-200 * u}, "y", Terms.parse("u(k)"))
