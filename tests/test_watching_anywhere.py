"""Readings from anywhere, and in space that no training ray crossed: distributions sum to one, and rays are followed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from watching_samples import graph

from sensorgraph.models.seen_space import SeenSpace
from sensorgraph.types import Bools
from sensorgraph.watching.anywhere import AnyReading, UnseenSpace
from sensorgraph.watching.readings import GraphReadings

ANYWHERE = AnyReading.of(np.random.default_rng(0).gamma(2.0, 1.5, 2000), 100, 10.0)


def space(seen: Bools) -> UnseenSpace:
    """Return the space outside cells of 10 cm."""
    return UnseenSpace.of(SeenSpace(cells=seen, origin=np.array([-1.0, -2.0]), resolution=0.1), ANYWHERE)


def test_the_density_and_the_survival_function_are_of_one_distribution() -> None:
    z = np.linspace(0.0, 10.0, 20_001)
    density = np.exp(ANYWHERE.log_density(0.5 * (z[1:] + z[:-1])))
    longer = 1.0 - np.concatenate([[0.0], np.cumsum(density * np.diff(z))])
    assert np.abs(np.exp(ANYWHERE.log_survival(z)) - longer).max() < 1e-3
    assert longer[-1] == pytest.approx(math.exp(ANYWHERE.log_density(np.array([np.inf]))[0]), abs=1e-3)


def test_a_ray_passes_unseen_space_as_it_would_anywhere_and_seen_space_always() -> None:
    rng = np.random.default_rng(1)
    headings, lengths = rng.uniform(-np.pi, np.pi, (4, 9)), rng.uniform(0.5, 6.0, 9)
    starts = rng.uniform(-3.0, 3.0, (4, 1, 2))
    nothing, everything = space(np.zeros((20, 30), np.bool_)), space(np.ones((300, 300), np.bool_))
    found = nothing.log_passed(starts, headings, lengths)
    assert np.abs(found - ANYWHERE.log_survival(lengths)).max() < 1e-3
    inside = np.array([[[10.0, 10.0]]])
    assert not everything.log_passed(np.repeat(inside, 4, axis=0), headings, lengths).any()
    assert not everything.contains(inside).any()
    assert everything.contains(inside - 12.0).all() and nothing.contains(inside).all()


def test_unseen_cells_on_the_way_are_found_as_by_points_along_the_ray() -> None:
    rng = np.random.default_rng(2)
    seen = rng.random((60, 70)) < 0.6
    place = space(seen)
    starts, headings, lengths = (
        rng.uniform(1.0, 2.0, (5, 1, 2)),
        rng.uniform(-np.pi, np.pi, (5, 8)),
        np.full(8, 4.0),
    )
    found = place.log_passed(starts, headings, lengths)
    r = (np.arange(8000) + 0.5) * 4.0 / 8000
    points = starts[:, :, None] + r[:, None] * np.stack([np.cos(headings), np.sin(headings)], -1)[:, :, None]
    change = np.diff(ANYWHERE.log_survival(np.linspace(0.0, 4.0, 8001)))
    expected = (place.contains(points) * change).sum(axis=2)
    assert np.abs(found - expected).max() < 0.005  # points of 0.5 mm along 4 m


def test_the_probabilities_of_all_readings_at_a_pose_sum_to_one_whatever_was_seen() -> None:
    readings = GraphReadings(graph(), graph().sensor)
    pose, rays = np.array([[2.5, 2.0, 0.3]]), readings.of_pose[::6]
    expected = readings.graph.predict(pose, rays=readings.own[rays])
    hidden = readings.seen.cells.copy()
    hidden[hidden.shape[0] // 2 :] = False  # from the middle of the room on
    for cells in (readings.seen.cells, hidden):
        readings._unseen = replace(readings._unseen, seen=replace(readings.seen, cells=cells))
        s, top = readings.priors.predicted, readings.sensor.range_max
        step = readings.sensor.sigma  # a sum at such steps is the integral of a Gaussian to 1e-8
        z = np.concatenate([np.arange(readings.sensor.range_min, top, step), [np.inf]])
        sums = np.zeros(len(rays))
        for one in z:
            found = readings.evidence(
                np.full(readings.sensor.n_rays, one), pose, rays, expected=replace(expected, answered=expected.answered & False)
            )  # fmt: skip
            p_0 = math.exp(readings.anywhere.log_density(np.array([one]))[0])
            sums += (np.exp(found.ratios[0]) - (1.0 - s)) / s * p_0 * (1.0 if np.isinf(one) else step)
        assert sums == pytest.approx(np.ones(len(rays)), abs=0.06)


def test_from_a_pose_in_unseen_space_only_answered_rays_count() -> None:
    readings = GraphReadings(graph(), graph().sensor)
    pose = np.array([[30.0, 30.0, 0.0]])
    found = readings.evidence(np.full(readings.sensor.n_rays, 2.0), pose)
    assert not found.ratios.any() and not found.known.any()
