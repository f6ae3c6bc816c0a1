"""Forward selection agrees with a plain orthogonalisation in long double, and finds what was planted."""

from __future__ import annotations

import numpy as np
import pytest

from robotmodic_ident import IdentError, Moments, Scale, Terms, fourier, polynomial, select


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


DICTIONARIES = {
    "degree 4": polynomial(["x", "y"], 4),
    "degree 2 x 2 harmonics": polynomial(["x", "y"], 2) * fourier(["phi"], 2),
}


def plain_selection(
    phi: np.ndarray, y: np.ndarray, n_terms: int
) -> tuple[list[int], list[float], np.ndarray]:
    """Select by modified Gram-Schmidt on the data, in long double; returns order, ERR and coefficients."""
    left = phi.astype(np.longdouble)
    rest = y.astype(np.longdouble)
    norms = (left**2).sum(axis=0)
    power = rest @ rest
    order: list[int] = []
    err: list[float] = []
    for _ in range(n_terms):
        size = (left**2).sum(axis=0)
        usable = (size > 1e-12 * norms) & ~np.isin(np.arange(phi.shape[1]), order)
        gain = np.where(usable, (left.T @ rest) ** 2 / np.where(usable, size, 1), -1)
        p = int(gain.argmax())
        order.append(p)
        err.append(float(gain[p] / power))
        w = left[:, p] / np.sqrt(size[p])
        for _ in range(2):  # twice is enough
            left = left - np.outer(w, w @ left)
        rest = rest - w * (w @ rest)
    theta = np.linalg.lstsq(phi[:, order], y, rcond=None)[0]
    return order, err, theta


@pytest.mark.parametrize("name", DICTIONARIES)
@pytest.mark.parametrize("seed", range(4))
def test_same_terms_err_and_theta_as_long_double_reference(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    terms, n, q = DICTIONARIES[name], 400, 5
    data = {"x": rng.uniform(0, 8, n), "y": rng.uniform(-3, 3, n), "phi": rng.uniform(-np.pi, np.pi, n)}
    y = np.abs(
        np.sin(data["x"])[:, None] + rng.normal(size=q) * data["y"][:, None] * np.cos(data["phi"])[:, None]
    )
    y = y + 0.01 * rng.normal(size=(n, q))
    y[rng.random((n, q)) < 0.1 * (np.arange(q) % 2)] = np.nan
    moments = Moments(terms, q).add(data, y)
    result = select(moments, 10)
    phi = terms.matrix(data, moments.scale)
    for i in range(q):
        known = np.isfinite(y[:, i])
        order, err, theta = plain_selection(phi[known], y[known, i], 10)
        assert result.order[i].tolist() == order
        np.testing.assert_allclose(result.err[i], err, atol=1e-12)
        np.testing.assert_allclose(result.theta[i, order], theta, rtol=1e-9, atol=1e-9)
        rss = ((y[known, i] - phi[known][:, order] @ theta) ** 2).sum()
        assert result.rss[i] == pytest.approx(rss, rel=1e-8)
        covariance = rss / (known.sum() - 10) * np.linalg.inv(phi[known][:, order].T @ phi[known][:, order])
        np.testing.assert_allclose(result.covariance(i), covariance, rtol=1e-7)


def test_all_outputs_together_equal_each_alone(rng) -> None:
    terms = DICTIONARIES["degree 4"]
    data = {"x": rng.normal(size=300), "y": rng.normal(size=300)}
    y = rng.normal(size=(300, 6)) + data["x"][:, None] ** 2
    y[rng.random(y.shape) < 0.2 * (np.arange(6) > 2)] = np.nan
    scale = Scale.of(data)
    together = select(Moments(terms, 6, scale=scale).add(data, y), criterion="bic")
    for i in range(6):
        alone = select(Moments(terms, 1, scale=scale).add(data, y[:, i]), criterion="bic")
        assert alone.chosen(0).tolist() == together.chosen(i).tolist()
        np.testing.assert_allclose(alone.theta[0], together.theta[i], atol=1e-9)


def test_exact_tie_goes_to_the_lower_degree_then_smaller_lag_then_name() -> None:
    u = np.where(np.arange(200) % 3 == 0, 1.0, -1.0)
    columns = {"b": u, "a": u, "u(k-1)": u, "u(k-2)": u}
    terms = Terms.parse("b^3", "u(k-2)", "u(k-1)", "b", "a")
    result = select(Moments(terms, 1, scale=Scale()).add(columns, 2 * u), 3)
    assert [terms.names[i] for i in result.chosen(0)] == ["a"]  # the others depend on it exactly
    assert result.stop == ("exhausted",)
    assert result.theta[0, terms.names.index("a")] == pytest.approx(2.0)


@pytest.mark.parametrize("seed", range(5))
def test_planted_terms_are_found_and_bic_stops_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    terms = polynomial(["x", "y"], 3)
    data = {"x": rng.normal(size=2000), "y": rng.normal(size=2000)}
    z = 1.5 + 2.0 * data["x"] * data["y"] - 0.7 * data["y"] ** 3
    result = select(Moments(terms, 1, scale=Scale()).add(data, z), criterion="bic")
    found = {terms.names[i]: result.theta[0, i] for i in result.chosen(0)}
    assert set(found) == {"1", "x*y", "y^3"}
    assert found == pytest.approx({"1": 1.5, "x*y": 2.0, "y^3": -0.7}, abs=1e-10)
    assert result.stop == ("bic",)


def test_err_tol_stops_when_little_is_left_and_says_so(rng) -> None:
    terms = polynomial(["x"], 5)
    x = rng.uniform(-1, 1, 500)
    result = select(Moments(terms, 1).add({"x": x}, x + 0.01 * x**4), criterion="err_tol", err_tol=1e-3)
    assert [terms.names[i] for i in result.chosen(0)] == ["x"]
    assert result.stop == ("err_tol",)


def test_kept_term_is_chosen_first(rng) -> None:
    x = rng.uniform(5, 6, 200)
    result = select(Moments(polynomial(["x"], 2), 1, scale=Scale()).add({"x": x}, x), 2, keep=["1"])
    assert result.order[0].tolist() == [0, 1]
    with pytest.raises(IdentError, match="no term w"):
        select(Moments(polynomial(["x"], 2), 1).add({"x": x}, x), 2, keep=["w"])


def test_output_without_data_is_an_error(rng) -> None:
    y = np.full((50, 2), np.nan)
    y[:, 0] = 1.0
    with pytest.raises(IdentError, match="output 1 has no known value"):
        select(Moments(polynomial(["x"], 1), 2).add({"x": rng.normal(size=50)}, y), 1)


def test_standard_errors_are_as_large_as_the_scatter_of_repeats() -> None:
    rng = np.random.default_rng(11)
    x = rng.uniform(-1, 1, 200)
    truth = 1 + 2 * x
    y = truth[:, None] + 0.3 * rng.normal(size=(200, 2000))
    result = select(Moments(polynomial(["x"], 1), 2000, scale=Scale()).add({"x": x}, y), 2)
    said = np.sqrt(np.mean([np.diag(result.covariance(i)) for i in range(2000)], axis=0))
    seen = np.array([result.theta[i, result.order[i]] for i in range(2000)]).std(axis=0)
    np.testing.assert_allclose(said, seen, rtol=0.06)  # 2000 repeats: a standard deviation to 1.6 %
