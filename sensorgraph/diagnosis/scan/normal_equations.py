"""Normal equations of a fit, and their optimum under the tolerances of the nuisances.

The unknowns are x = (g, p), the nuisances and effect parameters, and the pose error delta_s of each scan s.

    [ G    C_sᵀ ] [ x       ]   [ r   ]
    [ C_s  H_s  ] [ delta_s ] = [ b_s ].

Eliminating every delta_s by the Schur complement gives M x = right.

    M = G - Σ C_sᵀ H_s⁻¹ C_s,    right = r - Σ C_sᵀ H_s⁻¹ b_s,    delta_s = H_s⁻¹ (b_s - C_s x).

Triggs, McLauchlan, Hartley and Fitzgibbon 2000, bundle adjustment, section 6.

Least squares with bounds: minimise a convex quadratic over a box.

    minimise  x'Hx / 2 - c'x   subject to   low <= x <= high

At the optimum, the slope c - Hx is zero for free unknowns and points outward at active bounds.

Block principal pivoting exchanges all wrong bounds at once: Júdice and Pires (1994), "A block principal
pivoting algorithm for large-scale strictly monotone linear complementarity problems", Computers & Operations
Research 21. If it does not converge, bounded-variable least squares takes over, which terminates: Stark and
Parker (1995), "Bounded-variable least squares: an algorithm and applications", Computational Statistics 10.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dposv
from scipy.optimize import lsq_linear

from sensorgraph.types import Bools, Floats

PATIENCE = 3
"""Maximum number of successive exchanges of bounds that do not reduce the number of wrong ones."""
ROUND_OFF = 64 * float(np.finfo(np.float64).eps)
"""Share of the terms of a slope, below which their sum counts as zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """Normal equations with the poses eliminated; the unknowns are nuisances, corners and effect parameters."""

    matrix: Floats
    """(k, k) M"""
    right: Floats
    """(k,)"""
    poses: Floats
    """(n_scans, 3, 3) H_s, including the prior of the pose"""
    across: Floats
    """(n_scans, 3, k) C_s"""
    start: Floats
    """(n_scans, 3) H_s^-1 b_s"""
    logdet: float
    """Sum over scans of log |P_s H_s| = log |I + P_s BᵀWB|, with P_s the prior covariance of the pose."""

    def poses_at(self, x: Floats) -> Floats:
        """Return the most likely pose errors (n_scans, 3) given x (k,)."""
        return np.asarray(self.start - np.linalg.solve(self.poses, (self.across @ x)[..., None])[..., 0])


def without_poses(g: Floats, r: Floats, h: Floats, c: Floats, b: Floats, logdet: float) -> System:
    """Eliminate the pose errors of all scans by the Schur complement of their 3 x 3 blocks.

        M = g - Σ cᵀ h⁻¹ c,    right = r - Σ cᵀ h⁻¹ b.

    Parameters
    ----------
    g, r : (k, k), (k,) Normal equations at fixed poses.
    h, c, b : (n_scans, 3, 3), (n_scans, 3, k), (n_scans, 3) Blocks of the poses with their prior, their coupling to the
        other unknowns, and their right-hand side.
    logdet : Sum over scans of log |P_s|, with P_s the prior covariance of the pose.
    """
    lower = np.linalg.cholesky(h)
    inverse = np.linalg.inv(lower)
    whitened = np.matmul(inverse, c).reshape(3 * len(h), -1)
    residual = np.matmul(inverse, b[..., None])
    of_poses = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum()
    return System(
        matrix=g - whitened.T @ whitened,
        right=r - whitened.T @ residual.reshape(-1),
        poses=h,
        across=c,
        start=np.matmul(inverse.transpose(0, 2, 1), residual)[..., 0],
        logdet=float(logdet + of_poses),
    )


def boxed(
    matrix: Floats, right: Floats, tau: Floats, box: Floats, locked: Bools, like: BoundedOptimum | None = None
) -> BoundedOptimum:
    """Maximise rightᵀx - ½ xᵀMx - ½ |g/tau|² subject to |g| <= box.

    Parameters
    ----------
    matrix, right : (k, k), (k,) Normal equations M x = right; the first n unknowns are the nuisances g, the others have no bound.
    tau, box : (n,) Prior standard deviations and bounds.
    locked : (n,) Nuisances that are held at 0.
    like : Optimum of a similar problem, whose active bounds are tried first.
    """
    limit = limits(len(right), box, locked)
    if like is not None:
        like = replace(like, x=np.where(like.is_free, 0.0, np.sign(like.x) * np.minimum(limit, 1e300)))
    return solve_bounded(with_prior(matrix, tau), right, -limit, limit, like)


def with_prior(matrix: Floats, tau: Floats) -> Floats:
    """Return the normal matrix (k, k) plus the prior of the nuisances, its first n unknowns; tau (n,)."""
    n, k = len(tau), len(matrix)
    a = matrix.copy()
    a[np.arange(n), np.arange(n)] += 1 / tau**2
    a[np.arange(n, k), np.arange(n, k)] += 1e-9 + 1e-9 * np.diag(a)[n:]
    return a


def limits(k: int, box: Floats, locked: Bools) -> Floats:
    """Return the bounds of k unknowns: `box` (n,) for nuisances, 0 if locked; infinite for the others."""
    return np.concatenate([np.where(locked, 0.0, box), np.full(k - len(box), np.inf)])


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedOptimum:
    """Minimum of a convex quadratic within bounds."""

    x: Floats
    """(k,)"""
    is_free: Bools
    """(k,) False where a bound is active."""


