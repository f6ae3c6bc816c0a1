"""Convert a polynomial of scaled variables to one of the variables of the user, in exact arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from math import comb

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Factor, Term, Terms, canonical_key
from robotmodic_ident.types import Floats

Polynomial = dict[Term, Fraction]


def expand(terms: Terms, theta: Sequence[float] | Floats, scale: Scale) -> tuple[Terms, Floats, Floats]:
    """Multiply out ((v - centre) / width)^power in every term and collect equal terms.

    The arithmetic is rational, so each coefficient is exact to the last bit. Far from the origin, the evaluation of the
    expanded form suffers from cancellation, unlike the scaled form.

    Returns
    -------
    Terms in the variables of the user; theta (n,); map (n, len(terms)) from scaled to expanded coefficients.
    If variables are only divided by a width, the terms keep their order and the map is diagonal.
    A spline, wavelet or orthogonal polynomial remains one function, with its domain in its name.
    """
    total: Polynomial = {}
    names: dict[frozenset[Factor], Term] = {}
    entries: list[tuple[Term, int, float]] = []
    for j, (term, coefficient) in enumerate(zip(terms, theta, strict=True)):
        for product, share in _expand_term(term, scale).items():
            key = names.setdefault(frozenset(product), product)
            total[key] = total.get(key, Fraction(0)) + Fraction(float(coefficient)) * share
            entries.append((key, j, _to_float(share)))
    ordered = list(total) if not any(scale.centres) else sorted(total, key=canonical_key)
    place = {term: i for i, term in enumerate(ordered)}
    linear = np.zeros((len(ordered), len(terms)))
    for key, j, value in entries:
        linear[place[key], j] += value
    return Terms(tuple(ordered)), np.array([_to_float(total[t]) for t in ordered]), linear


def _to_float(value: Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        raise IdentError(
            "a coefficient in the units of the user is too large; use units in which the data are near 1"
        ) from None


def _expand_term(term: Term, scale: Scale) -> Polynomial:
    result: Polynomial = {(): Fraction(1)}
    for f in term:
        centre, width = map(Fraction, scale.pair(f.variable))
        if f.is_shape and f.domain is None and f.variable in scale.variables:
            f = replace(f, domain=scale.pair(f.variable))
        if f.function or (centre == 0 and width == 1):
            powers: dict[int, Fraction] = {f.power: Fraction(1)}
        else:
            p = f.power
            shift: list[Fraction] = [Fraction(1)]
            for _ in range(p):
                shift.append(-centre * shift[-1])
            down = Fraction(1, 1)
            for _ in range(p):
                down /= width
            powers = {i: comb(p, i) * shift[p - i] * down for i in range(p + 1)}
        result = {
            head + ((replace(f, power=i),) if i else ()): value * factor
            for head, value in result.items()
            for i, factor in powers.items()
            if factor
        }
    return result


def unscaled(terms: Terms, scale: Scale) -> tuple[Terms, Floats]:
    """Return the terms without widths, and the factor (n_terms,) on each coefficient.

    Basis functions keep their scale as a domain in their name. Powers of the width are moved to the factor.
    """
    table, factors = [], []
    for term in terms:
        moved, factor = [], 1.0
        for f in term:
            if f.is_shape and f.domain is None and f.variable in scale.variables:
                f = replace(f, domain=scale.pair(f.variable))
            elif not f.function:
                factor /= scale.pair(f.variable)[1] ** f.power
            moved.append(f)
        table.append(tuple(moved))
        factors.append(factor)
    return Terms(tuple(table)), np.array(factors, dtype=np.float64)
