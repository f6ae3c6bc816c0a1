"""Forward selection as a pivoted Cholesky factorisation of Φ'Φ, for many outputs at once.

Orthogonal least squares (Billings 2013, ch. 3) on moments: the pivot is the term that explains most of y, and row k
of the factor is what the k-th chosen term shares with every candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.terms import Floats

TIE = 1e-9
"""Relative difference of gains below which the canonical order of the terms decides."""
DEPENDENT = 1e-12
"""Remaining share of a candidate's squared norm below which it depends on the chosen terms."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Every step of a selection, before a stop rule cuts it."""

    order: NDArray[np.intp]
    """(n, n_max) chosen term; -1 once no candidate is left."""
    factor: Floats
    """(n, n_max, n_max) upper triangular R with R'R = Φ'Φ of the chosen terms (unit diagonal where unused)."""
    gain: Floats
    """(n, n_max) coordinate z of y along each orthonormal direction: z² is what a step explains."""


def forward(
    grams: Floats,
    cross: Floats,
    power: Floats,
    n_max: int,
    order: NDArray[np.intp],
    keep: Sequence[int] = (),
    own: NDArray[np.intp] | None = None,
    allowed: NDArray[np.bool_] | None = None,
) -> Path:
    """Choose up to `n_max` terms for each output by what they explain.

    Parameters
    ----------
    grams : (n_grams, m, m)
    cross : (m, n)
    power : (n,)
    order : (m,) canonical order, which decides ties
    keep : terms chosen first, in this order, whatever they explain
    own : (n,) which Gram is whose; None: one for each, or one for all
    allowed : (n, m) terms that each output may choose; None: all
    """
    n, m = cross.shape[1], cross.shape[0]
    rows = np.arange(n)
    if own is None:
        own = rows if len(grams) == n else np.zeros(n, dtype=np.intp)
    squares = np.maximum(np.diagonal(grams, axis1=1, axis2=2), 0.0)[own]  # (n, m)
    norms = np.sqrt(np.where(squares > 0, squares, 1.0))
    canonical = order
    rank = np.empty(m, dtype=np.intp)
    rank[canonical] = np.arange(m)
    b = (cross.T / norms)[:, canonical]  # (n, m) what is left of φ'y
    left = (squares / norms**2)[:, canonical]  # (n, m) remaining squared norms
    if allowed is not None:
        left = np.where(allowed[:, canonical], left, 0.0)
    scale = norms[:, canonical]
    basis = np.zeros((n, n_max, m))
    chosen = np.full((n, n_max), -1, dtype=np.intp)
    gain = np.zeros((n, n_max))
    floor = 4 * np.finfo(np.float64).eps * power
    for k in range(n_max):
        free = left > DEPENDENT
        value = np.where(free, b * b / np.where(free, left, 1.0), -1.0)  # (n, m) explained by each candidate
        if k < len(keep):
            pivot = np.full(n, rank[keep[k]], dtype=np.intp)
            alive = free[rows, pivot]
        else:
            best = value.max(axis=1)
            pivot = np.argmax(value >= (best - TIE * np.abs(best) - floor)[:, None], axis=1)
            alive = best >= 0
        if not alive.any() and k >= len(keep):
            break
        p = canonical[pivot]
        root = np.sqrt(np.where(alive, left[rows, pivot], 1.0))
        row = grams[own, p][:, canonical] / (scale * scale[rows, pivot][:, None])  # (n, m)
        if k:
            row -= np.matmul(basis[rows, :k, pivot][:, None, :], basis[:, :k])[:, 0]
        row /= root[:, None]
        row[~alive] = 0.0
        z = np.where(alive, b[rows, pivot] / root, 0.0)
        basis[:, k] = row
        b -= row * z[:, None]
        left -= row * row
        left[rows[alive], pivot[alive]] = 0.0
        chosen[alive, k] = p[alive]
        gain[:, k] = z
    return _as_path(chosen, gain, basis, rank, norms)


def _as_path(
    chosen: NDArray[np.intp], gain: Floats, basis: Floats, rank: NDArray[np.intp], norms: Floats
) -> Path:
    """Read R off the basis rows, in the user's column norms, with steps without a choice as unit rows."""
    n_max = chosen.shape[1]
    used = chosen >= 0
    columns = np.where(used, rank[np.maximum(chosen, 0)], 0)
    factor = np.take_along_axis(basis, columns[:, None, :], axis=2)  # (n, step, chosen)
    size = np.take_along_axis(norms, np.maximum(chosen, 0), axis=1)
    factor = np.triu(factor) * np.where(used, size, 0.0)[:, None, :]
    diagonal = np.arange(n_max)
    factor[:, diagonal, diagonal] = np.where(used, factor[:, diagonal, diagonal], 1.0)
    return Path(order=chosen, factor=factor, gain=gain)


def invert_upper(factor: Floats) -> Floats:
    """Invert a stack (n, k, k) of upper triangular matrices by back substitution."""
    k = factor.shape[1]
    inverse = np.zeros_like(factor)
    for i in range(k - 1, -1, -1):
        inverse[:, i, i] = 1.0 / factor[:, i, i]
        if i + 1 < k:
            tail = np.matmul(factor[:, i, None, i + 1 :], inverse[:, i + 1 :, i + 1 :])[:, 0]
            inverse[:, i, i + 1 :] = -tail * inverse[:, i, i][:, None]
    return inverse
