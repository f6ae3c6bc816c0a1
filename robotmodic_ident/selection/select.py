"""Selection of terms by error reduction ratio, for all outputs at once, on moments alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.moments import Moments
from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.selection.criteria import Criterion, Stop
from robotmodic_ident.selection.forward import invert_upper
from robotmodic_ident.selection.model_size import Search, SizeSearch, cross_validated
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

MAX_SEARCHED_SIZE = 50
"""Largest model that exchange and restart look at unless n_terms says otherwise."""


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
    stop: tuple[Stop, ...]
    """(n_outputs,) why the selection ended: the criterion, or `exhausted` where no term was left before it."""

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


def select(
    moments: Moments,
    n_terms: int | None = None,
    *,
    criterion: Criterion | None = None,
    err_tol: float = 1e-4,
    keep: Sequence[str] = (),
    refine: bool = True,
    search: Search = "forward",
    folds: Sequence[Moments] = (),
) -> Selection:
    """Select terms for every output by what they explain.

    Parameters
    ----------
    n_terms : terms to keep (criterion `n_terms`), else the most to look at
    criterion : `n_terms`; `aic`, `bic` (the default without n_terms) or `ebic` (least information criterion over
        all sizes, half as many terms as rows at most); `cv` (least error on folds); `err_tol` (stop once
        1 - sum of ERR is below `err_tol`)
    keep : names of terms chosen first, such as `1` so that ERR counts what is explained beyond the mean
    refine : one step of iterative refinement of the coefficients
    search : `forward` (greedy, by ERR); `restart` (greedy again from each term of the best model: iOFR);
        `exchange` (terms are exchanged while that helps, at every size)
    folds : moments of parts of the data of `moments`, left out one at a time for criterion `cv`

    Raises
    ------
    ValueError
        if criterion, search, folds and n_terms do not fit together
    IdentError
        if an output has no known value, or a term to keep is not there
    """
    criterion = criterion or ("bic" if n_terms is None else "n_terms")
    _check(moments, n_terms, criterion, keep, search, folds)
    q, m = moments.n_outputs, len(moments.terms)
    n_max = min(m if n_terms is None else n_terms, m, int(moments.count.max()))
    if search != "forward" and n_terms is None:
        n_max = min(n_max, max(MAX_SEARCHED_SIZE, len(keep)))
    size_search = SizeSearch(moments.terms, n_max, criterion, n_terms, err_tol, tuple(keep), search)
    sizes = cross_validated(size_search, moments, folds) if criterion == "cv" else None
    order = np.full((q, n_max), -1, dtype=np.intp)
    kept = np.zeros(q, dtype=np.intp)
    err, theta, inverse = np.zeros((q, n_max)), np.zeros((q, m)), np.zeros((q, n_max, n_max))
    rss, rcond, stop = np.zeros(q), np.zeros(q), np.full(q, "", dtype=object)
    for outputs, grams in moments.groups():
        cross, power = moments.cross[:, outputs], moments.power[outputs]
        path, size, why = size_search.path(
            grams, cross, power, moments.count[outputs], None if sizes is None else sizes[outputs]
        )
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


def _check(
    moments: Moments,
    n_terms: int | None,
    criterion: str,
    keep: Sequence[str],
    search: str,
    folds: Sequence[Moments],
) -> None:
    for word, value, known in (
        ("criterion", criterion, get_args(Criterion)),
        ("search", search, get_args(Search)),
    ):
        if value not in known:
            raise ValueError(f"{word} is {value!r}, expected one of {', '.join(known)}")
    if criterion == "n_terms" and n_terms is None:
        raise ValueError("criterion 'n_terms' needs n_terms")
    if (criterion == "cv") != (len(folds) > 0):
        raise ValueError("criterion 'cv' needs folds, at least 2 of them, and no other criterion takes them")
    if len(folds) == 1:
        raise ValueError("one fold leaves nothing to fit on; give at least 2")
    if n_terms is not None and n_terms < max(1, len(keep)):
        raise ValueError(f"n_terms is {n_terms}, expected at least {max(1, len(keep))}")
    if not moments.count.all():
        empty = int(np.flatnonzero(moments.count == 0)[0])
        raise IdentError(f"output {empty} has no known value; leave it out or give more data")
    if absent := set(keep) - set(moments.terms.names):
        raise IdentError(f"no term {', '.join(sorted(absent))} to keep among {len(moments.terms)} terms")


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
