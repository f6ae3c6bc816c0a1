"""The share of the readings that fit separates a pose of the graph from a place that resembles it: against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import betaln

from sensorgraph.watching.modes import Mode, exchanged, found_scores
from sensorgraph.watching.readings import ReadingEvidence
from sensorgraph.watching.resemblance import resemblance_of

RATIO = 20.0
"""[nats] of a reading that fits."""


def readings(fits: int, misses: int, unanswered: int = 0, broken: int = 0) -> ReadingEvidence:
    """Return the readings of one scan at one pose: those that fit are certain, and the others impossible there."""
    counts = [fits, misses, unanswered, broken]
    kinds = np.repeat([0, 1, 2, 3], counts)[None]
    ratios = np.select([kinds == 0, kinds == 1], [math.log(0.8) + RATIO, math.log(0.2)], 0.0)
    return ReadingEvidence(
        ratios=ratios,
        known=kinds < 2,
        fits=1.0 * (kinds == 0),
        residuals=0.0 * ratios,
        read=kinds[0] < 3,
        predicted=0.8,
    )


def closed(fits: float, misses: float) -> tuple[float, float]:
    """Return the log-likelihoods of independent readings: the mean of q^fits (1 - q)^misses, with 4 q³ and with 1."""
    here = math.log(4.0) + betaln(fits + 4.0, misses + 1.0)
    return fits * RATIO + here, fits * RATIO + betaln(fits + 1.0, misses + 1.0)


@pytest.mark.parametrize(("fits", "misses"), [(60, 0), (48, 12), (24, 36), (0, 60)])
@pytest.mark.parametrize("share", [0.125, 1.0])
def test_likelihoods_are_those_of_independent_readings(fits: int, misses: int, share: float) -> None:
    found = resemblance_of(readings(fits, misses), np.array([False]), share)
    expected = closed(share * fits, share * misses)
    assert (found.here[0], found.elsewhere[0]) == pytest.approx(expected, abs=0.01)


def test_where_the_robot_was_not_followed_a_reading_that_the_graph_does_not_answer_is_not_predicted() -> None:
    found = resemblance_of(readings(20, 0, unanswered=40, broken=9), np.array([False]), 0.125)
    assert found.here[0] == pytest.approx(closed(2.5, 5.0)[0], abs=0.01)


def test_a_followed_robot_outside_what_the_graph_knows_gives_no_evidence() -> None:
    found = resemblance_of(readings(0, 0, unanswered=60), np.array([True]), 0.125)
    assert (found.here[0], found.elsewhere[0]) == pytest.approx((0.0, 0.0), abs=1e-9)
    some = resemblance_of(readings(0, 12, unanswered=48), np.array([True]), 0.125)
    assert -0.25 < some.here[0] - some.elsewhere[0] < 0.0


def test_robots_that_are_carried_away_and_back_keep_the_sum() -> None:
    mode = Mode(pose=np.zeros(3), covariance=np.eye(3), score=math.log(0.9), alike=math.log(0.1), number=1)
    for share, expected in ((0.0, 0.9), (0.01, 0.892), (0.5, 0.5)):
        moved = exchanged(mode, share)
        assert math.exp(moved.score) == pytest.approx(expected)
        assert moved.total == pytest.approx(0.0, abs=1e-12)


def test_a_found_pose_has_the_evidence_since_the_robot_may_have_been_carried_there() -> None:
    gains = np.array(
        [[[-4.0, -2.0], [1.0, 0.0]], [[1.0, 0.0], [-4.0, -2.0]]]
    )  # the second scan is of the new pose
    carried = np.log([1e-3, 1e-3])
    main = Mode(pose=np.zeros(3), covariance=np.eye(3), score=math.log(0.9), alike=math.log(0.1), number=1)
    here = 0.9 * 1e-3 * (math.exp(-5 + 5) + math.exp(5)) + 0.1 * math.exp(-4 + 1 + 2)
    alike = 0.9 * 1e-3 * (math.exp(-3 + 4) + math.exp(4)) + 0.1 * math.exp(-2 + 0 + 2)
    assert np.exp(found_scores(main, -np.inf, gains, carried)) == pytest.approx([here, alike])
    assert np.exp(found_scores(None, 0.0, gains[:, :1], carried)) == pytest.approx(np.exp([-3.0, -2.0]))
