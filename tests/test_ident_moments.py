"""Moments are sums: any order, any split, any missing value gives what the plain sums give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robotmodic_ident import IdentError, Moments, Scale, Terms, polynomial, select


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


TERMS = polynomial(["x", "y"], 3)
SCALE = Scale.between({"x": (-2, 2), "y": (-1, 3)})


def data(
    rng: np.random.Generator, n: int, q: int, missing: float
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    columns = {"x": rng.uniform(-2, 2, n), "y": rng.uniform(-1, 3, n)}
    y = rng.normal(size=(n, q)) + columns["x"][:, None]
    y[rng.random((n, q)) < missing] = np.nan
    return columns, y


@pytest.mark.parametrize("missing", [0.0, 0.01, 0.5, 0.95])
@pytest.mark.parametrize("n", [50, 9000])
def test_moments_equal_plain_sums_for_every_output(rng, n: int, missing: float) -> None:
    columns, y = data(rng, n, 4, missing)
    y[: n // 3, 0] = np.nan
    y[n // 2] = np.nan  # a row that nobody knows
    moments = Moments(TERMS, 4, scale=SCALE).add(columns, y)
    phi = TERMS.matrix(columns, SCALE)
    for i in range(4):
        known = np.isfinite(y[:, i])
        np.testing.assert_allclose(moments.gram_of(i), phi[known].T @ phi[known], rtol=1e-9, atol=1e-9 * n)
        np.testing.assert_allclose(moments.cross[:, i], phi[known].T @ y[known, i], atol=1e-9 * n)
        assert moments.power[i] == pytest.approx(y[known, i] @ y[known, i])
        assert moments.count[i] == known.sum()


@pytest.mark.parametrize("hole", [False, True])
def test_many_outputs_are_summed_whole_however_few_rows_at_a_time(rng, hole: bool) -> None:
    columns, y = data(rng, 1000, 300, 0.0)
    if hole:
        y[700, 5] = np.nan
    moments = Moments(TERMS, 300, scale=SCALE).add(columns, y)
    phi, known = TERMS.matrix(columns, SCALE), np.nan_to_num(y)
    np.testing.assert_allclose(moments.cross, phi.T @ known, atol=1e-9)  # sums of 1000 numbers about 1
    np.testing.assert_allclose(moments.power, (known**2).sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(moments.gram, phi.T @ phi, atol=1e-9)
    assert moments.count.tolist() == [999 if hole and i == 5 else 1000 for i in range(300)]


def test_merge_of_halves_is_the_whole_and_subtraction_undoes_it(rng) -> None:
    columns, y = data(rng, 1000, 3, 0.2)
    half = [{name: v[s] for name, v in columns.items()} for s in (slice(0, 400), slice(400, None))]
    a = Moments(TERMS, 3, scale=SCALE).add(half[0], y[:400])
    b = Moments(TERMS, 3, scale=SCALE).add(half[1], y[400:])
    whole = Moments(TERMS, 3, scale=SCALE).add(columns, y)
    for one, other in ((a + b, whole), (whole - b, a)):
        for i in range(3):
            np.testing.assert_allclose(one.gram_of(i), other.gram_of(i), atol=1e-9)
        np.testing.assert_allclose(one.cross, other.cross, atol=1e-9)
        np.testing.assert_array_equal(one.count, other.count)
    np.testing.assert_allclose(select(a + b, 5).theta, select(whole, 5).theta, atol=1e-10)


def test_different_scales_are_not_merged(rng) -> None:
    columns, y = data(rng, 100, 1, 0.0)
    first = Moments(TERMS, 1).add(columns, y)
    second = Moments(TERMS, 1).add({name: 2 * v for name, v in columns.items()}, y)
    with pytest.raises(IdentError, match="different scales"):
        _ = first + second


def test_more_cannot_be_subtracted_than_was_added(rng) -> None:
    columns, y = data(rng, 100, 1, 0.0)
    small = Moments(TERMS, 1, scale=SCALE).add({n: v[:50] for n, v in columns.items()}, y[:50])
    with pytest.raises(IdentError, match="subtract only"):
        _ = small - Moments(TERMS, 1, scale=SCALE).add(columns, y)


def test_file_gives_the_same_moments(rng, tmp_path: Path) -> None:
    columns, y = data(rng, 300, 3, 0.1)
    moments = Moments(TERMS, 3).add(columns, y)
    moments.save(tmp_path / "m.npz")
    again = Moments.load(tmp_path / "m.npz")
    assert again.terms == moments.terms and again.scale == moments.scale
    for i in range(3):
        np.testing.assert_array_equal(again.gram_of(i), moments.gram_of(i))
    np.testing.assert_array_equal(again.cross, moments.cross)
    (tmp_path / "bad.npz").write_bytes(b"not a zip")
    with pytest.raises(IdentError, match="not a file of moments"):
        Moments.load(tmp_path / "bad.npz")


def test_sub_dictionary_needs_no_second_pass(rng) -> None:
    columns, y = data(rng, 500, 4, 0.1)
    small = polynomial(["x", "y"], 2)
    index = [TERMS.names.index(name) for name in small.names]
    picked = Moments(TERMS, 4, scale=SCALE).add(columns, y).pick(terms=index, outputs=[2])
    direct = Moments(small, 1, scale=SCALE).add(columns, y[:, 2])
    np.testing.assert_allclose(picked.gram_of(0), direct.gram_of(0), atol=1e-9)
    np.testing.assert_allclose(picked.cross, direct.cross, atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e5])
def test_offset_of_the_coordinates_does_no_harm(offset: float) -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-3, 3, 800), rng.uniform(-2, 2, 800)
    z = (1 + 2 * x - x * y + 0.3 * y**3)[:, None] + 0.01 * rng.normal(size=(800, 1))
    here = Moments(TERMS, 1).add({"x": x, "y": y}, z)
    there = Moments(TERMS, 1).add({"x": x + offset, "y": y - offset}, z)
    a, b = select(here, 6), select(there, 6)
    assert a.order.tolist() == b.order.tolist()
    np.testing.assert_allclose(a.theta, b.theta, atol=1e-8)  # float64 at 1e5 m: 1.5e-11 m


def test_infinite_value_is_refused(rng) -> None:
    with pytest.raises(IdentError, match="infinite"):
        Moments(Terms.parse("1"), 1).add({}, np.array([1.0, np.inf]))
