"""Forward selection by error reduction ratio, for all outputs at once, on moments alone.

Orthogonal least squares (Billings 2013, ch. 3) is a pivoted Cholesky factorisation of Φ'Φ, with the pivot that
explains most of y: row k of the factor is what the k-th chosen term shares with every candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.moments import Moments
from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.terms import Floats, Terms

TIE = 1e-9
"""Relative difference of gains below which the canonical order of the terms decides."""
DEPENDENT = 1e-12
"""Remaining share of a candidate's squared norm below which it depends on the chosen terms."""
Criterion = Literal["bic", "n_terms", "err_tol"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Selection:
    """The chosen terms of every output, in order of choice."""

    terms: Terms
    scale: Scale
    order: NDArray[np.intp]
    """(n_outputs, n_max) index of the term chosen at each step; -1 where there is none."""
    n_terms: NDArray[np.intp]
    """(n_outputs,) terms kept."""
    err: Floats
    """(n_outputs, n_max) error reduction ratio of each step."""
    theta: Floats
    """(n_outputs, len(terms)) coefficients of the scaled terms; 0 where not chosen."""
    inverse: Floats
    """(n_outputs, n_max, n_max) upper triangular T with T T' = (Φ'Φ)⁻¹ of the chosen terms; 0 beyond them."""
    rss: Floats
    """(n_outputs,) residual sum of squares."""
    count: NDArray[np.int64]
    """(n_outputs,) rows it rests on."""
    rcond: Floats
    """(n_outputs,) least over largest pivot of the scaled factor: below 1e-7, doubt the coefficients."""
    stop: tuple[str, ...]
    """(n_outputs,) why the selection ended: `bic`, `n_terms`, `err_tol` or `exhausted`."""

    @property
    def sigma(self) -> Floats:
        """(n_outputs,) standard deviation of the residual, corrected for the terms kept; nan if none is left."""
        free = self.count - self.n_terms
        return np.sqrt(np.where(free > 0, self.rss / np.maximum(free, 1), np.nan))

    def chosen(self, output: int) -> NDArray[np.intp]:
        """Return the indices of one output's terms in order of choice."""
        return self.order[output, : self.n_terms[output]]

    def covariance(self, output: int) -> Floats:
        """Return the covariance (n_terms, n_terms) of one output's coefficients (scaled terms)."""
        k = int(self.n_terms[output])
        factor = self.inverse[output, :k, :k]
        return np.asarray(self.sigma[output] ** 2 * (factor @ factor.T), dtype=np.float64)


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


def select(
    moments: Moments,
    n_terms: int | None = None,
    *,
    criterion: Criterion | None = None,
    err_tol: float = 1e-4,
    keep: Sequence[str] = (),
    refine: bool = True,
) -> Selection:
    """Select terms for every output by forward selection with ERR.

    Parameters
    ----------
    n_terms : terms to keep (criterion `n_terms`), else the most to look at
    criterion : `n_terms`; `bic` (least Bayesian information over the whole path, the default without n_terms);
        `err_tol` (stop once 1 - sum of ERR is below `err_tol`)
    keep : names of terms chosen first, such as `1` so that ERR counts what is explained beyond the mean
    refine : one step of iterative refinement of the coefficients
    """
    criterion = criterion or ("bic" if n_terms is None else "n_terms")
    if criterion not in get_args(Criterion):
        raise ValueError(f"criterion is {criterion!r}, expected one of {', '.join(get_args(Criterion))}")
    if criterion == "n_terms" and n_terms is None:
        raise ValueError("criterion 'n_terms' needs n_terms")
    if n_terms is not None and n_terms < max(1, len(keep)):
        raise ValueError(f"n_terms is {n_terms}, expected at least {max(1, len(keep))}")
    if not moments.count.all():
        empty = int(np.flatnonzero(moments.count == 0)[0])
        raise IdentError(f"output {empty} has no known value; leave it out or give more data")
    if absent := set(keep) - set(moments.terms.names):
        raise IdentError(f"no term {', '.join(sorted(absent))} to keep among {len(moments.terms)} terms")
    q, m = moments.n_outputs, len(moments.terms)
    n_max = min(m if n_terms is None else n_terms, m, int(moments.count.max()))
    first = [moments.terms.names.index(name) for name in keep]
    order = np.full((q, n_max), -1, dtype=np.intp)
    kept = np.zeros(q, dtype=np.intp)
    err, theta, inverse = np.zeros((q, n_max)), np.zeros((q, m)), np.zeros((q, n_max, n_max))
    rss, rcond, stop = np.zeros(q), np.zeros(q), np.full(q, "", dtype=object)
    for outputs, grams in moments.groups():
        cross, power = moments.cross[:, outputs], moments.power[outputs]
        path = forward(grams, cross, power, n_max, moments.terms.canonical_order, first)
        size, why = _cut(path, power, moments.count[outputs], criterion, n_terms, err_tol, len(first))
        used = np.arange(n_max) < size[:, None]  # (n, n_max)
        eye = np.eye(n_max)
        factor = np.where(used[:, :, None] & used[:, None, :], path.factor, eye)
        T = invert_upper(factor)
        z = np.where(used, path.gain, 0.0)
        order[outputs] = np.where(used, path.order, -1)
        kept[outputs], stop[outputs] = size, why
        err[outputs] = z**2 / np.where(power > 0, power, 1.0)[:, None]
        inverse[outputs] = T * (used[:, :, None] & used[:, None, :])
        theta[outputs] = _coefficients(order[outputs], T, z, grams, cross, refine)
        rss[outputs] = np.maximum(power - (z**2).sum(axis=1), 0.0)
        pivots = np.abs(np.diagonal(factor, axis1=1, axis2=2)) / _column_norms(factor)
        rcond[outputs] = np.where(used, pivots, 1.0).min(axis=1)
    return Selection(
        terms=moments.terms,
        scale=moments.scale or UNSCALED,
        order=order,
        n_terms=kept,
        err=err,
        theta=theta,
        inverse=inverse,
        rss=rss,
        count=moments.count.copy(),
        rcond=rcond,
        stop=tuple(stop.tolist()),
    )


def _column_norms(factor: Floats) -> Floats:
    return np.asarray(np.sqrt((factor**2).sum(axis=1)), dtype=np.float64)


def _coefficients(
    order: NDArray[np.intp], T: Floats, z: Floats, grams: Floats, cross: Floats, refine: bool
) -> Floats:
    """Solve R θ = z, then refine once with the residual of the normal equations."""
    n, m = len(order), cross.shape[0]
    rows, used = np.arange(n)[:, None], order >= 0
    columns = np.maximum(order, 0)
    short = np.where(used, np.matmul(T, z[:, :, None])[:, :, 0], 0.0)
    theta = np.zeros((n, m))
    np.add.at(theta, (rows, columns), short)
    if refine:
        product = theta @ grams[0] if len(grams) == 1 else np.matmul(grams, theta[:, :, None])[:, :, 0]
        miss = np.where(used, np.take_along_axis(cross.T - product, columns, axis=1), 0.0)
        step = np.matmul(T, np.matmul(T.transpose(0, 2, 1), miss[:, :, None]))[:, :, 0]
        np.add.at(theta, (rows, columns), np.where(used, step, 0.0))
    return theta


def _cut(
    path: Path,
    power: Floats,
    count: NDArray[np.int64],
    criterion: str,
    n_terms: int | None,
    err_tol: float,
    at_least: int,
) -> tuple[NDArray[np.intp], list[str]]:
    """Return how many steps of each path to keep, and why it ends there."""
    n_max = path.order.shape[1]
    steps = (path.order >= 0).sum(axis=1)  # (n,)
    safe = np.where(power > 0, power, 1.0)[:, None]
    rest = 1.0 - np.cumsum(path.gain**2, axis=1) / safe  # (n, n_max) unexplained share
    k = np.arange(1, n_max + 1)
    exists = k <= steps[:, None]
    if criterion == "n_terms":
        size, why = steps, "n_terms"
        reached = steps == min(n_terms or n_max, n_max)
    elif criterion == "err_tol":
        below = (rest < err_tol) & exists
        reached = below.any(axis=1)
        size, why = np.where(reached, below.argmax(axis=1) + 1, steps), "err_tol"
    else:
        N = count[:, None].astype(np.float64)
        floor = 64 * n_max * np.finfo(np.float64).eps  # below this the residual is rounding
        bic = N * np.log(np.maximum(rest, floor)) + k * np.log(N)
        size, why = np.where(exists, bic, np.inf).argmin(axis=1) + 1, "bic"
        reached = size < steps
    size = np.maximum(np.minimum(size, steps), np.minimum(at_least, steps))
    return size.astype(np.intp), [why if hit else "exhausted" for hit in reached]
