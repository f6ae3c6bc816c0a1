"""Forward orthogonal least squares on moments: a pivoted Cholesky factorisation Φ'Φ = R'R, for many outputs at once.

With columns φ of unit norm, left = 1 and b = Φ'y at first, step k is (Billings 2013, ch. 3):

1. Select the candidate c with the largest gain `b_c² / left_c`.
2. Row of the factor: `R_kj = (φ_c'φ_j - Σ_{s<k} R_sc R_sj) / sqrt(left_c)`, and gain `z_k = b_c / sqrt(left_c)`.
3. Update: `b_j = b_j - z_k R_kj`, and `left_j = left_j - R_kj²`.

The projection of the residual of y on candidate j is b_j. The squared norm of the part of candidate j that is
orthogonal to the selected terms is left_j. The error reduction ratio is `ERR_k = z_k² / y'y`, and theta solves `R theta = z`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.kernel import inner_kernel, kernel
from robotmodic_ident.types import Floats

TIE_TOLERANCE = 1e-9
"""Relative difference of gains below which the canonical order of the terms decides."""
DEPENDENCE_TOLERANCE = 1e-12
"""Remaining share of the squared norm of a candidate below which it depends on the selected terms."""
EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionPath:
    """All steps of a selection, before a stop rule is applied."""

    order: NDArray[np.intp]
    """(n, n_max) index of the selected term; -1 if no candidate remains."""
    factor: Floats
    """(n, n_max, n_max) upper triangular R with R'R = Φ'Φ of the selected terms; unit diagonal where unused."""
    gain: Floats
    """(n, n_max) coordinate z of y along each orthonormal direction; z² is the explained sum of squares of a step."""


def forward(
    grams: Floats,
    cross: Floats,
    power: Floats,
    n_max: int,
    order: NDArray[np.intp],
    keep: Sequence[int] = (),
    own: NDArray[np.intp] | None = None,
    allowed: NDArray[np.bool_] | None = None,
) -> SelectionPath:
    """Select up to `n_max` terms for each output by their error reduction ratio.

    Parameters
    ----------
    grams : (n_grams, m, m) Φ'Φ
    cross : (m, n) Φ'Y
    power : (n,) Y'Y
    order : (m,) canonical order, which resolves ties
    keep : terms selected first, in this order, regardless of their gain
    own : (n,) index of the Gram matrix of each output; None: one for each, or one for all
    allowed : (n, m) terms that each output may use; None: all
    """
    m, n = cross.shape
    if own is None:
        own = np.arange(n) if len(grams) == n else np.zeros(n, dtype=np.intp)
    chosen = np.full((n, n_max), -1, dtype=np.intp)
    factor, gain = np.zeros((n, n_max, n_max)), np.zeros((n, n_max))
    _choose(
        grams,
        np.ascontiguousarray(cross),  # one memory layout needs only one compiled version
        np.ascontiguousarray(power),
        np.asarray(own, dtype=np.intp),
        np.asarray(order, dtype=np.intp),
        np.array(keep, dtype=np.intp),
        np.ones((n, m), dtype=np.bool_) if allowed is None else allowed,
        chosen,
        factor,
        gain,
    )
    return SelectionPath(order=chosen, factor=factor, gain=gain)


@kernel
def _choose(
    grams: Floats,
    cross: Floats,
    power: Floats,
    own: NDArray[np.intp],
    order: NDArray[np.intp],
    keep: NDArray[np.intp],
    allowed: NDArray[np.bool_],
    chosen: NDArray[np.intp],
    factor: Floats,
    gain: Floats,
) -> None:
    """Fill chosen (n, n_max), factor R (n, n_max, n_max) and gain z (n, n_max), one output after the other.

    The equations are those of the module. Candidates have unit norm and canonical order; the first of equals is used.
    """
    m, n_max = len(order), gain.shape[1]
    norm, left, b, basis = np.empty(m), np.empty(m), np.empty(m), np.empty((n_max, m))
    for i in range(len(power)):
        gram = grams[own[i]]
        for j in range(m):
            p = order[j]
            square = gram[p, p]
            norm[j] = math.sqrt(square) if square > 0.0 else 1.0
            left[j] = 1.0 if square > 0.0 and allowed[i, p] else 0.0  # remaining squared norm
            b[j] = cross[p, i] / norm[j]  # projection of the residual of the output
        for k in range(n_max):
            if k < len(keep):
                c = 0
                while order[c] != keep[k]:
                    c += 1
                c = c if left[c] > DEPENDENCE_TOLERANCE else -1
            else:
                c = _best(b, left, 4.0 * EPSILON * power[i])
            if c < 0:
                factor[i, k, k] = 1.0
                for j in range(m):
                    basis[k, j] = 0.0
                continue
            root = math.sqrt(left[c])
            for j in range(m):
                basis[k, j] = gram[order[c], order[j]] / (norm[j] * norm[c])
            _orthogonalise(basis, k, c)
            z = b[c] / root
            for j in range(m):
                basis[k, j] /= root
                b[j] -= z * basis[k, j]
                left[j] -= basis[k, j] * basis[k, j]
            left[c] = 0.0
            for step in range(k):
                factor[i, step, k] = basis[step, c] * norm[c]
            factor[i, k, k] = root * norm[c]
            chosen[i, k], gain[i, k] = order[c], z


@inner_kernel
def _orthogonalise(basis: Floats, k: int, c: int) -> None:
    """Subtract Σ_{s<k} R_sc R_sj from row k, for the selected candidate c."""
    for step in range(k):
        share = basis[step, c]
        for j in range(basis.shape[1]):
            basis[k, j] -= share * basis[step, j]


@inner_kernel
def _best(b: Floats, left: Floats, floor: float) -> int:
    """Return the first candidate with the largest gain b² / left, up to rounding; -1 if all are dependent."""
    best = -1.0
    for j in range(len(b)):
        if left[j] > DEPENDENCE_TOLERANCE:
            best = max(best, b[j] * b[j] / left[j])
    for j in range(len(b)):
        if left[j] > DEPENDENCE_TOLERANCE and b[j] * b[j] / left[j] >= best - TIE_TOLERANCE * best - floor:
            return j
    return -1


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
