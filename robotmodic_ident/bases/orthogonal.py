"""Products of Legendre or Chebyshev polynomials of scaled signals, with the span of `polynomial` but better conditioned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations_with_replacement

from robotmodic_ident.terms import Terms


def legendre(signals: Sequence[str], degree: int) -> Terms:
    """Return 1, P1(x), P1(y), P2(x), P1(x)*P1(y), ... up to a total degree; variables must be scaled to [-1, 1]."""
    return _products("P", signals, degree)


def chebyshev(signals: Sequence[str], degree: int) -> Terms:
    """Return 1, T1(x), T1(y), T2(x), T1(x)*T1(y), ... up to a total degree; variables must be scaled to [-1, 1]."""
    return _products("T", signals, degree)


def _products(letter: str, signals: Sequence[str], degree: int) -> Terms:
    if degree < 0:
        raise ValueError(f"degree is {degree}, expected 0 or more")
    names = ["1"]
    for total in range(1, degree + 1):
        for chosen in combinations_with_replacement(signals, total):
            names.append("*".join(f"{letter}{power}({signal})" for signal, power in Counter(chosen).items()))
    return Terms.parse(*names)
