"""Format sums of terms as text, with as many digits as the sum requires."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.terms import CONSTANT, Factor, Terms
from robotmodic_ident.types import Floats

ONE = Terms.parse(CONSTANT)


def max_cancellation(digits: int) -> float:
    """Return the maximum ratio of cancelling terms to the model for which `digits` digits give an accuracy of 1 %."""
    return 2 * 10.0 ** (digits - 3)


def total_size(
    terms: Terms, theta: Floats, scale: Scale, spans: Mapping[str, float], *, around_zero: bool
) -> float:
    """Return the sum of the maximum magnitudes of the terms in the fit, without the constant.

    Parameters
    ----------
    scale : Centre and width of each variable in the fit.
    spans : Variable -> half its span in the fit, if this is not the width.
    around_zero : Whether the terms are powers of x; otherwise, they are powers of (x - centre).
    """
    total = 0.0
    for term, size in zip(terms, theta.tolist(), strict=True):
        if not term:
            continue
        for f in term:
            centre, width = scale.pair(f.variable)
            largest = spans.get(f.variable, width) + (abs(centre) if around_zero else 0.0)
            size *= 1.0 if f.function else largest**f.power
        total += abs(size)
    return total


def ratio_text(numerator: str, denominator: Terms, theta: Floats, *, digits: int, scale: Scale) -> str:
    """Return (numerator) / (1 + denominator) as text; only the numerator if the denominator is 1."""
    if not len(denominator):
        return numerator
    below = sum_text(ONE + denominator, np.r_[1.0, theta], digits=digits, scale=scale)
    return f"({numerator}) / ({below})"


def limited_text(text: str, limits: tuple[float, float]) -> str:
    """Return max(low, min(high, text)), without infinite limits."""
    low, high = limits
    text = text if math.isinf(high) else f"min({high:.15g}, {text})"
    return text if math.isinf(low) else f"max({low:.15g}, {text})"


def sum_text(
    terms: Terms,
    theta: Sequence[float] | Floats,
    *,
    digits: int = 6,
    scale: Scale = UNSCALED,
    spans: Mapping[str, float] | None = None,
) -> str:
    """Return a sum of terms as text: `0.5*y(k-1) + u(k-2) - 0.1*(u(k-1) - 1000)^2`.

    A constant that is much larger than the other terms has more digits (`spans`: variable -> half its span).
    """
    parts: list[str] = []
    names = ["*".join(_factor(f, scale) for f in term) or CONSTANT for term in terms]
    values = np.asarray(theta, dtype=np.float64).tolist()
    needed = significant_digits(terms, values, digits, spans or {})
    for name, value, n_digits in zip(names, values, needed, strict=True):
        size = f"{abs(value):.{n_digits}g}"
        body = size if name == CONSTANT else (name if size == "1" else f"{size}*{name}")
        sign = "-" if value < 0 else "+"
        parts.append(f"{sign} {body}" if parts else (f"-{body}" if value < 0 else body))
    return " ".join(parts) or "0"


def significant_digits(
    terms: Terms, theta: Sequence[float], digits: int, spans: Mapping[str, float]
) -> list[int]:
    """Return the number of digits of each coefficient; a constant much larger than the other terms needs more."""
    rest = sum(
        abs(value) * math.prod(spans.get(f.variable, 1.0) ** f.power for f in term)
        for term, value in zip(terms, theta, strict=True)
        if term
    )
    out = []
    for term, value in zip(terms, theta, strict=True):
        ratio = abs(value) / rest if rest and value and not term else 1.0
        out.append(min(max(digits, digits + math.floor(math.log10(ratio)) - 2), 15))
    return out


def _factor(f: Factor, scale: Scale) -> str:
    """Return a factor as text; a power of a centred variable is `(x - centre)^2`."""
    centre = scale.pair(f.variable)[0]
    if f.function or not centre:
        return str(f)
    inner = f"({f.signal} {'+' if centre < 0 else '-'} {abs(centre):.15g})"
    return inner if f.power == 1 else f"{inner}^{f.power}"
