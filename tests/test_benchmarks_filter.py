"""The filter of the graph: particles stay where no reading says anything, and move to a likely pose where one does."""

from __future__ import annotations

import numpy as np

from benchmarks.graph_filter import LEAST, spread_of, updated
from sensorgraph.types import Floats, Ints


class Likelihood:
    """Normal around a pose, or flat."""

    rays = np.arange(16)

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    def is_near(self, _: Floats) -> bool:
        return True

    def of(self, particles: Floats, some: Ints) -> Floats:
        off = (particles - [0.1, 0.0, 0.02]) / self.sigma
        return np.asarray(-0.5 * (off**2).sum(axis=1) * len(some) / len(self.rays))


def particles_of(rng: np.random.Generator) -> Floats:
    return rng.normal(size=(1000, 3)) * [0.2, 0.2, 0.05]


def test_readings_that_say_nothing_leave_the_particles_where_they_are() -> None:
    rng = np.random.default_rng(0)
    particles = particles_of(rng)
    found = particles
    for _ in range(20):
        found = updated(found, Likelihood(np.inf), rng)  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.sort(found, axis=0), np.sort(particles, axis=0))


def test_the_posterior_has_mean_and_width_of_the_product() -> None:
    """Normal prior times normal likelihood, both known."""
    rng, sigma, prior = np.random.default_rng(1), 0.05, np.array([0.2, 0.2, 0.05])
    many = [updated(particles_of(rng), Likelihood(sigma), rng) for _ in range(20)]  # type: ignore[arg-type]
    width = 1 / np.sqrt(1 / prior**2 + 1 / sigma**2)
    mean = np.array([0.1, 0.0, 0.02]) * width**2 / sigma**2
    assert min(len(one) for one in many) >= LEAST
    np.testing.assert_allclose(
        np.mean([one.mean(axis=0) for one in many], axis=0), mean, atol=0.25 * width.min()
    )
    np.testing.assert_allclose(np.mean([spread_of(one) for one in many], axis=0), width, rtol=0.35)
