"""Select terms by error reduction ratio, for all outputs at once, from moments only.

For the selected terms, Φ'Φ = R'R, R theta = z and ERR_k = z_k² / y'y (Billings 2013, ch. 3; see `forward`).
"""

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
"""Maximum model size for exchange and restart if n_terms is not given."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Selection:
    """The selected terms of every output, in order of selection."""

    terms: Terms
    scale: Scale
    order: NDArray[np.intp]
    """(n_outputs, n_max) index of the term selected at each step; -1 for no term."""
    n_terms: NDArray[np.intp]
    """(n_outputs,) number of terms kept."""
    err: Floats
    """(n_outputs, n_max) error reduction ratio of each step."""
    theta: Floats
    """(n_outputs, len(terms)) coefficients of the scaled terms; 0 if not selected."""
    inverse: Floats
    """(n_outputs, n_max, n_max) upper triangular T = R⁻¹ with T T' = (Φ'Φ)⁻¹ of the selected terms; 0 beyond them."""
    rss: Floats
    """(n_outputs,) residual sum of squares."""
    count: NDArray[np.int64]
    """(n_outputs,) number of rows."""
    stop: tuple[Stop, ...]
    """(n_outputs,) reason for the end: the criterion, or `exhausted` if no candidate term remained."""

    @property
    def sigma(self) -> Floats:
        """(n_outputs,) standard deviation of the residual, corrected for the terms; nan without degrees of freedom."""
        free = self.count - self.n_terms
        return np.sqrt(np.where(free > 0, self.rss / np.maximum(free, 1), np.nan))

    def chosen(self, output: int) -> NDArray[np.intp]:
        """Return the indices of the terms of one output, in order of selection."""
        return self.order[output, : self.n_terms[output]]

    def covariance(self, output: int) -> Floats:
        """Return the covariance sigma² T T' (n_terms, n_terms) of the coefficients of one output (scaled terms)."""
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
    search: Search = "forward",
    folds: Sequence[Moments] = (),
) -> Selection:
    """Select terms for every output by their error reduction ratio.

    Parameters
    ----------
    n_terms : Number of terms to keep (criterion `n_terms`), otherwise the maximum number.
    criterion : `aic`, `bic` (default without n_terms) or `ebic` minimise an information criterion over all sizes, with
        at most half as many terms as rows. `n_terms` keeps that number. `cv` minimises the error on held-out folds.
        `err_tol` stops when 1 - Σ ERR is below `err_tol`.
    keep : Names of terms selected first; with `1`, ERR counts the explained share beyond the mean.
    search : `forward` (greedy, by ERR), `restart` (greedy again from each term of the best model: iOFR), or
        `exchange` (exchange terms while this helps, at every size).
    folds : Moments of parts of the data, held out one at a time for criterion `cv`.

    Raises
    ------
    ValueError
        If criterion, search, folds and n_terms are inconsistent.
    IdentError
        If an output has no known value, or a term to keep is missing.
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
    rss, stop = np.zeros(q), np.full(q, "", dtype=object)
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
        theta[outputs] = _coefficients(order[outputs], T, z, grams, cross)
        rss[outputs] = np.maximum(power - (z**2).sum(axis=1), 0.0)
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
        raise ValueError("criterion 'n_terms' needs a value for n_terms")
    if (criterion == "cv") != (len(folds) > 0):
        raise ValueError("criterion 'cv' needs folds, at least 2 of them; other criteria use no folds")
    if len(folds) == 1:
        raise ValueError("one fold leaves no data for the fit; give at least 2")
    if n_terms is not None and n_terms < max(1, len(keep)):
        raise ValueError(f"n_terms is {n_terms}, expected at least {max(1, len(keep))}")
    if not moments.count.all():
        empty = int(np.flatnonzero(moments.count == 0)[0])
        raise IdentError(f"output {empty} has no known value; remove it or add data")
    if absent := set(keep) - set(moments.terms.names):
        raise IdentError(
            f"no term {', '.join(sorted(absent))} to keep; expected names of the {len(moments.terms)} candidate terms"
        )


def _coefficients(order: NDArray[np.intp], T: Floats, z: Floats, grams: Floats, cross: Floats) -> Floats:
    """Solve R theta = z, then refine once with the residual of the normal equations Φ'Φ theta = Φ'y."""
    n, m = len(order), cross.shape[0]
    rows, used = np.arange(n)[:, None], order >= 0
    columns = np.maximum(order, 0)
    short = np.where(used, np.matmul(T, z[:, :, None])[:, :, 0], 0.0)
    theta = np.zeros((n, m))
    np.add.at(theta, (rows, columns), short)
    product = theta @ grams[0] if len(grams) == 1 else np.matmul(grams, theta[:, :, None])[:, :, 0]
    miss = np.where(used, np.take_along_axis(cross.T - product, columns, axis=1), 0.0)
    step = np.matmul(T, np.matmul(T.transpose(0, 2, 1), miss[:, :, None]))[:, :, 0]
    np.add.at(theta, (rows, columns), np.where(used, step, 0.0))
    return theta
