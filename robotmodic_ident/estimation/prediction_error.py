"""Estimation with noise terms and ratios: extended least squares, then Gauss-Newton on exact gradients.

Least squares is biased where the noise is coloured. Extended least squares (Billings 2013, ch. 3) removes most of it;
minimising the prediction error itself (Ljung 1999, ch. 7) also gives honest standard errors.
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
"""Of a gradient's squared norm that the others do not explain; below it depends on them."""


class Evaluate(Protocol):
    """What a descent asks for: the sum of squares, and residuals and gradients of every segment."""

    def __call__(
        self, theta: Floats, /, *, gradient: bool = False
    ) -> tuple[float, list[Floats], list[Floats]]: ...


@dataclass(frozen=True, kw_only=True)
class LevenbergMarquardt:
    """When a descent ends and how far its steps are damped; numerical, none is fitted to data."""

    max_steps: int = 200
    converged: float = 1e-11
    """Relative gain of a step below which nothing more is to be had: rounding of the sum of squares."""
    damping: float = 1e-6
    """Of the first step, for columns of unit norm."""
    min_damping: float = 1e-9
    """Before it is raised after a step that failed."""
    max_damping: float = 1e10
    """Above this no step downhill is left."""
    factor: float = 10.0
    """By which the damping falls after a step that helped, and rises after one that did not."""


DESCENT = LevenbergMarquardt()


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Where a minimisation ended."""

    theta: Floats
    """(n_parameters,)"""
    rss: float
    count: int
    """Rows."""
    residuals: list[Floats]
    """(n,) of every segment; 0 where there is none."""
    gradients: list[Floats]
    """(n, n_parameters) of every segment: dŷ/dθ; 0 where there is none."""
    converged: bool

    @property
    def sigma(self) -> float:
        """Standard deviation of the residual, corrected for the parameters; nan if no row is left for it."""
        free = self.count - len(self.theta)
        return float(np.sqrt(self.rss / free)) if free > 0 else float("nan")

    def covariance(self, kind: Covariance) -> Floats:
        """Return the covariance of theta (n_parameters, n_parameters).

        `classical` holds for white residuals of one variance; `sandwich` for any variance (White 1980);
        `hac` also for correlated ones (Newey and West 1987, width by Andrews 1991).
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
    """Choose the Bartlett width for first-order correlated scores (Andrews 1991, eq. 6.4)."""
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
    """Least squares of what a model leaves in one-step prediction, over all segments."""

    def __init__(self, recursion: Recursion, records: Sequence[Record], first: int = 0) -> None:
        """Take records, of whose segments samples before `first` do not count."""
        self.recursion, self.first = recursion, first
        self.segments: list[Segment] = [s for record in records for s in recursion.segments(record)]
        self.rows = [self._rows(segment) for segment in self.segments]
        self.count = int(sum(rows.sum() for rows in self.rows))
        if self.count == 0:
            raise IdentError("the model predicts no sample of these records; give longer ones")

    def _rows(self, segment: Segment) -> np.ndarray:
        out, _, _ = self.recursion.run(segment, free=False)
        known = np.asarray(np.isfinite(out) & np.isfinite(segment.measured), dtype=np.bool_)
        return known & (np.arange(len(known)) >= self.first)

    def evaluate(self, theta: Floats, *, gradient: bool = False) -> tuple[float, list[Floats], list[Floats]]:
        """Return the residual sum of squares, residuals and gradients; inf where the run diverges."""
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
        """Yield columns (n, n_parameters) and a target (n,), a block of rows at a time.

        Least squares of all of them is one Gauss-Newton step. Without a denominator, and with noise terms of the first
        degree in e, the prediction error is linear in the process coefficients: there the step is exact for them.
        """
        for segment, rows in zip(self.segments, self.rows, strict=True):
            for part, out, slopes in self.recursion.gradient_blocks(segment, free=False, theta=theta):
                use = rows[part] & np.isfinite(out)
                J = slopes[use]
                yield J, segment.measured[part][use] - out[use] + J @ theta

    def gains(self, theta: Floats, new: Ints) -> Floats:
        """Return by how much each `new` parameter (n_new,), beside all others, would lower the sum of squares (n_new,).

        To first order: one Gauss-Newton step from `theta`. It is 0 for one that the others nearly say already.
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
        """Return Gram (n_parameters, n_parameters) and cross products with the residual, for gradients of unit norm.

        They are summed up a block of rows at a time.
        """
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
            if the starting model diverges
        """
        found = levenberg_marquardt(self.evaluate, start, DESCENT)
        return replace(found, count=self.count)


def levenberg_marquardt(evaluate: Evaluate, start: Floats, settings: LevenbergMarquardt) -> Estimate:
    """Descend from `start` (n_parameters,); the count of rows is that of the residuals.

    Parameters
    ----------
    evaluate : parameters, whether gradients are wanted -> sum of squares, residuals and gradients of every segment

    Raises
    ------
    IdentError
        if the starting model diverges
    """
    theta, damping, converged = np.array(start, dtype=np.float64), settings.damping, False
    cost, residuals, gradients = evaluate(theta, gradient=True)
    if not np.isfinite(cost):
        raise IdentError("the starting model diverges on these records, so it cannot be refined")
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
                converged = True  # no step downhill is left
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
    """Solve the damped normal equations with columns of unit norm; also return the gain that is expected."""
    J, r = np.concatenate(gradients), np.concatenate(residuals)
    size = np.abs(J).max(axis=0, initial=0.0)
    if not np.isfinite(size).all():
        raise IdentError("the gradients of the model diverge on these records, so it cannot be refined")
    size[size == 0] = 1.0
    size *= np.maximum(np.sqrt(((J / size) ** 2).sum(axis=0)), 1.0)
    p = J.shape[1]
    R = np.asarray(np.linalg.qr(np.column_stack([J / size, r]), mode="r"), dtype=np.float64)
    U, s, Vt = np.linalg.svd(R[:p, :p], full_matrices=False)  # fewer rows than columns: the shortest step
    seen = s > 1e-12 * s[0]
    part = U.T @ R[:p, p]
    weight = np.where(seen, s / (s**2 + damping), 0.0)
    return (Vt.T @ (weight * part)) / size, float((part[seen] ** 2).sum())
