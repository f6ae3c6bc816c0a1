"""The share of the readings that fit separates a pose of the graph from a place that resembles it: against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import betaln

from sensorgraph.watching.modes import Mode, exchanged, found_mode, found_scores, weighed
from sensorgraph.watching.readings import ReadingEvidence
from sensorgraph.watching.resemblance import resemblance_of
from sensorgraph.watching.settings import TRACKING

RATIO = 20.0
"""[nats] of a reading that fits."""


def readings(fits: int, misses: int, unanswered: int = 0, broken: int = 0) -> ReadingEvidence:
    """Return the readings of one scan at one pose: those that fit are certain, and the others impossible there."""
    return at_poses((fits, misses, unanswered, broken))


def at_poses(*counts: tuple[int, int, int, int]) -> ReadingEvidence:
    """Return the readings of one scan at poses, from the numbers of those that fit, miss, are not answered and are broken."""
    kinds = np.array([np.repeat([0, 1, 2, 3], of_pose) for of_pose in counts])
    ratios = np.select([kinds == 0, kinds == 1], [math.log(0.8) + RATIO, math.log(0.2)], 0.0)
    return ReadingEvidence(
        ratios=ratios,
        known=kinds < 2,
        fits=1.0 * (kinds == 0),
        residuals=0.0 * ratios,
        predicted=0.8,
    )


def closed(fits: float, misses: float) -> tuple[float, float]:
    """Return the log-likelihoods of independent readings: the mean of q^fits (1 - q)^misses, with 4 q³ and with 1."""
    here = math.log(4.0) + betaln(fits + 4.0, misses + 1.0)
    return fits * RATIO + here, fits * RATIO + betaln(fits + 1.0, misses + 1.0)


@pytest.mark.parametrize(("fits", "misses"), [(60, 0), (48, 12), (24, 36), (0, 60)])
@pytest.mark.parametrize("share", [0.125, 1.0])
def test_likelihoods_are_those_of_independent_readings(fits: int, misses: int, share: float) -> None:
    found = resemblance_of(readings(fits, misses), share)
    expected = closed(share * fits, share * misses)
    assert (found.here[0, 0], found.elsewhere[0]) == pytest.approx(expected, abs=0.01)


def test_a_reading_that_the_graph_does_not_answer_is_one_from_anywhere() -> None:
    found = resemblance_of(readings(20, 0, unanswered=31, broken=9), 0.125)
    assert (found.here[0, 0], found.elsewhere[0]) == pytest.approx(closed(2.5, 0.0), abs=0.01)
    nothing = resemblance_of(readings(0, 0, unanswered=60), 0.125)
    assert (nothing.here[0, 0], nothing.elsewhere[0]) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("misses", [6, 30, 54])
def test_an_answer_holds_with_the_share_of_rays_that_the_graph_answers(misses: int) -> None:
    """With the probability `answered`, a reading that does not fit is impossible; otherwise, it is one from anywhere."""
    answered = misses / 60
    found = resemblance_of(readings(0, misses, unanswered=60 - misses), 0.125)
    here, elsewhere = (
        math.log(quad(lambda q, f=f: f(q) * (1 - q * answered) ** (0.125 * misses), 0, 1)[0])
        for f in (lambda q: 4 * q**3, lambda _: 1.0)
    )
    assert (found.here[0, 0], found.elsewhere[0]) == pytest.approx((here, elsewhere), abs=0.01)


@pytest.mark.parametrize(("fits", "misses"), [(48, 12), (24, 36)])
def test_unknown_surroundings_may_resemble_another_pose_by_any_share(fits: int, misses: int) -> None:
    found = resemblance_of(at_poses((0, 0, 60, 0), (fits, misses, 0, 0)), 0.125)
    assert found.here[0, 1] == pytest.approx(max(closed(0.125 * fits, 0.125 * misses)), abs=0.01)
    assert found.here[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert found.here[1, 0] == pytest.approx(max(found.here[1, 1], found.elsewhere[1]))  # it is known there


def test_a_place_that_is_known_better_is_no_better_than_one_that_looks_alike_and_is_known_less_well() -> None:
    """Of a surface that was seen once, the density is broad. Readings of the right pose fit another room more sharply."""
    found = at_poses((54, 6, 0, 0), (54, 6, 0, 0), (0, 60, 0, 0))
    vague = replace(found, ratios=np.where(found.ratios > 0, [[2.0], [6.0], [6.0]], found.ratios))
    found_there = resemblance_of(vague, 0.125)
    here = found_there.here
    assert here[1, 1] - here[0, 0] > 20.0
    assert here[0, 1] == pytest.approx(here[1, 1])
    assert here[2, 1] == pytest.approx(found_there.elsewhere[2])  # what does not fit there remains so


def test_readings_that_fit_by_chance_beside_the_unknown_add_nothing_to_what_resembles_another_pose() -> None:
    """As at a pose within a wall: of rays that the graph does not answer there, some fit, and others fit the other pose."""
    found = at_poses((0, 0, 60, 0), (36, 24, 0, 0))
    found.ratios[0, 36:] = 3.0
    alike = resemblance_of(found, 0.125)
    assert alike.here[0, 0] > 6.0
    assert alike.here[0, 1] == pytest.approx(max(alike.here[1, 1], alike.elsewhere[1]))


PLACES = 15.0
"""Logarithm of a number of places."""


def two_modes(n_scans: int, surroundings: float) -> list[Mode]:
    """Return two modes after scans: the graph answers none at the first, and predicts most of the readings at the second."""
    modes = [
        Mode(pose=np.array([x, 0.0, 0.0]), covariance=np.eye(3), score=0.0, number=1 + k)
        for k, x in enumerate((0.0, 8.0))
    ]
    priors = replace(TRACKING, surroundings=surroundings)
    for _ in range(n_scans):
        modes = weighed(modes, at_poses((0, 0, 60, 0), (54, 6, 0, 0)), 0.01, 1.0, PLACES, priors)
    return modes


@pytest.mark.parametrize("n_scans", [1, 3, 6])
def test_a_mode_in_unknown_surroundings_loses_against_one_that_predicts_the_readings(n_scans: int) -> None:
    """It loses the evidence of the readings, until it has lost the prior of a place among all: then it may look alike."""
    first, second = (mode.score for mode in two_modes(n_scans, 1e9))
    predicted = n_scans * closed(0.54, 0.06)[0]
    assert second == pytest.approx(predicted, abs=0.1)
    assert first == pytest.approx(float(np.logaddexp(0.0, predicted - PLACES)), abs=0.1)
    assert (first < 0.1) == (n_scans == 1)


def test_surroundings_that_are_others_resemble_no_place_any_more() -> None:
    modes = two_modes(6, 5.0)
    assert modes[0].resembles[2] > 2.0
    before = modes[0].score
    modes = weighed(modes, at_poses((0, 0, 60, 0), (0, 60, 0, 0)), 0.125, 1.0, PLACES, TRACKING)
    lost = before - modes[0].score
    assert 0.0 < lost < math.log(TRACKING.surroundings / TRACKING.independent_distance) + 0.1


def test_robots_that_are_carried_away_and_back_keep_the_sum() -> None:
    mode = Mode(pose=np.zeros(3), covariance=np.eye(3), score=math.log(0.9), alike=math.log(0.1), number=1)
    for share, expected in ((0.0, 0.9), (0.01, 0.892), (0.5, 0.5)):
        moved = exchanged(mode, share)
        assert math.exp(moved.score) == pytest.approx(expected)
        assert moved.total == pytest.approx(0.0, abs=1e-12)


def test_a_found_pose_has_the_evidence_since_the_robot_may_have_been_carried_there() -> None:
    gains = np.array([[-3.0, -2.0], [1.0, 0.0]])  # from each scan on; the second one is of the new pose
    of_main = np.array([[-3.0, -2.0], [-4.0, -2.0]])
    carried = np.log([1e-3, 1e-3])
    main = Mode(pose=np.zeros(3), covariance=np.eye(3), score=math.log(0.9), alike=math.log(0.1), number=1)
    here = 0.9 * 1e-3 * (math.exp(-3 + 3) + math.exp(1 + 4)) + 0.1 * math.exp(-3 + 2)
    alike = 0.9 * 1e-3 * (math.exp(-2 + 3) + math.exp(0 + 4)) + 0.1 * math.exp(-2 + 2)
    assert np.exp(found_scores(main, -np.inf, gains, of_main, carried)) == pytest.approx(
        [here / 2, alike / 2]
    )
    alone = np.exp(found_scores(None, 0.0, gains, of_main, carried))
    assert alone == pytest.approx([math.exp(-3) / 2, math.exp(-2) / 2])


def test_a_mode_that_resembles_a_found_pose_is_as_much_more_probable() -> None:
    mode = Mode(pose=np.zeros(3), covariance=np.eye(3), score=0.0, number=1).resembling(2, math.log(3.0))
    assert math.exp(mode.score) == pytest.approx(1.0 + 3.0)
    other = mode.resembling(3, math.log(0.5))  # against the first two
    assert math.exp(other.score) == pytest.approx(1.0 + 3.0 + 2.0)
    assert np.exp(list(other.resembles.values())) == pytest.approx([3.0, 2.0])


def test_the_likelihood_of_a_wide_mode_is_the_mean_over_its_parts() -> None:
    mode = Mode(pose=np.zeros(3), covariance=np.eye(3), score=-1.0, alike=-2.0, number=1)
    one_fits = mode.weighted(np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0, 0.0]))
    assert (one_fits.score + 1.0, one_fits.alike + 2.0) == pytest.approx([30.0 - math.log(7.0)] * 2)
    assert one_fits.pose == pytest.approx(mode.parts()[2])
    assert np.linalg.det(one_fits.covariance) == pytest.approx(0.25**3)
    same = mode.weighted(np.full(7, 4.0))
    assert same.score == pytest.approx(3.0)
    assert same.covariance == pytest.approx(mode.covariance)


def test_a_mode_whose_unknown_surroundings_look_like_a_found_pose_keeps_its_lead() -> None:
    """Both predict the readings then, and only being carried there distinguishes them, once in ten hours."""
    main = Mode(pose=np.zeros(3), covariance=np.eye(3), score=0.0, number=1)
    new = replace(Mode.found_at(np.ones(3)), number=2)
    scan = resemblance_of(at_poses((54, 6, 0, 0), (0, 0, 60, 0)), 0.125)
    gains = np.repeat(np.vstack([scan.here, scan.elsewhere])[None], 3, axis=0)
    found, odds = found_mode(new, [main], -np.inf, gains, np.full(3, -12.0), PLACES)
    assert found.score > 20.0  # by itself, it would be the more probable
    lead = main.resembling(2, float(odds[0])).score - found.score
    assert lead == pytest.approx(12.0 + math.log(2.0), abs=0.01)


@pytest.mark.parametrize("better", [0, 3])
def test_what_already_resembles_a_mode_gains_by_a_found_pose_only_what_that_predicts_better(
    better: int,
) -> None:
    """As a belief outside the graph, while a search finds a second pose from which the same walls are seen."""
    modes = two_modes(6, 5.0)
    scan = resemblance_of(at_poses((54 + better, 6 - better, 0, 0), (0, 0, 60, 0), (54, 6, 0, 0)), 0.01)
    gains = np.repeat(np.vstack([scan.here, scan.elsewhere])[None], 5, axis=0)
    _, odds = found_mode(Mode.found_at(np.ones(3)), modes, -np.inf, gains, np.full(5, -12.0), PLACES)
    after = modes[0].resembling(3, float(odds[0]))
    predicted = 5 * float(scan.here[0, 0] - scan.here[2, 2])
    assert 0.0 < after.score - modes[0].score <= float(np.logaddexp(0.0, predicted)) + 1e-9