def solve_bounded(
    H: Floats, c: Floats, low: Floats, high: Floats, start: BoundedOptimum | None = None
) -> BoundedOptimum:
    """Minimise x'Hx / 2 - c'x within bounds.

    Solve without bounds, clamp all unknowns beyond a bound, release all with a multiplier of the wrong sign,
    and repeat until none remains. This takes a few solutions. If the exchange cycles, bounds are released one at a time.

    Parameters
    ----------
    H : (k, k) Symmetric, positive definite. If it is singular, c must lie in its range, as in least squares.
    c : (k,)
    low, high : (k,) May be infinite. An unknown with low == high is fixed.
    start : Optimum of a similar problem with the same bounds. Its active bounds are tried first.

    Returns
    -------
    BoundedOptimum with x (k,) and is_free (k,).
    """
    can_move = low < high
    x = np.where(can_move, 0.0 if start is None else start.x, high)
    free = can_move.copy() if start is None else can_move & start.is_free
    if _exchange_blocks(H, c, x, free, low, high, can_move):
        return BoundedOptimum(x=x, is_free=free)
    return _by_single_bounds(H, c, low, high)


class BorderedProblem:
    """A bounded problem that is solved once, and then with a few additional unknowns without bounds.

    If these do not change the active bounds, the existing factor gives the solution (Schur complement of the
    border). Otherwise the problem is solved again, starting from the active bounds.

    Parameters
    ----------
    H, c, low, high : As in `solve_bounded`.
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
        """Return the optimum (x, z) of all unknowns, the additional ones z last.

            minimise  x'Hx / 2 + x' across z + z' corner z / 2 - c'x - d'z

        Parameters
        ----------
        across : (n, k) Products of the n own unknowns with the k additional ones.
        corner : (k, k) Products of the additional ones with each other.
        d : (k,) Continues c.
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
        """Return whether x lies within the bounds and no active bound should be released."""
        if (x < self.low).any() or (x > self.high).any():
            return False
        held = ~self.optimum.is_free & (self.low < self.high)
        return not (_gains_of_release(self.H, c, x, self.low, held) > 0.0).any()


def _exchange_blocks(
    H: Floats, c: Floats, x: Floats, free: Bools, low: Floats, high: Floats, can_move: Bools
) -> bool:
    """Exchange all wrong bounds, repeatedly; x and free change in place.

    Returns whether this reached the optimum.
    """
    fewest, patience = len(c) + 1, PATIENCE
    while True:
        if free.any():
            x[free] = _solve(H, c, x, free)
        beyond = free & ((x < low) | (x > high))
        released = _gains_of_release(H, c, x, low, can_move & ~free) > 0.0
        n_wrong = int(beyond.sum() + released.sum())
        if n_wrong == 0:
            return True
        if n_wrong < fewest:
            fewest, patience = n_wrong, PATIENCE
        elif patience == 0:
            return False
        else:
            patience -= 1
        x[beyond] = np.clip(x[beyond], low[beyond], high[beyond])
        free &= ~beyond
        free |= released


def _solve(H: Floats, c: Floats, x: Floats, free: Bools) -> Floats:
    """Return the optimum of the free unknowns; the others keep their values in x."""
    some, rest = np.flatnonzero(free), np.flatnonzero(~free)
    rows = H[some]
    left, right = rows[:, some], c[some] - rows[:, rest] @ x[rest]
    _, solution, failed = dposv(left, right, lower=1)
    if failed == 0:
        if not np.isfinite(solution).all():
            raise ValueError("the normal equations contain values that are not finite")
        return np.asarray(solution, dtype=np.float64)
    return np.asarray(np.linalg.lstsq(left, right, rcond=None)[0], dtype=np.float64)


def _by_single_bounds(H: Floats, c: Floats, low: Floats, high: Floats) -> BoundedOptimum:
    """Return the optimum by bounded-variable least squares, |A u - y|² / 2 with A'A = H, A'y = c and unknowns of one scale."""
    moving = np.flatnonzero(low < high)
    x, free = np.where(low < high, 0.0, high), low < high
    scale = 1 / np.sqrt(np.maximum(np.diag(H)[moving], 1e-300))
    values, vectors = np.linalg.eigh(H[np.ix_(moving, moving)] * np.outer(scale, scale))
    kept = values > ROUND_OFF * values.max(initial=0.0)
    root, axes = np.sqrt(values[kept]), vectors[:, kept].T
    y = axes @ (scale * (c - H @ x)[moving]) / root
    bounds = low[moving] / scale, high[moving] / scale
    found = lsq_linear(root[:, None] * axes, y, bounds, method="bvls", tol=1e-14, max_iter=20 * len(moving))
    side, free[moving] = found.active_mask, found.active_mask == 0
    x[moving] = np.select([side < 0, side > 0], [low[moving], high[moving]], scale * found.x)
    if free.any():
        x[free] = np.clip(_solve(H, c, x, free), low[free], high[free])  # without the round-off of the roots
    return BoundedOptimum(x=x, is_free=free)


def _gains_of_release(H: Floats, c: Floats, x: Floats, low: Floats, held: Bools) -> Floats:
    """Return the first-order gain (k,) of releasing each unknown at a bound; 0 where it would leave the box."""
    if not held.any():
        return np.zeros(len(c))
    slope = c - H @ x  # minus the gradient; the multiplier of an active bound
    inward = np.where(x == low, slope, -slope)
    noise = ROUND_OFF * (np.abs(c) + np.abs(H) @ np.abs(x))
    return np.where(held & (inward > noise), inward**2 / np.maximum(np.diag(H), 1e-300), 0.0)
