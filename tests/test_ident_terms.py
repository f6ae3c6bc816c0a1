"""Terms, bases, scales and lags."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotmodic_ident import BASES, IdentError, Record, Scale, Terms, fourier, lagged, lags, polynomial
from robotmodic_ident.notation.expand import expand


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


SIGNALS = st.tuples(st.sampled_from(["x", "y", "u1", "cmd_v"]), st.none() | st.integers(0, 12))


@st.composite
def term_names(draw: st.DrawFn) -> str:
    """Write a term as our own names are written: each signal once."""
    parts = []
    for variable, lag in draw(st.lists(SIGNALS, unique=True, max_size=3)):
        signal = variable if lag is None else f"{variable}(k-{lag})" if lag else f"{variable}(k)"
        if draw(st.booleans()):
            h = draw(st.integers(1, 5))
            signal = f"{draw(st.sampled_from(['cos', 'sin']))}({'' if h == 1 else f'{h}*'}{signal})"
        power = draw(st.integers(1, 4))
        parts.append(signal if power == 1 else f"{signal}^{power}")
    return "*".join(parts) or "1"


@given(st.lists(term_names(), min_size=1, max_size=6))
def test_names_parse_back(names: list[str]) -> None:
    unique = list({frozenset(name.split("*")) if "(" not in name else name: name for name in names}.values())
    try:
        terms = Terms.parse(*unique)
    except IdentError as exc:
        assert "is the same as" in str(exc)  # u*x and x*u
        return
    assert Terms.parse(*terms.names) == terms
    assert terms.names == tuple(unique)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("y(k-1)*u(k)^2", "y(k-1)*u(k)^2"),
        (" y( k - 1 ) * u(k) ^ 2 ", "y(k-1)*u(k)^2"),
        ("y(k-1)*y(k-1)", "y(k-1)^2"),
        ("y(k-0)", "y(k)"),
        ("cos(2*phi)*x^2", "cos(2*phi)*x^2"),
        ("1*phi", None),
        ("y(k+1)", None),
        ("x^^2", None),
        ("x*", None),
        ("", None),
        ("cos(x", None),
        ("x)", None),
        ("x^0", None),
    ],
)
def test_text_is_read_or_refused_with_the_text(text: str, name: str | None) -> None:
    if name is None:
        with pytest.raises(IdentError, match=r"term|cannot read"):
            Terms.parse(text)
    else:
        assert Terms.parse(text).names == (name,)


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES.keys())
@pytest.mark.parametrize("degree", [0, 1, 4])
def test_basis_has_as_many_names_as_columns_and_none_depends_on_others(basis, degree, rng) -> None:
    terms = basis(["x", "y(k-1)"], degree)
    phi = terms.matrix({"x": rng.uniform(-2, 2, 400), "y(k-1)": rng.uniform(-2, 2, 400)}, n=400)
    assert phi.shape == (400, len(terms.names))
    assert Terms.parse(*terms.names) == terms
    assert np.linalg.matrix_rank(phi) == len(terms)


def test_columns_are_what_their_names_say(rng) -> None:
    x, phi = rng.normal(size=50), rng.uniform(-3, 3, 50)
    terms = Terms.parse("1", "x^3", "x^2*cos(2*phi)", "sin(phi)^2")
    expected = np.stack([np.ones(50), x**3, x**2 * np.cos(2 * phi), np.sin(phi) ** 2], axis=1)
    np.testing.assert_allclose(terms.matrix({"x": x, "phi": phi}), expected, rtol=1e-14)


def test_product_of_bases_is_complete_and_free_of_dependence(rng) -> None:
    terms = polynomial(["x", "y"], 3) * fourier(["phi"], 2)
    assert len(terms) == 10 * 5
    data = {name: rng.uniform(-1, 1, 500) * scale for name, scale in (("x", 1), ("y", 1), ("phi", np.pi))}
    assert np.linalg.matrix_rank(terms.matrix(data)) == 50


def test_product_that_would_hold_cos2_plus_sin2_is_refused() -> None:
    with pytest.raises(IdentError, match="phi"):
        fourier(["phi"], 1) * fourier(["phi"], 1)


def test_lower_degree_then_smaller_lag_then_name_comes_first() -> None:
    terms = Terms.parse("u(k-2)", "b", "a", "u(k-1)^2", "u(k-1)", "1")
    assert [terms.names[i] for i in terms.canonical_order] == ["1", "a", "b", "u(k-1)", "u(k-2)", "u(k-1)^2"]


@given(st.floats(-1e5, 1e5), st.floats(1e-2, 1e3), st.lists(st.floats(-10, 10), min_size=10, max_size=10))
def test_expansion_is_the_same_polynomial(centre: float, width: float, theta: list[float]) -> None:
    terms = polynomial(["x", "y"], 3)
    scale = Scale(("x", "y"), (centre, 1.5), (width, 2.0))
    raw, coefficients, linear = expand(terms, theta, scale)
    x, y = centre + width * np.linspace(-1, 1, 7), np.linspace(0, 3, 7)
    columns = {"x": x, "y": y}
    phi = raw.matrix(columns)
    tolerance = (
        1e-13 * float((np.abs(phi) @ np.abs(coefficients)).max()) + 1e-300
    )  # rounding of the largest terms
    np.testing.assert_allclose(phi @ coefficients, terms.matrix(columns, scale) @ theta, atol=tolerance)
    full = linear @ np.asarray(theta)
    kept = full[np.abs(full) > 0]
    assert len(coefficients) >= len(kept)


def test_no_lag_crosses_a_record_or_a_gap() -> None:
    first = Record(signals={"u": np.arange(10.0)}, stamps=np.r_[np.arange(5) * 0.1, 7 + np.arange(5) * 0.1])
    second = Record(signals={"u": np.arange(100.0, 104.0)})
    rows = lagged([first, second], Terms.parse("u(k)", "u(k-2)"), ["u"])
    assert rows.sample.tolist() == [2, 3, 4, 7, 8, 9, 2, 3]
    assert rows.record.tolist() == [0] * 6 + [1] * 2
    np.testing.assert_array_equal(rows.columns["u(k)"] - rows.columns["u(k-2)"], 2.0)


def test_row_with_unknown_regressor_is_left_out_and_unknown_target_is_kept() -> None:
    u, y = np.arange(6.0), np.arange(6.0)
    u[2], y[4] = np.nan, np.nan
    rows = lagged({"u": u, "y": y}, Terms.parse("u(k-1)"), ["y"])
    assert rows.sample.tolist() == [1, 2, 4, 5]
    assert np.isnan(rows.targets[:, 0]).tolist() == [False, False, True, False]


def test_missing_signal_is_named() -> None:
    with pytest.raises(IdentError, match="no signal v"):
        lagged({"u": np.arange(5.0)}, Terms.parse("v(k-1)"), ["u"])


def test_lags_are_named_from_now_backwards() -> None:
    assert lags("u", 0, 2) == ["u(k)", "u(k-1)", "u(k-2)"]


def test_functions_of_a_difference_read_two_lags_and_print_as_they_are_read() -> None:
    names = ("abs(y(k-1)-y(k-3))", "tanh((y(k-1)-y(k-2))/0.5)*u(k)", "abs(u(k))", "tanh((u(k))/2.0)")
    terms = Terms.parse(*names)
    assert terms.names == names
    assert terms.max_lag == 3
    y, u = np.array([0.3, -1.0, 2.0, 0.5]), np.array([1.0, -2.0, 3.0, 4.0])
    rows = lagged(Record(signals={"y": y, "u": u}), terms, ["y"])
    expected = [abs(2.0 - 0.3), np.tanh((2.0 + 1.0) / 0.5) * 4.0, 4.0, np.tanh(2.0)]
    np.testing.assert_allclose(terms.matrix(rows.columns)[0], expected, rtol=1e-15)


@pytest.mark.parametrize(
    "name",
    ["y(k-1)-y(k-2)", "cos(y(k-1)-y(k-2))", "abs(y(k-2)-y(k-1))", "tanh(y(k-1))", "abs(y(k-1)-u(k-2))",
     "tanh((y(k-1))/0)", "abs((y(k))/2)"],
)  # fmt: skip
def test_a_difference_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(IdentError, match="expected"):
        Terms.parse(name)
