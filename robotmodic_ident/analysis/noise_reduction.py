"""Remove measurement noise from a chaotic series: estimate orbit x and coefficients theta by joint least squares.

Minimised is `Σ_k ((measured(k) - x(k)) / sigma)² + Σ_k ((x(k) - f(x(k-1), ...; theta)) / tau)²`.

Regression on noisy past outputs is biased (errors in variables), and chaos rules out the free run that would avoid the
bias. Gauss-Newton solves the problem for decreasing tau, until the orbit obeys the model. This is weak-constraint
smoothing (Davies, Phys. Lett. A 1994), and the maximum likelihood of Schreiber and Kantz for Gaussian noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded

from robotmodic_ident.analysis.algebra import deterministic, evaluate, partial
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record, as_records
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

TAUS = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Ratios tau / sigma, from a first guess to nearly exact dynamics."""
MAX_STEPS = 12
"""Maximum number of Gauss-Newton steps for each tau."""
CONVERGED = 1e-9
"""Largest change of the orbit over its span below which the steps end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DenoisedOrbit:
    """A model without the bias of measurement noise, and its orbit."""

    model: Narmax
    series: Floats
    """(n,) output without noise."""
    sigma: float
    """[units of the output] standard deviation of the removed noise."""


def without_noise(model: Narmax, record: Record | Mapping[str, Floats]) -> DenoisedOrbit:
    """Estimate the orbit and the coefficients of a model jointly; its terms are unchanged.

    The method is for a series with measurement noise and (nearly) noise-free dynamics. The record must have no gaps.
    Inputs are assumed to be exact.
    """
    (record,) = as_records(record)
    if len(record.segments()) > 1:
        raise IdentError("the record has gaps; use a segment without gaps")
    plain = deterministic(model)
    problem = _OrbitProblem(plain, record)
    x, theta = problem.measured.copy(), plain.theta.copy()
    covariance = plain.covariance
    for tau in TAUS:
        for _ in range(MAX_STEPS):
            x, theta, covariance, moved = problem.step(x, theta, tau)
            if moved < CONVERGED:
                break
    noise = float(np.std(problem.measured - x))
    return DenoisedOrbit(
        model=replace(plain, theta=theta, covariance=noise**2 * covariance, estimator="orbit"),
        series=x,
        sigma=noise,
    )


class _OrbitProblem:
    """The normal equations of orbit and coefficients: a band for the orbit, with a border for the coefficients."""

    def __init__(self, model: Narmax, record: Record) -> None:
        self.terms, self.output = model.terms, model.output
        self.measured = np.asarray(record.signals[model.output], dtype=np.float64)
        self.look_back = model.terms.max_lag
        self.n = len(self.measured)
        self.inputs = {
            f.signal: self._lagged(np.asarray(record.signals[f.variable], dtype=np.float64), f.lag or 0)
            for term in model.terms
            for f in term
            if f.variable != model.output
        }
        self.own = sorted({f.lag or 0 for t in model.terms for f in t if f.variable == model.output})
        if not self.own:
            raise IdentError("the model has no past output, so noise on the output does not bias it; use fit")
        known = [self.measured, *self.inputs.values()]
        if not all(np.isfinite(values).all() for values in known) or self.n < 3 * (len(model.terms) + 1):
            raise IdentError("the record has unknown samples, or too few; use a complete segment")
        self.slopes = {
            lag: [partial(term, f"{self.output}(k-{lag})") for term in model.terms] for lag in self.own
        }

    def _lagged(self, values: Floats, lag: int) -> Floats:
        return values[self.look_back - lag : len(values) - lag]

    def step(self, x: Floats, theta: Floats, tau: float) -> tuple[Floats, Floats, Floats, float]:
        """Return orbit, coefficients, their covariance in units of the noise variance, and the largest relative change."""
        p, d = self.look_back, len(theta)
        columns = {f"{self.output}(k-{lag})": self._lagged(x, lag) for lag in self.own} | self.inputs
        phi = self._matrix(columns)  # (n - p, d)
        miss = (x[p:] - phi @ theta) / tau
        jacobian = {0: np.full(self.n - p, 1.0 / tau)}
        for lag in self.own:
            slope = sum(
                c * np.broadcast_to(evaluate(s, columns), self.n - p)
                for c, s in zip(theta, self.slopes[lag], strict=True)
            )
            jacobian[lag] = -np.asarray(slope) / tau
        band = np.zeros((p + 1, self.n))  # upper form of solveh_banded
        band[p] = 1.0
        right = x - self.measured
        border = np.zeros((self.n, d))
        rows = np.arange(p, self.n)
        for a, ja in jacobian.items():
            right[rows - a] += ja * miss
            border[rows - a] -= ja[:, None] * phi / tau
            for b, jb in jacobian.items():
                if a >= b:  # element (k-a, k-b) is on or above the diagonal
                    band[p - (a - b), rows - b] += ja * jb
        solved = solveh_banded(band, np.column_stack([right, border]))
        corner = phi.T @ phi / tau**2 - border.T @ solved[:, 1:]
        slack = -phi.T @ miss / tau - border.T @ solved[:, 0]
        inverse = np.asarray(np.linalg.pinv(corner, hermitian=True), dtype=np.float64)
        d_theta = -inverse @ slack
        d_x = -solved[:, 0] - solved[:, 1:] @ d_theta
        moved = float(np.abs(d_x).max() / max(float(np.ptp(self.measured)), 1e-300))
        return x + d_x, theta + d_theta, inverse, moved

    def _matrix(self, columns: Mapping[str, Floats]) -> Floats:
        return Terms(tuple(self.terms)).matrix(columns, n=self.n - self.look_back)
