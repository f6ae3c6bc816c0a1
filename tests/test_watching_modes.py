"""Possible poses are normal distributions: their merging and their evidence at a match are compared with samples."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sensorgraph.localization.matching import CORRELATION, Match
from sensorgraph.watching.modes import Mode, corrected

WIDE = np.diag(np.array([0.4, 0.3, 0.1]) ** 2)
SHARP = np.diag(np.array([0.1, 0.12, 0.05]) ** 2)


def mode_at(pose: tuple[float, float, float], covariance: np.ndarray, share: float, **facts: bool) -> Mode:
    """Return a mode with a probability."""
    return Mode(pose=np.array(pose), covariance=covariance, score=math.log(share), number=1, **facts)


@pytest.mark.parametrize("first", [0.2, 0.5, 0.9])
def test_modes_that_met_have_the_mean_and_covariance_of_both(first: float) -> None:
    wide, sharp = (
        mode_at((1.0, 2.0, 3.1), WIDE, first),
        mode_at((1.3, 1.9, -3.1), SHARP, 1.0 - first),
    )
    found = wide.merged(sharp)
    rng = np.random.default_rng(1)
    turned = np.array([1.3, 1.9, 2 * math.pi - 3.1])  # the same heading
    n = round(200_000 * first)
    drawn = np.concatenate([
        rng.multivariate_normal(wide.pose, WIDE, n), rng.multivariate_normal(turned, SHARP, 200_000 - n)
    ])  # fmt: skip
    np.testing.assert_allclose(found.pose, drawn.mean(axis=0), atol=0.005)
    np.testing.assert_allclose(found.covariance, np.cov(drawn.T), atol=0.002)
    assert math.exp(found.total) == pytest.approx(1.0)


def test_a_mode_that_drifted_has_its_mean_likelihood_at_a_match() -> None:
    """The readings are likely where exp(-½ (x - m)ᵀ I (x - m)) is large; samples of the mode give the mean of it."""
    drifted, best = mode_at((0.0, 0.0, 0.0), WIDE, 1.0), np.array([0.5, -0.3, 0.08])
    information = np.linalg.inv(SHARP)
    posterior = np.linalg.inv(np.linalg.inv(WIDE) + information)
    pose = posterior @ information @ best  # the match weighs the prior, too
    match = Match(pose=pose, information=CORRELATION * information, overlap=1.0, inliers=1.0, noise=0.01)
    found = corrected(drifted, match)
    samples = np.random.default_rng(2).multivariate_normal(np.zeros(3), WIDE, 400_000) - best
    mean = np.exp(-0.5 * np.einsum("ni,ij,nj->n", samples, information, samples)).mean()
    at_match = -0.5 * (pose - best) @ information @ (pose - best)
    assert found.score + at_match == pytest.approx(math.log(mean), abs=0.1)


def test_a_mode_that_is_followed_by_matches_keeps_its_probability() -> None:
    followed = mode_at((0.0, 0.0, 0.0), SHARP, 1.0, is_matched=True)
    match = Match(
        pose=np.array([0.02, 0.0, 0.0]), information=np.eye(3), overlap=1.0, inliers=1.0, noise=0.01
    )
    assert corrected(followed, match).score == followed.score
    assert corrected(replace(followed, is_matched=False), match).score < followed.score
