"""The distribution of a reading, and its likelihood: agree with scipy and plain numpy, and add up to one."""

from __future__ import annotations

import numpy as np
import pytest
from plain_models import information_share_plain, log_density_plain
from scipy.stats import norm

from sensorgraph.models.distribution import Mixture
from sensorgraph.models.likelihood import information_share, log_density
from sensorgraph.models.residual_memory import LIFETIMES, SIZES, ResidualMemory
from sensorgraph.types import Floats


def some_mixture(n: int = 40) -> Mixture:
    """Rays (1, n) of up to four surfaces, the last entries unused."""
    rng = np.random.default_rng(5)
    means = np.sort(rng.uniform(0.5, 6.0, (1, n, 4)))
    weights = rng.dirichlet(np.ones(5), (1, n))
    none = weights[..., 4].copy()
    weights = weights[..., :4].copy()
    unused = np.arange(4) >= rng.integers(1, 5, (1, n, 1))
    none += np.where(unused, weights, 0.0).sum(axis=2)
    weights[unused], means[unused] = 0.0, np.inf
    return Mixture(
        means=means,
        weights=weights,
        widths=rng.uniform(0.005, 0.3, means.shape),
        sources=np.zeros(means.shape, dtype=np.intp),
        p_no_return=none,
    )


def test_mixture_agrees_with_scipy() -> None:
    mixture = some_mixture()
    z = np.linspace(0.4, 6.5, mixture.means.shape[1])[None]
    used = mixture.weights > 0
    share = mixture.weights / mixture.weights.sum(axis=2, keepdims=True)
    at = np.where(used, mixture.means, 0.0)
    pdf = np.where(used, share * norm.pdf(z[..., None], at, mixture.widths), 0.0).sum(axis=2)
    cdf = np.where(used, share * norm.cdf(z[..., None], at, mixture.widths), 0.0).sum(axis=2)
    np.testing.assert_allclose(mixture.pdf(z), pdf, atol=1e-7)
    np.testing.assert_allclose(mixture.cdf(z), cdf, atol=1e-8)


@pytest.mark.parametrize("q", [0.005, 0.25, 0.5, 0.9, 0.995])
def test_quantile_inverts_the_distribution(q: float) -> None:
    mixture = some_mixture()
    np.testing.assert_allclose(mixture.cdf(mixture.quantile(q)), q, atol=1e-4)


def test_likelihood_of_every_kind_of_reading_agrees_with_plain_numpy() -> None:
    mixture = some_mixture()
    z = np.linspace(0.1, 7.0, mixture.means.shape[1])[None].copy()
    z[0, :3] = np.inf, -np.inf, np.nan
    found = log_density(mixture, z, 0.3, 0.01)
    np.testing.assert_allclose(found, log_density_plain(mixture, z, 0.3, 0.01), atol=1e-6)
    assert found[0, 0] == pytest.approx(np.log(max(mixture.p_no_return[0, 0], 1e-4)))
    assert found[0, 2] == 0.0


def test_probability_of_all_readings_is_one() -> None:
    """The density over all returns, and the probability of no return."""
    mixture = some_mixture(1)
    z = np.linspace(-1.0, 9.0, 20_001)
    density = np.exp([log_density(mixture, np.array([[x]]), 0.0, 0.0)[0, 0] for x in z])
    assert np.trapezoid(density, z) + mixture.p_no_return[0, 0] == pytest.approx(1.0, abs=2e-3)


def memory_of(noise: dict[float, float]) -> ResidualMemory:
    """A memory whose squares of some sizes [m] contribute some shares of the variance."""
    shape = len(SIZES), len(LIFETIMES) + 1
    shares = np.zeros(shape)
    for size, share in noise.items():
        shares[SIZES.index(size), 0] = share
    return ResidualMemory(
        sizes=np.array(SIZES), lifetimes=np.array(LIFETIMES), events=np.zeros(shape), noise=shares
    )  # fmt: skip


def room_scan(bearings: Floats) -> tuple[Floats, Floats]:
    """End points (n, 2) of rays from (0, 0) in a room of 5 x 3 m, and the normals of the walls that they end on."""
    u = np.column_stack([np.cos(bearings), np.sin(bearings)])
    half = np.where(u > 0, [3.0, 1.2], [2.0, 1.8])
    with np.errstate(divide="ignore"):
        along = half / np.abs(u)
    axis = np.argmin(along, axis=1)
    normals = np.zeros_like(u)
    normals[np.arange(len(u)), axis] = -np.sign(u[np.arange(len(u)), axis])
    return u * along.min(axis=1)[:, None], normals


def test_share_of_the_information_is_that_of_the_plain_formula() -> None:
    rng = np.random.default_rng(2)
    ends = np.stack([room_scan(np.sort(rng.uniform(-2.2, 2.2, 50)))[0] for _ in range(3)])
    ends += 0.01 * rng.normal(size=ends.shape)
    ends[1, 10:20] = np.nan
    memory = memory_of({0.1: 0.3, 1.6: 0.5})
    found = information_share(memory, ends)
    np.testing.assert_allclose(found, information_share_plain(memory, ends), rtol=1e-9)
    assert (found < 0.6).all()
    np.testing.assert_allclose(information_share(memory, rng.permutation(ends[0])[None]), found[:1])
    np.testing.assert_allclose(information_share(memory_of({}), ends), 1.0)
    np.testing.assert_allclose(information_share(memory, np.full((1, 50, 2), np.nan)), 1.0)


def test_a_posterior_with_the_share_is_as_wide_as_its_errors() -> None:
    """Poses by least squares from ranges with correlated errors, in units of the stated width."""
    rng, sigma, shares = np.random.default_rng(3), 0.02, {0.4: 0.3, 1.6: 0.5}
    bearings = np.linspace(-2.2, 2.2, 60)
    ends, normals = room_scan(bearings)
    apart = np.hypot(*np.moveaxis(ends[:, None] - ends[None], -1, 0))
    correlation = np.eye(60) * (1.0 - sum(shares.values()))
    for (
        size,
        share,
    ) in shares.items():  # mean share of two points in one square, which directions of the pair vary
        ratio = np.minimum(apart / size, 1.0)
        correlation += share * np.where(ratio < 1.0, 1.0 - (4.0 - ratio) * ratio / np.pi, 0.0)
    cosine = np.abs(np.einsum("ni,ni->n", normals, ends)) / np.hypot(*ends.T)
    lever = ends[:, 0] * normals[:, 1] - ends[:, 1] * normals[:, 0]
    jacobian = np.column_stack([normals, lever]) / cosine[:, None]  # of a range; its spread is sigma / cosine
    errors = rng.multivariate_normal(np.zeros(60), correlation, 2000) * sigma / cosine
    rows = jacobian * (cosine / sigma)[:, None]
    poses = errors * (cosine / sigma) @ np.linalg.pinv(rows).T
    share = information_share(memory_of(shares), ends[None])[0]
    squares = np.einsum("ni,ij,nj->n", poses, share * rows.T @ rows, poses)
    assert squares.mean() / 3.0 == pytest.approx(1.0, abs=0.1)
