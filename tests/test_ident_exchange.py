"""Exchange repairs what greedy selection gets wrong, in Gram space; criteria and folds say how many terms to keep."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from ident_samples import (
    CUBIC,
    MAO_BILLINGS,
    PIRODDI_SPINELLI,
    exact,
    moments_of,
    simulate,
    slow_input,
    white_input,
)

from robotmodic_ident import IdentError, Moments, Scale, Terms, fit, lagged, lags, polynomial, select
from robotmodic_ident.selection.criteria import penalties


def rss_of(phi: np.ndarray, y: np.ndarray, chosen) -> float:
    chosen = list(chosen)
    theta = np.linalg.lstsq(phi[:, chosen], y, rcond=None)[0]
    return float(((y - phi[:, chosen] @ theta) ** 2).sum())


def slow_problem(seed: int, q: int = 1) -> tuple[Moments, np.ndarray, np.ndarray]:
    """Return moments, Φ and Y of smooth, collinear signals that no few terms explain exactly."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4, 200)
    data = {"x": np.sin(t) + 0.1 * t, "y": np.cos(0.7 * t) + 1.5}
    terms = polynomial(["x", "y"], 3)
    y = (
        np.exp(data["x"])[:, None] * rng.normal(size=q)
        + 0.05 * rng.normal(size=(200, q))
        + data["y"][:, None]
    )
    moments = Moments(terms, q, scale=Scale()).add(data, y)
    return moments, terms.matrix(data), y


@pytest.mark.parametrize("seed", range(6))
def test_exchange_finds_the_best_subset_of_every_size_that_brute_force_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"x{i}" for i in range(10)]
    common = rng.normal(size=300)
    data = {name: common + 0.7 * rng.normal(size=300) for name in names}  # correlations of 0.67
    y = sum(rng.normal() * values for values in data.values()) + rng.normal(size=300)
    moments = Moments(Terms.parse(*names), 1, scale=Scale()).add(data, y)
    phi = moments.terms.matrix(data)
    for k in range(1, 7):
        result = select(moments, k, search="exchange")
        assert result.rss[0] == pytest.approx(min(rss_of(phi, y, c) for c in combinations(range(10), k)))


@pytest.mark.parametrize("seed", range(4))
def test_no_exchange_of_one_term_improves_what_exchange_returns(seed: int) -> None:
    moments, phi, y = slow_problem(seed, 3)
    result = select(moments, 5, search="exchange")
    for i in range(3):
        chosen = set(result.chosen(i).tolist())
        for out in chosen:
            for into in set(range(10)) - chosen:
                other = rss_of(phi, y[:, i], chosen - {out} | {into})
                assert other > result.rss[i] * (1 - 1e-8)
        assert result.rss[i] <= select(moments, 5).rss[i] * (1 + 1e-12)


def test_all_outputs_together_equal_each_alone_by_exchange() -> None:
    moments, _, _ = slow_problem(1, 4)
    together = select(moments, criterion="bic", search="exchange")
    for i in range(4):
        alone = select(moments.pick(outputs=[i]), criterion="bic", search="exchange")
        assert alone.chosen(0).tolist() == together.chosen(i).tolist()


def test_kept_terms_are_not_exchanged() -> None:
    moments, _, _ = slow_problem(0)
    result = select(moments, 3, search="exchange", keep=["x*y^2", "1"])
    names = [moments.terms.names[i] for i in result.chosen(0)]
    assert names[:2] == ["x*y^2", "1"]


@pytest.mark.parametrize("search", ["restart", "exchange"])
def test_slow_input_defeats_greedy_selection_and_is_repaired(search) -> None:
    greedy = found = 0
    for seed in range(10):
        rng = np.random.default_rng(4000 + seed)
        record = simulate(PIRODDI_SPINELLI, {"u": slow_input(rng, 500)}, rng.normal(0, np.sqrt(0.02), 500))
        moments = moments_of(record, CUBIC)
        names = [select(moments, criterion="ebic", search=s).chosen(0) for s in ("forward", search)]
        greedy += exact(CUBIC[names[0].tolist()], PIRODDI_SPINELLI)
        found += exact(CUBIC[names[1].tolist()], PIRODDI_SPINELLI)
    assert greedy <= 2 and found >= 9


def test_extended_criterion_does_not_over_select_from_a_large_dictionary() -> None:
    counts = {"bic": 0, "ebic": 0}
    for seed in range(12):
        rng = np.random.default_rng(4100 + seed)
        record = simulate(MAO_BILLINGS, {"u": white_input(rng, 1000)}, rng.normal(0, 0.02, 1000))
        moments = moments_of(record, CUBIC)
        for criterion in counts:
            chosen = select(moments, criterion=criterion, search="exchange").chosen(0)
            counts[criterion] += exact(CUBIC[chosen.tolist()], MAO_BILLINGS)
    assert counts["ebic"] >= 11 and counts["ebic"] > counts["bic"]


