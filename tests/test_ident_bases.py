"""Shapes: compiled and plain values agree, slopes are slopes, and scaled names mean the same in the user's units."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further

from robotmodic_ident import BASES, Scale, Terms, bspline, chebyshev, fit, legendre, polynomial, wavelet
from robotmodic_ident.basis_functions import evaluate
from robotmodic_ident.prediction import kernels
from robotmodic_ident.prediction.recursion import KIND_OF_FUNCTION

SHAPES = [
    ("P", 1, (0, 0)),
    ("P", 4, (0, 0)),
    ("T", 1, (0, 0)),
    ("T", 5, (0, 0)),
    ("B", 3, (0, 8)),
    ("B", 3, (4, 8)),
    ("B", 3, (7, 8)),
    ("B", 1, (2, 5)),
    ("W", 0, (0, 0)),
    ("W", 2, (3, 0)),
]


@pytest.mark.parametrize("letter,order,part", SHAPES)
def test_compiled_shape_equals_plain_numpy_and_its_slope_is_the_slope(letter, order, part) -> None:
    t = np.linspace(-0.999, 0.999, 333)  # no knot among them
    value = [kernels.shape(KIND_OF_FUNCTION[letter], order, *part, x) for x in t]
    np.testing.assert_allclose(value, evaluate(letter, order, part, t), atol=1e-13)
    slope = [kernels.slope(KIND_OF_FUNCTION[letter], order, *part, x) for x in t]
    up, down = evaluate(letter, order, part, t + 1e-6), evaluate(letter, order, part, t - 1e-6)
    np.testing.assert_allclose(slope, (up - down) / 2e-6, atol=1e-7)


def test_splines_of_a_signal_are_positive_and_sum_to_one() -> None:
    t = np.linspace(-1, 1, 101)
    values = np.array([evaluate("B", 3, (i, 9), t) for i in range(9)])
    assert (values >= 0).all()
    np.testing.assert_allclose(values.sum(axis=0), 1.0, atol=1e-14)


def test_orthogonal_polynomials_are_orthogonal() -> None:
    t, w = np.polynomial.legendre.leggauss(12)
    P = np.array([evaluate("P", n, (0, 0), t) for n in range(1, 6)])
    np.testing.assert_allclose((P * w) @ P.T, np.diag(2 / (2 * np.arange(1, 6) + 1)), atol=1e-14)
    t = np.cos((np.arange(12) + 0.5) * np.pi / 12)
    T = np.array([evaluate("T", n, (0, 0), t) for n in range(1, 6)])
    np.testing.assert_allclose(T @ T.T, 6 * np.eye(5), atol=1e-13)


@pytest.mark.parametrize("name", ["polynomial", "legendre", "chebyshev"])
def test_polynomial_families_span_the_same_functions(name: str) -> None:
    rng = np.random.default_rng(0)
    data = {"x": rng.uniform(5, 9, 300), "y": rng.uniform(-2, 0, 300)}
    scale = Scale.of(data)
    phi = BASES[name](["x", "y"], 4).matrix(data, scale)
    other = polynomial(["x", "y"], 4).matrix(data, scale)
    joint = np.linalg.matrix_rank(np.column_stack([phi, other]))
    assert joint == np.linalg.matrix_rank(phi) == 15


@pytest.mark.parametrize("basis", [legendre, chebyshev, bspline, wavelet])
def test_model_in_the_users_units_is_the_same_function_and_its_names_parse_back(basis) -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(2, 10, 400)
    record = {"x": x, "z": np.abs(x - 5) + 0.01 * rng.normal(size=400)}
    model = fit(record, "z", basis(["x"], 5), scale=Scale.between({"x": (2, 10)}))
    plain = model.in_user_units()
    assert plain.scale.variables == ()
    assert Terms.parse(*plain.terms.names) == plain.terms
    np.testing.assert_allclose(plain.predict_osa(record), model.predict_osa(record), atol=1e-12)
    assert np.std(record["z"] - model.predict_osa(record)) < 0.25  # a kink of 5 m is within reach of all


@pytest.mark.parametrize("edge", [0.2, *further(0.1, 0.3)])
def test_wavelets_describe_an_edge_better_than_as_many_powers(edge: float) -> None:
    x = np.linspace(-1, 1, 2000)
    record = {"x": x, "z": np.where(x > edge, 3.0, 1.0)}
    rest = {}
    for name, degree in (("polynomial", 12), ("wavelet", 6)):
        model = fit(record, "z", BASES[name](["x"], degree), n_terms=12, scale=Scale.between({"x": (-1, 1)}))
        rest[name] = model.sigma
    # 0.72 to 0.75 at these edges; which of the nearly equal sets is found depends on the rounding of the processor
    assert rest["wavelet"] < 0.85 * rest["polynomial"]


def test_products_of_families_have_every_pair_once() -> None:
    both = bspline(["x"], 2) * bspline(["y"], 3)
    assert len(both) == 5 * 6
    assert "B3_0of5(x)*B3_1of6(y)" in both.names


@pytest.mark.parametrize(
    "text",
    ["P0(x)", "P2_1(x)", "B3(x)", "B3_8of8(x)", "B5_0of4(x)", "W2(x)", "P2((x-1)/2", "P2(x-1)/2)", "x)/2"],
)
def test_misspelt_shapes_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="term"):
        Terms.parse(text)


@pytest.mark.parametrize(
    "text",
    ["P3(y(k-1))^2*u(k)", "T2((x-0.5)/2.0)", "B3_1of7((u(k-2)+3.0)/1e-05)", "W0_1(x)", "P3(k-1)", "T2(k)"],
)
def test_shapes_print_as_they_are_written(text: str) -> None:
    assert Terms.parse(text).names == (text,)


def test_variable_called_like_a_shape_is_a_variable() -> None:
    (factor,) = Terms.parse("P3(k-1)").table[0]
    assert factor.variable == "P3" and factor.lag == 1
