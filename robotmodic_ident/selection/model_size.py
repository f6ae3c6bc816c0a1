"""Select the terms of each size by forward selection, restart or exchange, and the size by a criterion or by folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.moments import Moments
from robotmodic_ident.selection.criteria import INFORMATION, Criterion, Stop, information, penalties
from robotmodic_ident.selection.exchange import search as search_sets
from robotmodic_ident.selection.forward import SelectionPath, forward
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

Search = Literal["forward", "restart", "exchange"]
EXTRA_SIZES = 8
"""Number of larger sizes that exchange also searches; removing terms reaches sets that adding terms does not."""


@dataclass(frozen=True)
class SizeSearch:
    """The settings of a selection, and the search for the best model of every size."""

    terms: Terms
    n_max: int
    criterion: Criterion
    n_terms: int | None
    err_tol: float
    keep: tuple[str, ...]
    search: Search

    @property
    def first(self) -> list[int]:
        """Indices of the terms selected first."""
        return [self.terms.names.index(name) for name in self.keep]

    def path(
        self,
        grams: Floats,
        cross: Floats,
        power: Floats,
        count: NDArray[np.int64],
        sizes: NDArray[np.intp] | None = None,
    ) -> tuple[SelectionPath, NDArray[np.intp], list[Stop]]:
        """Return the order of selection, the number of terms to keep, and the reason for that number."""
        order = self.terms.canonical_order
        if self.search == "forward":
            path = forward(grams, cross, power, self.n_max, order, self.first)
            return path, *self._cut(_unexplained(path, power), count, sizes)
        rest, sets = self.best_sets(grams, cross, power, count)
        size, why = self._cut(rest, count, sizes)
        chosen = np.take_along_axis(sets, size[:, None, None], axis=1)[:, 0]
        path = forward(grams, cross, power, self.n_max, order, self.first, None, chosen)
        return path, np.minimum(size, (path.order >= 0).sum(axis=1)), why

    def best_sets(
        self, grams: Floats, cross: Floats, power: Floats, count: NDArray[np.int64]
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the least unexplained share (n, n_max + 1) and the terms (n, n_max + 1, m) of every size."""
        n, m = len(power), len(self.terms)
        order = self.terms.canonical_order  # the search uses the first of equal terms
        locked = np.zeros(m, dtype=np.bool_)
        locked[self.first] = True
        criterion = self.criterion if self.criterion in INFORMATION else "bic"
        cost = penalties(criterion, min(m, self.n_max + EXTRA_SIZES), m, count)
        rest, sets = search_sets(
            np.ascontiguousarray(grams[:, order][:, :, order]),
            np.ascontiguousarray(cross[order]),
            power,
            np.zeros(n, dtype=np.int64) if len(grams) == 1 else np.arange(n),
            locked[order],
            np.ones(m, dtype=np.bool_),
            cost,
            count.astype(np.float64),
            self.search == "exchange",
            self.search == "restart",
        )
        back = np.empty_like(sets)
        back[:, :, order] = sets
        return rest[:, : self.n_max + 1], back[:, : self.n_max + 1]

    def _cut(
        self, rest: Floats, count: NDArray[np.int64], sizes: NDArray[np.intp] | None
    ) -> tuple[NDArray[np.intp], list[Stop]]:
        """Return the number of terms to keep (n,) from the unexplained share of each size, and the reason."""
        k = np.arange(self.n_max + 1)
        exists = np.isfinite(rest) & (k >= len(self.keep)) & (k >= 1)
        steps = np.where(exists, k, 0).max(axis=1)  # (n,)
        if sizes is not None:
            size, reached = np.minimum(sizes, steps), sizes <= steps
        elif self.criterion == "n_terms":
            size, reached = steps, steps == min(self.n_terms or self.n_max, self.n_max)
        elif self.criterion == "err_tol":
            below = (rest < self.err_tol) & exists
            reached = below.any(axis=1)
            size = np.where(reached, below.argmax(axis=1), steps)
        else:
            cost = penalties(self.criterion, self.n_max, len(self.terms), count)
            affordable = exists & (k <= np.maximum(count // 2, len(self.keep) + 1)[:, None])
            value = information(np.where(exists, rest, 1.0), cost, count)
            size = np.where(affordable, value, np.inf).argmin(axis=1)
            reached = size < steps
        return size.astype(np.intp), [self.criterion if hit else "exhausted" for hit in reached]


def _unexplained(path: SelectionPath, power: Floats) -> Floats:
    """Return the unexplained share of Y'Y after 0, 1, ... steps (n, n_max + 1); inf for missing steps."""
    safe = np.where(power > 0, power, 1.0)[:, None]
    rest = 1.0 - np.cumsum(path.gain**2, axis=1) / safe
    rest = np.where(path.order >= 0, rest, np.inf)
    return np.concatenate([np.ones((len(rest), 1)), rest], axis=1)


def cross_validated(size_search: SizeSearch, moments: Moments, folds: Sequence[Moments]) -> NDArray[np.intp]:
    """Return the size (n_outputs,) with the least squared error on held-out folds."""
    total = np.zeros((moments.n_outputs, size_search.n_max + 1))
    for fold in folds:
        train = moments - fold
        if not train.count.all():
            raise IdentError("an output is known only within one fold; use fewer or other folds")
        for i in range(moments.n_outputs):
            gram, cross = train.gram_of(i), train.cross[:, [i]]
            part, value = fold.gram_of(i), fold.cross[:, i]
            sets = _prefixes(size_search, gram, cross, train.power[[i]], train.count[[i]])
            for k, chosen in enumerate(sets):
                if chosen is None:
                    total[i, k] = np.inf
                    continue
                theta = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], cross[chosen, 0], rcond=None)[0]
                miss = theta @ part[np.ix_(chosen, chosen)] @ theta - 2.0 * theta @ value[chosen]
                total[i, k] += miss + fold.power[i]
    total = np.maximum(total, 64 * total.shape[1] * np.finfo(np.float64).eps * moments.power[:, None])
    total[:, : max(1, len(size_search.keep))] = (
        np.inf
    )  # among errors that are rounding, the smallest model wins
    return np.asarray(total.argmin(axis=1), dtype=np.intp)


def _prefixes(
    size_search: SizeSearch, gram: Floats, cross: Floats, power: Floats, count: NDArray[np.int64]
) -> list[NDArray[np.intp] | None]:
    """Return the terms of every size from 0 for one output; None for missing sizes."""
    if size_search.search == "forward":
        path = forward(
            gram[None], cross, power, size_search.n_max, size_search.terms.canonical_order, size_search.first
        )
        order = path.order[0]
        return [order[:k] if k == 0 or order[k - 1] >= 0 else None for k in range(size_search.n_max + 1)]
    rest, sets = size_search.best_sets(gram[None], cross, power, count)
    return [
        np.flatnonzero(some) if np.isfinite(value) else None
        for value, some in zip(rest[0], sets[0], strict=True)
    ]
