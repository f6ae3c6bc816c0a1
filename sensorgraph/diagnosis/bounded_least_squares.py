"""Least squares with bounds: the minimum of a convex quadratic over a box.

    minimise  x'Hx / 2 - c'x   subject to   low <= x <= high

Primal active-set method: Stark and Parker (1995), "Bounded-variable least squares: an algorithm and applications",
Computational Statistics 10; Björck (1996), Numerical Methods for Least Squares Problems, section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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


def solve_bounded(H: Floats, c: Floats, low: Floats, high: Floats) -> BoundedOptimum:
    """Minimise x'Hx / 2 - c'x within bounds.

    The start is cheap and nearly always final: solve without bounds, clamp what lies beyond them, solve for the rest
    until nothing does. From there on a bound whose multiplier has the wrong sign is released, one at a time, and
    every step descends, so that the method ends at the optimum after finitely many steps.

    Parameters
    ----------
    H : (k, k) symmetric, positive definite; if it is singular, c must lie in its range, as in least squares
    c : (k,)
    low, high : (k,) may be infinite; an unknown with low == high is held there

    Returns
    -------
    BoundedOptimum with x (k,) and is_free (k,)
    """
    can_move = low < high
    x = np.where(can_move, 0.0, high)
    free = can_move.copy()
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


def _solve(H: Floats, c: Floats, x: Floats, free: Bools) -> Floats:
    """Return the optimum of the free unknowns, the others where they are in x."""
    held = ~free
    left, right = H[np.ix_(free, free)], c[free] - H[np.ix_(free, held)] @ x[held]
    try:
        return np.asarray(np.linalg.solve(left, right), dtype=np.float64)
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
