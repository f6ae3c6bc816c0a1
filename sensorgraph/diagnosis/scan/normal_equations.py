"""The normal equations of a fit, and their optimum under the tolerances of the nuisances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.bounded_least_squares import solve_bounded
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
    gain: Floats
    """(n_scans, 3, k) H_s^-1 C_s"""
    start: Floats
    """(n_scans, 3) H_s^-1 b_s"""
    logdet: float
    """Sum over scans of log |I + P_s B'WB|."""


def boxed(matrix: Floats, right: Floats, tau: Floats, box: Floats, locked: Bools) -> tuple[Floats, Floats]:
    """Maximise right'x - x'Mx/2 - |g/tau|²/2 with |g| <= box; return g and the other unknowns, which are free.

    Parameters
    ----------
    matrix, right : (k, k), (k,) normal equations; the first n unknowns are the nuisances g
    tau, box : (n,) prior standard deviations and bounds
    locked : (n,) nuisances that stay 0
    """
    limit = limits(len(right), box, locked)
    x = solve_bounded(with_prior(matrix, tau), right, -limit, limit).x
    return x[: len(tau)], x[len(tau) :]


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
