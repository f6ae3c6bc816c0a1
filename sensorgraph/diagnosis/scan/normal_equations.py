"""The normal equations of a fit, and their optimum under the tolerances of the nuisances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.bounded_least_squares import BoundedOptimum, solve_bounded
from sensorgraph.types import Bools, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """The normal equations with the poses eliminated: unknowns are nuisances, corners, effects."""

    matrix: Floats
    """(k, k)"""
    right: Floats
    """(k,)"""
    poses: Floats
    """(n_scans, 3, 3) H_s"""
    across: Floats
    """(n_scans, 3, k) C_s"""
    start: Floats
    """(n_scans, 3) H_s^-1 b_s"""
    logdet: float
    """Sum over scans of log |I + P_s B'WB|."""

    def poses_at(self, x: Floats) -> Floats:
        """Return the pose errors (n_scans, 3) that are likeliest beside x (k,)."""
        return np.asarray(self.start - np.linalg.solve(self.poses, (self.across @ x)[..., None])[..., 0])


def without_poses(g: Floats, r: Floats, h: Floats, c: Floats, b: Floats, prior: Floats) -> System:
    """Eliminate the poses of scans: the Schur complement of their 3 x 3 blocks.

    Parameters
    ----------
    g, r : (k, k), (k,) normal equations at fixed poses
    h, c, b : (n_scans, 3, 3), (n_scans, 3, k), (n_scans, 3) blocks of the poses with their prior, beside g and r
    prior : (n_scans, 3, 3) covariance of the poses
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
    """Maximise right'x - x'Mx/2 - |g/tau|²/2 with |g| <= box; return g and the other unknowns, which are free.

    Parameters
    ----------
    matrix, right : (k, k), (k,) normal equations; the first n unknowns are the nuisances g
    tau, box : (n,) prior standard deviations and bounds
    locked : (n,) nuisances that stay 0
    """
    x = boxed_optimum(matrix, right, tau, box, locked).x
    return x[: len(tau)], x[len(tau) :]


def boxed_optimum(
    matrix: Floats, right: Floats, tau: Floats, box: Floats, locked: Bools, like: BoundedOptimum | None = None
) -> BoundedOptimum:
    """Return what `boxed` does, and which unknowns are at a bound; those of a similar problem are tried first."""
    limit = limits(len(right), box, locked)
    if like is not None:
        like = replace(like, x=np.where(like.is_free, 0.0, np.sign(like.x) * np.minimum(limit, 1e300)))
    return solve_bounded(with_prior(matrix, tau), right, -limit, limit, like)


def with_prior(matrix: Floats, tau: Floats) -> Floats:
    """Return normal equations (k, k) with the prior of the nuisances, their first n unknowns; tau (n,)."""
    n, k = len(tau), len(matrix)
    a = matrix.copy()
    a[np.arange(n), np.arange(n)] += 1 / tau**2
    a[np.arange(n, k), np.arange(n, k)] += 1e-9 + 1e-9 * np.diag(a)[n:]
    return a


def limits(k: int, box: Floats, locked: Bools) -> Floats:
    """Return how large each of k unknowns may become: those of box (n,), locked ones 0, the others without end."""
    return np.concatenate([np.where(locked, 0.0, box), np.full(k - len(box), np.inf)])
