"""Linear regression of whitened rows with bounded Gaussian priors.

    minimise  |y - A theta|² / 2 + |(theta - mean) / sigma|² / 2   subject to   |theta - mean| <= reach

Each tolerance is a coefficient with a narrow prior and a bound. An effect is the same coefficient without a
prior. The optimum is the mode of the posterior (ridge regression; Hoerl and Kennard 1970).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sensorgraph.diagnosis.engine.selection import occam_factor
from sensorgraph.diagnosis.scan.normal_equations import solve_bounded
from sensorgraph.effects import Effect
from sensorgraph.types import Bools, Floats, Ints

CLUSTER = 2.0
"""[s] within which errors may be correlated, beyond the whitening filter; over longer times, the reference is more accurate
than the wheels."""
TEMPERATURE = 4.0
"""Divisor of the evidence before it becomes a probability, since models are wrong in more ways than noise."""
RIDGE = 1e-8
"""Share of the mean square of the columns; keeps normal equations without a prior regular."""


@dataclass(frozen=True)
class Term:
    """A hypothesis and its column in the regression: an effect, or a tolerance without a name that is freed."""

    effect: Effect | None
    column: int
    family: str = ""
    """Kind of the difference without a name."""

    @property
    def named(self) -> Effect:
        """The effect of a hypothesis that has one."""
        assert self.effect is not None
        return self.effect

    @property
    def n_parameters(self) -> int:
        """Number of parameters that count for the complexity penalty."""
        return 1 if self.effect is None else len(self.effect.parameters)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Rows of one or several kinds, for instance translation and rotation, at the same moments."""

    valid: Bools
    """(n,) valid rows of each kind."""

    @property
    def n(self) -> int:
        """Number of rows of one kind."""
        return len(self.valid)

    @property
    def n_valid(self) -> int:
        """Number of valid rows of one kind."""
        return int(self.valid.sum())

    def price(self, n_parameters: int) -> float:
        """Return the complexity penalty [nats] of free parameters, for rows of two kinds."""
        return occam_factor(n_parameters, 2 * self.n_valid)

    def masked(self, rows: Floats) -> Floats:
        """Return rows of one kind or several (n_kinds n, ...), 0 where not valid."""
        some = np.tile(self.valid, len(rows) // self.n)
        return np.asarray(np.where(some if rows.ndim == 1 else some[:, None], rows, 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedPrior:
    """Bounded Gaussian prior of each coefficient."""

    mean: Floats
    """(k,)"""
    sigma: Floats
    """(k,) infinite for a free coefficient."""
    reach: Floats
    """(k,) maximum distance from the mean."""

    @classmethod
    def of(cls, sigma: Floats, mean: Floats, max_sigmas: float) -> BoundedPrior:
        """Return the prior with bounds at `max_sigmas` standard deviations from the mean."""
        return cls(mean=mean, sigma=sigma, reach=max_sigmas * sigma)

    def freed(self, which: Sequence[int]) -> BoundedPrior:
        """Return the prior with some coefficients free."""
        sigma, reach = self.sigma.copy(), self.reach.copy()
        sigma[list(which)] = reach[list(which)] = np.inf
        return BoundedPrior(mean=self.mean, sigma=sigma, reach=reach)

    def unbounded_from(self, k: int) -> BoundedPrior:
        """Return the prior without bounds on coefficient k and all later ones."""
        reach = self.reach.copy()
        reach[k:] = np.inf
        return BoundedPrior(mean=self.mean, sigma=self.sigma, reach=reach)


@dataclass(frozen=True, kw_only=True, eq=False)
class RegressionFit:
    """Coefficients at the bounded optimum."""

    theta: Floats
    """(k,)"""
    log_posterior: float
    """[nats] penalised log-likelihood, without constants."""
    covariance: Floats
    """(k, k); zero where a bound is active."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Regression:
    """Whitened rows y = A theta + white noise, and their normal equations."""

    A: Floats
    """(n, k)"""
    y: Floats
    """(n,)"""
    G: Floats
    """(k, k) A'A"""
    b: Floats
    """(k,) A'y"""

    @classmethod
    def of(cls, A: Floats, y: Floats) -> Regression:
        """Form the normal equations once, for solutions under several priors."""
        return cls(A=A, y=y, G=A.T @ A, b=A.T @ y)

    def solve(self, prior: BoundedPrior) -> RegressionFit:
        """Return the penalised optimum within the bounds of the prior."""
        k = len(self.b)
        weight = np.where(np.isinf(prior.sigma), 0.0, 1 / np.maximum(prior.sigma, 1e-12) ** 2)
        H = self.G + np.diag(weight + 1e-12 * np.diag(self.G) + 1e-30)
        c = self.b + weight * prior.mean
        optimum = solve_bounded(H, c, prior.mean - prior.reach, prior.mean + prior.reach)
        theta, free = optimum.x, optimum.is_free
        off = np.where(weight > 0, theta - prior.mean, 0.0)
        misfit = float(self.y @ self.y - 2 * self.b @ theta + theta @ self.G @ theta)
        covariance = np.zeros((k, k))
        covariance[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)]) if free.any() else 0.0
        return RegressionFit(
            theta=theta,
            log_posterior=-0.5 * misfit - 0.5 * float(weight @ off**2),
            covariance=covariance,
        )

    def clustered_errors(self, fit: RegressionFit, clusters: Ints) -> Floats:
        """Return the standard errors (k,) if errors are correlated within clusters (n,); at least those of the model."""
        return np.sqrt(np.maximum(self.robust_variances(fit, clusters), np.diag(fit.covariance)))

    def robust_variances(self, fit: RegressionFit, clusters: Ints) -> Floats:
        """Return the variances (k,) by the scatter of the clusters (n,) alone.

            diag of  covariance  (sum over clusters of  s s')  covariance,   s = A' (y - A theta) of one cluster

        This is the sandwich estimator of Huber (1967) and White (1980), by clusters as in Liang and Zeger (1986).
        """
        scores = self.A * (self.y - self.A @ fit.theta)[:, None]
        sums = np.stack([np.bincount(clusters, weights=s) for s in scores.T], axis=1)
        return np.asarray(np.square(sums @ fit.covariance).sum(axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Model of a run at its optimum: y = simulated + columns theta + residual."""

    regression: Regression
    solution: RegressionFit
    columns: Floats
    """(k n, n_columns)"""
    y: Floats
    """(k n,) Rows of k kinds before whitening."""
    simulated: Floats
    """(k n,)"""
    motors: Any = None
    """Parameters of the simulation, if there is one."""

    @property
    def log_posterior(self) -> float:
        """[nats]"""
        return self.solution.log_posterior

    @property
    def residual(self) -> Floats:
        """(k n,)"""
        return np.asarray(self.y - self.simulated - self.columns @ self.solution.theta)

    def explained(self, columns: Sequence[int]) -> Floats:
        """Return the rows (k n,) that some columns explain."""
        return np.asarray(self.columns[:, columns] @ self.solution.theta[columns])

    def held_out_residual(self, prior: BoundedPrior, stamps: Floats) -> Floats:
        """Return the residual (k n,) of rows that were not fitted: every other block of the run, and vice versa.

        Parameters
        ----------
        stamps : (n,) [s]
        """
        y, regression = self.y - self.simulated, self.regression
        block = ((stamps - stamps[0]) // CLUSTER).astype(np.intp)
        half, out = np.tile(block % 2, len(y) // len(stamps)), np.zeros(len(y))
        for side in (0, 1):
            train = half == side
            fit = Regression.of(regression.A[train], regression.y[train]).solve(prior)
            out[~train] = (y - self.columns @ fit.theta)[~train]
        return out


def clusters_of(stamps: Floats, n_kinds: int) -> Ints:
    """Return the cluster (n_kinds n,) of rows at stamps (n,) [s], within which errors may be correlated."""
    block = ((stamps - stamps[0]) / CLUSTER).astype(np.intp)
    return np.tile(block, n_kinds)


def ridge_solution(A: Floats, y: Floats) -> Floats:
    """Return the least-squares solution (k,) of whitened rows, kept regular by a small ridge.

        theta = (A'A + RIDGE tr(A'A) / k I)⁻¹ A'y

    k is the number of columns.
    """
    G = A.T @ A
    return np.asarray(np.linalg.solve(G + RIDGE * np.trace(G) / len(G) * np.eye(len(G)), A.T @ y))
