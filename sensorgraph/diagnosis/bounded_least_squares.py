"""Least squares with bounds: the minimum of a convex quadratic over a box.

    minimise  x'Hx / 2 - c'x   subject to   low <= x <= high

Primal active-set method: Stark and Parker (1995), "Bounded-variable least squares: an algorithm and applications",
Computational Statistics 10; Björck (1996), Numerical Methods for Least Squares Problems, section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sensorgraph.types import Bools, Floats

ROUND_OFF = 64 * float(np.finfo(np.float64).eps)
"""A slope below this share of the terms it is summed from is zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedOptimum:
    """Where a convex quadratic is least within bounds."""

    x: Floats
    """(k,)"""
    is_free: Bools
    """(k,) False where a bound is active."""


def solve_bounded(
    H: Floats, c: Floats, low: Floats, high: Floats, start: BoundedOptimum | None = None
) -> BoundedOptimum:
    """Minimise x'Hx / 2 - c'x within bounds.

    The start is cheap and nearly always final: solve without bounds, clamp what lies beyond them, solve for the rest
    until nothing does. From there on a bound whose multiplier has the wrong sign is released, one at a time, and
    every step descends, so that the method ends at the optimum after finitely many steps.

    Parameters
    ----------
    H : (k, k) symmetric, positive definite; if it is singular, c must lie in its range, as in least squares
    c : (k,)
    low, high : (k,) may be infinite; an unknown with low == high is held there
    start : optimum of a similar problem with the same bounds, whose active bounds are tried first

    Returns
    -------
    BoundedOptimum with x (k,) and is_free (k,)
    """
    can_move = low < high
    x = np.where(can_move, 0.0 if start is None else start.x, high)
    free = can_move.copy() if start is None else can_move & start.is_free
    while free.any():
        x[free] = _solve(H, c, x, free)
        beyond = free & ((x < low) | (x > high))
        if not beyond.any():
            break
        x[beyond] = np.clip(x[beyond], low[beyond], high[beyond])
        free &= ~beyond
    if (free == can_move).all():
        return BoundedOptimum(x=x, is_free=free)
    stuck = np.zeros_like(free)  # released, but round-off sent them back: left alone until another one moves
    for _ in range(10 * len(c)):  # exact arithmetic needs no limit: no set of bounds comes twice
        worst = _wrongly_held(H, c, x, low, can_move & ~free & ~stuck)
        if worst is None:
            break
        before = x[worst]
        free[worst] = True
        _descend(H, c, x, free, low, high)
        stuck[worst] = x[worst] == before
        if not stuck[worst]:
            stuck[:] = False
    return BoundedOptimum(x=x, is_free=free)


class BorderedProblem:
    """A bounded problem that is solved once, then with a few unknowns without bounds beside its own.

    Where they leave the active bounds as they are, an answer costs a solution with the factor at hand instead of a
    new factor (the Schur complement of the border); elsewhere all is solved again, from those bounds.

    Parameters
    ----------
    H, c, low, high : as `solve_bounded` takes them
    """

    def __init__(self, H: Floats, c: Floats, low: Floats, high: Floats) -> None:
        self.H, self.c, self.low, self.high = H, c, low, high
        self.optimum = solve_bounded(H, c, low, high)
        free = self.optimum.is_free
        try:
            self._factor = cho_factor(H[np.ix_(free, free)]) if free.any() else None
        except np.linalg.LinAlgError:
            self._factor = None

    def with_border(self, across: Floats, corner: Floats, d: Floats) -> Floats:
        """Return the optimum of all unknowns, the further ones last.

        Parameters
        ----------
        across : (n, k) products of the problem's own n unknowns with the k further ones
        corner : (k, k) products of the further ones with each other
        d : (k,) continues c
        """
        k = across.shape[1]
        x, free = self.optimum.x.copy(), self.optimum.is_free
        if self._factor is not None:
            turned = cho_solve(self._factor, across[free])
            z = np.linalg.lstsq(corner - across[free].T @ turned, d - across.T @ x, rcond=None)[0]
            x[free] -= turned @ z
            if self._is_optimal(x, self.c - across @ z):
                return np.concatenate([x, z])
        H = np.block([[self.H, across], [across.T, corner]])
        open_ended = np.full(k, np.inf)
        start = BoundedOptimum(
            x=np.concatenate([self.optimum.x, np.zeros(k)]),
            is_free=np.concatenate([free, np.ones(k, dtype=np.bool_)]),
        )
        low, high = np.concatenate([self.low, -open_ended]), np.concatenate([self.high, open_ended])
        return solve_bounded(H, np.concatenate([self.c, d]), low, high, start).x

    def _is_optimal(self, x: Floats, c: Floats) -> bool:
        """Return whether x lies within the bounds and none that is active should be released."""
        if (x < self.low).any() or (x > self.high).any():
            return False
        held = ~self.optimum.is_free & (self.low < self.high)
        return not held.any() or _wrongly_held(self.H, c, x, self.low, held) is None


def _solve(H: Floats, c: Floats, x: Floats, free: Bools) -> Floats:
    """Return the optimum of the free unknowns, the others where they are in x."""
    held = ~free
    left, right = H[np.ix_(free, free)], c[free] - H[np.ix_(free, held)] @ x[held]
    try:
        return np.asarray(cho_solve(cho_factor(left, overwrite_a=True), right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(left, right, rcond=None)[0], dtype=np.float64)


def _wrongly_held(H: Floats, c: Floats, x: Floats, low: Floats, held: Bools) -> int | None:
    """Return the unknown at a bound whose release gains most to first order; None at the optimum."""
    slope = c - H @ x  # minus the gradient; the multiplier of an active bound
    inward = np.where(x == low, slope, -slope)
    noise = ROUND_OFF * (np.abs(c) + np.abs(H) @ np.abs(x))
    gain = np.where(held & (inward > noise), inward**2 / np.maximum(np.diag(H), 1e-300), 0.0)
    worst = int(np.argmax(gain))
    return worst if gain[worst] > 0.0 else None


def _descend(H: Floats, c: Floats, x: Floats, free: Bools, low: Floats, high: Floats) -> None:
    """Move x to the optimum of the free unknowns, stopping at each bound on the way; x and free change in place."""
    while free.any():
        target = x.copy()
        target[free] = _solve(H, c, x, free)
        below, above = free & (target < low), free & (target > high)
        if not (below | above).any():
            x[:] = target
            return
        bound = np.where(below, low, high)
        share = np.divide(bound - x, target - x, out=np.full(len(x), np.inf), where=below | above)
        first = share <= share.min()
        x[free] += max(float(share.min()), 0.0) * (target - x)[free]
        x[first] = bound[first]
        free &= ~first
