"""Mixtures of candidates: closed forms, and the compiled kernel beside its plain twin."""

from __future__ import annotations

import numpy as np
import pytest
from plain_mixture import summarise_plain
from scipy.special import ndtr

from sensorgraph.models.base import OFF_DISTANCE, POINTS
from sensorgraph.models.mixture import summarise, to_prediction, which_of

FAR = 12.0


def of(
    r: list[float], w: list[float], s: float | list[float], point: str = "mode"
) -> tuple[float, float, float, float, float, float]:
    sigma = np.broadcast_to(np.asarray(s, dtype=float), len(r)).copy()
    return summarise(np.array(r), np.array(w), sigma, len(r), 1.0 - sum(w), FAR, which_of(point))  # type: ignore[arg-type]


def test_one_candidate_is_a_gaussian() -> None:
    median, mode, mean, sigma, none, off = of([3.0], [0.75], 0.02)
    assert (median, mode, mean, none) == (3.0, 3.0, 3.0, 0.25)
    assert sigma == pytest.approx(0.02)
    assert off == pytest.approx(2 * ndtr(-OFF_DISTANCE / 0.02))


def test_two_equal_candidates_far_apart() -> None:
    """Median between them is any place with half the mass on both sides; the mode is the first; the mean is between."""
    median, mode, mean, sigma, _, off = of([2.0, 4.0], [0.5, 0.5], 0.01, point="mean")
    assert 2.0 < median < 4.0 and mode == 2.0 and mean == 3.0
    assert sigma == pytest.approx(np.hypot(1.0, 0.01))
    assert off == pytest.approx(1.0)


def test_median_of_two_near_candidates_is_where_the_mixture_has_half_its_mass() -> None:
    median, *_ = of([2.0, 2.05], [0.6, 0.3], 0.03)
    mass = 0.6 * ndtr((median - 2.0) / 0.03) + 0.3 * ndtr((median - 2.05) / 0.03)
    assert mass == pytest.approx(0.45, abs=1e-7)


def test_mode_is_the_place_of_most_mass_though_no_candidate_there_is_the_heaviest() -> None:
    r = [1.0, 3.00, 3.03, 3.06]
    _, mode, *_ = of(r, [0.35, 0.2, 0.2, 0.2], 0.02)
    assert mode == pytest.approx(3.03, abs=1e-6)  # by symmetry
    _, mode, *_ = of(r, [0.65, 0.1, 0.1, 0.1], 0.02)
    assert mode == 1.0


def test_no_return_takes_nothing_from_what_is_said_given_a_return() -> None:
    full, half = of([1.0, 2.0], [0.8, 0.2], 0.01), of([1.0, 2.0], [0.4, 0.1], 0.01)
    assert half[:4] == pytest.approx(full[:4])
    assert half[5] == pytest.approx(full[5]) and half[4] == pytest.approx(0.5)


def test_a_ray_without_candidates_says_the_farthest_and_is_off() -> None:
    assert of([], [], 0.01) == (FAR, FAR, FAR, FAR, 1.0, 1.0)


def test_said_chance_of_being_off_is_the_share_of_samples_that_are() -> None:
    rng = np.random.default_rng(8)
    r, w, s = np.array([2.0, 2.04, 2.5]), np.array([0.3, 0.4, 0.2]), np.array([0.02, 0.03, 0.1])
    for name in POINTS:
        *values, _, _, off = summarise(r, w, s, 3, 0.1, FAR, which_of(name))  # type: ignore[arg-type]
        point = dict(zip(("median", "mode", "mean"), values, strict=False))[name]
        which = rng.choice(3, 200_000, p=w / w.sum())
        drawn = rng.normal(r[which], s[which])
        assert (np.abs(drawn - point) > OFF_DISTANCE).mean() == pytest.approx(
            off, abs=0.005
        )  # 4 s.e. of 200,000 draws


def test_kernel_agrees_with_its_plain_twin() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        n = int(rng.integers(0, 12))
        r = np.sort(rng.uniform(0.5, 2.5, n + 2))
        w = rng.dirichlet(np.full(n + 3, rng.choice([0.1, 1.0])))[: n + 2]
        s = rng.uniform(0.005, 0.08, n + 2)
        which = int(rng.integers(3))
        left = 1.0 - w[:n].sum()
        fast, plain = summarise(r, w, s, n, left, FAR, which), summarise_plain(r, w, s, n, left, FAR, which)
        assert fast == pytest.approx(plain, abs=3e-4)  # the short cut of a clear candidate; flat cdf


def test_prediction_chooses_its_point_and_says_infinity_where_no_return_is_likelier() -> None:
    table = np.array([[of([1.0, 2.0], [0.4, 0.3], 0.01), of([1.0], [0.3], 0.01)]])
    said = to_prediction(table, "mean", np.ones((1, 2), dtype=bool))
    assert said.ranges[0, 0] == said.mean[0, 0] and np.isposinf(said.ranges[0, 1])
    assert said.mode[0].tolist() == [1.0, 1.0]