def test_penalties_are_those_of_the_papers() -> None:
    count = np.array([100])
    assert penalties("aic", 3, 10, count)[0].tolist() == [0, 2, 4, 6]
    np.testing.assert_allclose(penalties("bic", 2, 10, count)[0], np.arange(3) * np.log(100))
    extra = penalties("ebic", 2, 10, count)[0] - penalties("bic", 2, 10, count)[0]
    np.testing.assert_allclose(extra, 2 * np.log([1, 10, 45]), atol=1e-12)


@pytest.mark.parametrize("search", ["forward", "exchange"])
def test_folds_subtracted_in_gram_space_choose_what_refitting_on_the_data_chooses(search) -> None:
    rng = np.random.default_rng(5)
    terms = polynomial(["x"], 6)
    x = rng.uniform(-1, 1, 90)
    y = 1 + x - 2 * x**3 + 0.2 * rng.normal(size=90)
    blocks = np.array_split(np.arange(90), 5)
    folds = [Moments(terms, 1, scale=Scale()).add({"x": x[b]}, y[b]) for b in blocks]
    total = folds[0]
    for fold in folds[1:]:
        total = total + fold
    result = select(total, criterion="cv", folds=folds, search=search)
    phi = terms.matrix({"x": x})
    score = np.zeros(8)
    score[0] = np.inf
    for block in blocks:
        rest = np.setdiff1d(np.arange(90), block)
        train = Moments(terms, 1, scale=Scale()).add({"x": x[rest]}, y[rest])
        for k in range(1, 8):
            chosen = select(train, k, search=search).chosen(0)
            theta = np.linalg.lstsq(phi[np.ix_(rest, chosen)], y[rest], rcond=None)[0]
            score[k] += ((y[block] - phi[np.ix_(block, chosen)] @ theta) ** 2).sum()
    assert result.n_terms[0] == score.argmin()
    assert result.stop == ("cv",)


def test_fewer_samples_than_terms_never_gives_a_saturated_model() -> None:
    rng = np.random.default_rng(0)
    record = {"y": rng.normal(size=24), "u": rng.normal(size=24)}
    rows = lagged(record, CUBIC, ["y"])
    moments = Moments(CUBIC, 1).add(rows.columns, rows.targets)
    for search in ("forward", "exchange"):
        assert select(moments, criterion="bic", search=search).n_terms[0] <= 11


def test_senseless_wishes_are_refused() -> None:
    moments, _, _ = slow_problem(0)
    with pytest.raises(ValueError, match="search is 'magic'"):
        select(moments, 2, search="magic")
    with pytest.raises(ValueError, match="needs folds"):
        select(moments, criterion="cv")
    with pytest.raises(ValueError, match="at least 2"):
        select(moments, criterion="cv", folds=[moments])
    with pytest.raises(IdentError, match="only within one fold"):
        select(moments, criterion="cv", folds=[moments, Moments(moments.terms, 1, scale=Scale())])


def test_output_of_zeros_gets_a_model_that_says_zero() -> None:
    terms = Terms.parse("1", "x")
    x = np.linspace(-1, 1, 20)
    for search in ("forward", "exchange"):
        result = select(Moments(terms, 1).add({"x": x}, np.zeros(20)), criterion="bic", search=search)
        np.testing.assert_array_equal(result.theta, 0.0)


def test_folds_of_exact_data_do_not_keep_rounding() -> None:
    rng = np.random.default_rng(6)
    u = rng.normal(size=60)
    model = fit({"u": u, "y": u + np.r_[0, u[:-1]]}, "y", polynomial(lags("u", 0, 2), 2), criterion="cv")
    assert set(model.terms.names) == {"u(k)", "u(k-1)"}


def test_large_collinear_dictionary_keeps_its_residual_honest() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(2000) / 30
    data = {"x": rng.uniform(0, 8, 2000), "c": np.cos(t), "s": np.sin(t)}
    terms = polynomial(list(data), 6)
    z = np.abs(np.sin(data["x"]) * data["c"]) + 0.01 * rng.normal(size=2000)
    moments = Moments(terms, 1).add(data, z)
    phi = terms.matrix(data, moments.scale)
    rss = {}
    for search in ("forward", "exchange"):
        result = select(moments, 12, search=search)
        rss[search] = result.rss[0]
        assert rss[search] == pytest.approx(rss_of(phi, z, result.chosen(0)), rel=1e-9)
    assert rss["exchange"] < rss["forward"]
