"""Normal equations of a fit, and their optimum under the tolerances of the nuisances.

The unknowns are x = (g, p), the nuisances and effect parameters, and the pose error delta_s of each scan s.

    [ G    C_sᵀ ] [ x       ]   [ r   ]
    [ C_s  H_s  ] [ delta_s ] = [ b_s ].

Eliminating every delta_s by the Schur complement gives M x = right.

    M = G - Σ C_sᵀ H_s⁻¹ C_s,    right = r - Σ C_sᵀ H_s⁻¹ b_s,    delta_s = H_s⁻¹ (b_s - C_s x).

Triggs, McLauchlan, Hartley and Fitzgibbon 2000, bundle adjustment, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.bounded_least_squares import BoundedOptimum, solve_bounded
from sensorgraph.types import Bools, Floats


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


def without_poses(g: Floats, r: Floats, h: Floats, c: Floats, b: Floats, prior: Floats) -> System:
    """Eliminate the pose errors of all scans by the Schur complement of their 3 x 3 blocks.

        M = g - Σ cᵀ h⁻¹ c,    right = r - Σ cᵀ h⁻¹ b.

    Parameters
    ----------
    g, r : (k, k), (k,) Normal equations at fixed poses.
    h, c, b : (n_scans, 3, 3), (n_scans, 3, k), (n_scans, 3) Blocks of the poses with their prior, their coupling to the
        other unknowns, and their right-hand side.
    prior : (n_scans, 3, 3) Prior covariance of the pose errors.
    """
    lower = np.linalg.cholesky(h)
    inverse = np.linalg.inv(lower)
    whitened = np.matmul(inverse, c).reshape(3 * len(h), -1)
    residual = np.matmul(inverse, b[..., None])
    _, of_prior = np.linalg.slogdet(prior)
    of_poses = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum()
    return System(
        matrix=g - whitened.T @ whitened,
        right=r - whitened.T @ residual.reshape(-1),
        poses=h,
        across=c,
        start=np.matmul(inverse.transpose(0, 2, 1), residual)[..., 0],
        logdet=float(of_prior.sum() + of_poses),
    )


def boxed(matrix: Floats, right: Floats, tau: Floats, box: Floats, locked: Bools) -> tuple[Floats, Floats]:
    """Maximise rightᵀx - ½ xᵀMx - ½ |g/tau|² subject to |g| <= box; return g and the other, unbounded unknowns.

    Parameters
    ----------
    matrix, right : (k, k), (k,) Normal equations M x = right; the first n unknowns are the nuisances g.
    tau, box : (n,) Prior standard deviations and bounds.
    locked : (n,) Nuisances that are held at 0.
    """
    x = boxed_optimum(matrix, right, tau, box, locked).x
    return x[: len(tau)], x[len(tau) :]


def boxed_optimum(
    matrix: Floats, right: Floats, tau: Floats, box: Floats, locked: Bools, like: BoundedOptimum | None = None
) -> BoundedOptimum:
    """Return the optimum of `boxed` with its active bounds; those of a similar problem `like` are tried first."""
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
