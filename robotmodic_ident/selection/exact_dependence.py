"""Exact dependences between candidate terms: cos² + sin² = 1, inputs of two levels, constant or doubled columns.

Such terms cannot be told apart by any data of this kind. The first in canonical order stands for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from robotmodic_ident.moments import Moments
from robotmodic_ident.terms import Factor
from robotmodic_ident.types import Floats

EXACT_TOLERANCE = 1e-13
"""Remaining share of a squared norm that is rounding of sums of products."""
MIN_RELATION_SHARE = 1e-6
"""Share of a term in a relation below which it is rounding."""


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """One term that others give exactly."""

    term: str
    on: tuple[str, ...]
    """Terms that give it; empty: it is zero in all rows."""

    def __str__(self) -> str:
        if not self.on:
            return f"{self.term} is zero in every row and was left out"
        names = ", ".join(self.on) if len(self.on) <= 4 else f"{len(self.on)} others ({self.on[0]}, ...)"
        return f"{self.term} is given exactly by {names} and was left out"


def independent(
    moments: Moments, output: str | None = None, gram: Floats | None = None
) -> tuple[NDArray[np.intp], list[Dependence]]:
    """Return the terms that do not depend on earlier ones in canonical order, and the dependences of the others.

    Terms with different powers of the past `output` are never held against each other: without noise the model
    itself ties them, and that is what is to be found. `gram` (n_terms, n_terms) replaces the shared Gram.
    """
    gram = moments.gram if gram is None else gram
    norm = np.sqrt(np.maximum(np.diagonal(gram), 0.0))
    safe = np.where(norm > 0, norm, 1.0)
    unit = gram / np.outer(safe, safe)
    families: dict[frozenset[Factor], list[int]] = {}
    for j in moments.terms.canonical_order.tolist():
        past = frozenset(f for f in moments.terms.table[j] if f.variable == output)
        families.setdefault(past, []).append(j)
    kept: list[int] = []
    found: list[Dependence] = []
    for family in families.values():
        kept += _independent(unit, norm > 0, family, moments.terms.names, found)
    return np.array(sorted(kept), dtype=np.intp), found


def _independent(
    unit: Floats, alive: NDArray[np.bool_], family: list[int], names: tuple[str, ...], found: list[Dependence]
) -> list[int]:
    """Factorise term by term; what leaves nothing new goes to `found`."""
    factor = np.zeros((len(family), len(family)))  # rows of the Cholesky factor of the kept terms
    kept: list[int] = []
    for j in family:
        k = len(kept)
        row = solve_triangular(factor[:k, :k], unit[kept, j], lower=True) if k else np.empty(0)
        left = 1.0 - row @ row
        if alive[j] and left > EXACT_TOLERANCE:
            factor[k, :k], factor[k, k] = row, np.sqrt(left)
            kept.append(j)
            continue
        shares = solve_triangular(factor[:k, :k].T, row, lower=False) if k and alive[j] else np.empty(0)
        on = tuple(names[i] for i, s in zip(kept, shares, strict=False) if abs(s) > MIN_RELATION_SHARE)
        found.append(Dependence(term=names[j], on=on))
    return kept
