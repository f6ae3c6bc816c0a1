"""Prediction-error estimation: minimise Σ r(k)², r = measured - ŷ(theta), with exact gradients J = dŷ/dtheta.

Levenberg-Marquardt solves (J'J + damping I) step = J'r for columns of J of unit norm. Least squares is biased for
coloured noise. Extended least squares (Billings 2013, ch. 3) removes most of the bias. Minimising the prediction error
(Ljung 1999, ch. 7) also gives valid standard errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.prediction.recursion import Recursion, Segment
from robotmodic_ident.records import Record
from robotmodic_ident.types import Floats, Ints

Covariance = Literal["classical", "sandwich", "hac"]
MIN_NEW_SHARE = 1e-10
"""Minimum share of the squared norm of a gradient that is independent of the others."""


class Evaluate(Protocol):
    """The function to minimise: sum of squares, and residuals and gradients of every segment."""

    def __call__(
        self, theta: Floats, /, *, gradient: bool = False
    ) -> tuple[float, list[Floats], list[Floats]]: ...


@dataclass(frozen=True, kw_only=True)
class LevenbergMarquardt:
    """Numerical settings of a descent, not fitted to data."""

    max_steps: int = 200
    """Maximum number of steps."""
    converged: float = 1e-11
    """Relative gain of a step below which the descent ends; smaller gains are rounding of the sum of squares."""
    damping: float = 1e-6
    """Damping of the first step, for columns of unit norm."""
    min_damping: float = 1e-9
    """Minimum damping from which it is increased after a failed step."""
    max_damping: float = 1e10
    """Damping above which the descent ends, because no step lowers the sum of squares."""
    factor: float = 10.0
    """Factor by which the damping decreases after a successful step and increases after a failed one."""


DESCENT = LevenbergMarquardt()


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """The result of a minimisation."""

    theta: Floats
    """(n_parameters,) estimated parameters."""
    rss: float
    """Residual sum of squares."""
    count: int
    """Number of rows."""
    residuals: list[Floats]
    """(n,) residuals of every segment; 0 for samples without a residual."""
    gradients: list[Floats]
    """(n, n_parameters) gradients dŷ/dtheta of every segment; 0 for samples without a residual."""
    converged: bool

    @property
    def sigma(self) -> float:
        """Standard deviation of the residual, corrected for the parameters; nan without degrees of freedom."""
        free = self.count - len(self.theta)
        return float(np.sqrt(self.rss / free)) if free > 0 else float("nan")

    def covariance(self, kind: Covariance) -> Floats:
        """Return the covariance of theta (n_parameters, n_parameters).

        With bread B = (J'J)⁻¹ and scores s(k) = J(k) r(k):

        * `classical`: sigma² B, for white residuals of constant variance.
        * `sandwich`: B Σ s(k) s(k)' B, for any variance (White 1980).
        * `hac`: also sums s(k) s(k-lag)' with Bartlett weights 1 - lag / (width + 1), for correlated residuals
          (Newey and West 1987, width by Andrews 1991).

        The last two are scaled by n / (n - n_parameters).
        """
        whole = np.concatenate(self.gradients)
        size = np.sqrt((whole**2).sum(axis=0))
        size[size == 0] = 1.0
        bread = np.linalg.pinv((whole / size).T @ (whole / size), hermitian=True)
        if kind == "classical":
            return np.asarray(self.sigma**2 * bread / np.outer(size, size), dtype=np.float64)
        scores = [g / size * r[:, None] for g, r in zip(self.gradients, self.residuals, strict=True)]
        meat = sum(s.T @ s for s in scores)
        if kind == "hac":
            width = _width(scores, self.count)
            for lag in range(1, width + 1):
                cross = sum(s[lag:].T @ s[:-lag] for s in scores if len(s) > lag)
                meat = meat + (1.0 - lag / (width + 1)) * (cross + np.transpose(cross))
        few = self.count / max(self.count - len(self.theta), 1)
        return np.asarray(few * (bread @ meat @ bread) / np.outer(size, size), dtype=np.float64)


def _width(scores: Sequence[Floats], count: int) -> int:
    """Return the Bartlett width for scores with first-order correlation (Andrews 1991, eq. 6.4)."""
    now = np.concatenate([s[1:] for s in scores])
    before = np.concatenate([s[:-1] for s in scores])
    power = (before**2).sum(axis=0)
    rho = np.clip((now * before).sum(axis=0) / np.where(power > 0, power, 1.0), -0.97, 0.97)
    sigma4 = power**2
    top = (4.0 * rho**2 * sigma4 / ((1 - rho) ** 6 * (1 + rho) ** 2)).sum()
    bottom = (sigma4 / (1 - rho) ** 4).sum()
    width = 1.1447 * (top / bottom * count) ** (1 / 3) if bottom > 0 else 0.0
    return int(min(np.ceil(width), count // 4))


class NonlinearLeastSquares:
    """Least squares of the one-step prediction error of a model over all segments."""

    def __init__(self, recursion: Recursion, records: Sequence[Record], first: int = 0) -> None:
        """Prepare the records; samples before `first` in each segment are ignored."""
        self.recursion, self.first = recursion, first
        self.segments: list[Segment] = [s for record in records for s in recursion.segments(record)]
        self.rows = [self._rows(segment) for segment in self.segments]
        self.count = int(sum(rows.sum() for rows in self.rows))
        if self.count == 0:
            raise IdentError("the model predicts no sample of these records; use longer records")

    def _rows(self, segment: Segment) -> np.ndarray:
        out, _, _ = self.recursion.run(segment, free=False)
        known = np.asarray(np.isfinite(out) & np.isfinite(segment.measured), dtype=np.bool_)
        return known & (np.arange(len(known)) >= self.first)

    def evaluate(self, theta: Floats, *, gradient: bool = False) -> tuple[float, list[Floats], list[Floats]]:
        """Return the residual sum of squares, residuals and gradients; inf if the run diverges."""
        total, residuals, gradients = 0.0, [], []
        for segment, rows in zip(self.segments, self.rows, strict=True):
            out, _, slopes = self.recursion.run(segment, free=False, theta=theta, gradient=gradient)
            rest = np.where(rows, segment.measured - out, 0.0)
            with np.errstate(over="ignore"):
                total += float(rest @ rest)
            residuals.append(rest)
            gradients.append(np.where(rows[:, None], slopes, 0.0) if gradient else slopes)
        return (total if np.isfinite(total) else np.inf), residuals, gradients

    def linearised(self, theta: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield columns J (n, n_parameters) and a target r + J theta (n,), a block of rows at a time.

        Least squares of all blocks is one Gauss-Newton step. Without a denominator, and with noise terms of degree 1
        in e, the prediction error is linear in the process coefficients, for which the step is then exact.
        """
        for segment, rows in zip(self.segments, self.rows, strict=True):
            for part, out, slopes in self.recursion.gradient_blocks(segment, free=False, theta=theta):
                use = rows[part] & np.isfinite(out)
                J = slopes[use]
                yield J, segment.measured[part][use] - out[use] + J @ theta

    def gains(self, theta: Floats, new: Ints) -> Floats:
        """Return the decrease of the sum of squares (n_new,) when each `new` parameter is added to all others.

        It is the first-order gain (J_new' M r)² / (J_new' M J_new) of one Gauss-Newton step from `theta`. M projects
        onto the complement of the gradients of the other parameters. The gain is 0 for nearly dependent parameters.
        """
        gram, cross = self._normal_equations(theta)
        others = np.setdiff1d(np.arange(len(gram)), new)
        inverse = np.linalg.pinv(gram[np.ix_(others, others)], hermitian=True)
        side = gram[np.ix_(others, new)]
        power = np.diagonal(gram)[new] - (side * (inverse @ side)).sum(axis=0)
        rest = cross[new] - side.T @ (inverse @ cross[others])
        is_new = power > MIN_NEW_SHARE
        return np.where(is_new, rest**2 / np.where(is_new, power, 1.0), 0.0)

    def _normal_equations(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return J'J (n_parameters, n_parameters) and J'r for gradients of unit norm, summed block by block."""
        m = len(theta)
        whole = np.zeros((m, m + 1))
        for J, target in self.linearised(theta):
            whole += J.T @ np.column_stack([J, target - J @ theta])
        size = np.sqrt(np.diagonal(whole))
        size = np.where(size > 0, size, 1.0)
        return whole[:, :m] / np.outer(size, size), whole[:, m] / size

    def minimise(self, start: Floats) -> Estimate:
        """Descend by Levenberg-Marquardt from `start` (n_parameters,).

        Raises
        ------
        IdentError
            If the initial model diverges.
        """
        found = levenberg_marquardt(self.evaluate, start, DESCENT)
        return replace(found, count=self.count)


def levenberg_marquardt(evaluate: Evaluate, start: Floats, settings: LevenbergMarquardt) -> Estimate:
    """Minimise a sum of squares from `start` (n_parameters,): solve (J'J + damping I) step = J'r, columns of unit norm.

    The damping decreases after a successful step and increases after a failed one (Levenberg 1944; Marquardt 1963).
    The `count` of the result is the number of residuals.

    Parameters
    ----------
    evaluate : function of the parameters that returns sum of squares, residuals and gradients of every segment

    Raises
    ------
    IdentError
        If the initial model diverges.
    """
    theta, damping, converged = np.array(start, dtype=np.float64), settings.damping, False
    cost, residuals, gradients = evaluate(theta, gradient=True)
    if not np.isfinite(cost):
        raise IdentError(
            "the initial model diverges on these records, so it cannot be refined; use fewer terms"
        )
    for _ in range(settings.max_steps):
        step, expected = _step(residuals, gradients, damping)
        trial = theta + step
        new, *_ = evaluate(trial)
        if new <= cost:
            gain = cost - new
            theta, damping = trial, damping / settings.factor
            cost, residuals, gradients = evaluate(theta, gradient=True)
            if gain <= settings.converged * cost:
                converged = True
                break
        else:
            damping = max(damping, settings.min_damping) * settings.factor
            if damping > settings.max_damping or expected <= settings.converged * cost:
                converged = True  # no step lowers the sum of squares
                break
    return Estimate(
        theta=theta,
        rss=cost,
        count=sum(map(len, residuals)),
        residuals=residuals,
        gradients=gradients,
        converged=converged,
    )


def _step(residuals: Sequence[Floats], gradients: Sequence[Floats], damping: float) -> tuple[Floats, float]:
    """Solve the damped normal equations with columns of unit norm; also return the expected gain."""
    J, r = np.concatenate(gradients), np.concatenate(residuals)
    size = np.abs(J).max(axis=0, initial=0.0)
    if not np.isfinite(size).all():
        raise IdentError(
            "the gradients of the model diverge on these records, so it cannot be refined; use fewer terms"
        )
    size[size == 0] = 1.0
    size *= np.maximum(np.sqrt(((J / size) ** 2).sum(axis=0)), 1.0)
    p = J.shape[1]
    R = np.asarray(np.linalg.qr(np.column_stack([J / size, r]), mode="r"), dtype=np.float64)
    U, s, Vt = np.linalg.svd(R[:p, :p], full_matrices=False)  # fewer rows than columns: the shortest step
    seen = s > 1e-12 * s[0]
    part = U.T @ R[:p, p]
    weight = np.where(seen, s / (s**2 + damping), 0.0)
    return (Vt.T @ (weight * part)) / size, float((part[seen] ** 2).sum())
