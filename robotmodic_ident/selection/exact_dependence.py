"""Exact dependences of candidate terms: cos² + sin² = 1, inputs with two levels, constant or duplicate columns.

Data of this kind cannot distinguish such terms. The first terms in canonical order are kept.
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
"""Remaining share of a squared norm up to which it is rounding of sums of products."""
MIN_RELATION_SHARE = 1e-6
"""Minimum coefficient of a term in a dependence; smaller ones are rounding."""


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """A term that is an exact linear combination of others."""

    term: str
    on: tuple[str, ...]
    """Terms of the linear combination; empty: the term is zero in all rows."""

    def __str__(self) -> str:
        if not self.on:
            return f"{self.term} is zero in every row and was left out"
        names = ", ".join(self.on) if len(self.on) <= 4 else f"{len(self.on)} others ({self.on[0]}, ...)"
        return f"{self.term} is an exact combination of {names} and was left out"


def independent(
    moments: Moments, output: str | None = None, gram: Floats | None = None
) -> tuple[NDArray[np.intp], list[Dependence]]:
    """Return the terms that are independent of earlier ones in canonical order, and the dependences of the others.

    Terms with different powers of the past `output` are never compared. Without noise, the model to identify is itself
    a dependence between them. `gram` (n_terms, n_terms) replaces the shared Gram matrix.
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
    """Extend a Cholesky factorisation term by term; dependent terms are appended to `found`."""
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
