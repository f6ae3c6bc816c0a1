"""All monomials of the given signals up to a total degree."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement

from robotmodic_ident.terms import Terms


def polynomial(signals: Sequence[str], degree: int) -> Terms:
    """Return the constant and all monomials up to `degree`, lower degrees first.

    `polynomial(["x", "y"], 2)` is 1, x, y, x^2, x*y, y^2. Lagged signals are written as `y(k-1)`.
    """
    if degree < 0:
        raise ValueError(f"degree is {degree}, expected 0 or more")
    names = ["1"]
    for total in range(1, degree + 1):
        names += ["*".join(chosen) for chosen in combinations_with_replacement(signals, total)]
    return Terms.parse(*names)
