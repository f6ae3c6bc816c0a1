"""Sums of terms as text, with as many digits as the sum needs; knows no model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.terms import CONSTANT, Factor, Terms
from robotmodic_ident.types import Floats

ONE = Terms.parse(CONSTANT)


def max_cancellation(digits: int) -> float:
    """Return how many times larger than the model its terms may be so that `digits` digits hold it to 1 %."""
    return 2 * 10.0 ** (digits - 3)


def total_size(
    terms: Terms, theta: Floats, scale: Scale, spans: Mapping[str, float], *, around_zero: bool
) -> float:
    """Return the sum of the largest sizes that the terms had in the fit; of those that vary.

    Parameters
    ----------
    scale : of the fit: where each variable was centred, and how far it reached from there
    spans : variable -> half its span in the fit, where the scale does not say
    around_zero : whether the terms are powers of x; else they are powers of (x - centre)
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
    """Print (numerator) / (1 + denominator); the numerator alone where the denominator is only the 1."""
    if not len(denominator):
        return numerator
    below = sum_text(ONE + denominator, np.r_[1.0, theta], digits=digits, scale=scale)
    return f"({numerator}) / ({below})"


def limited_text(text: str, limits: tuple[float, float]) -> str:
    """Print max(low, min(high, text)) as far as there are limits."""
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
    """Print a sum of terms with signs between them: `0.5*y(k-1) + u(k-2) - 0.1*(u(k-1) - 1000)^2`.

    A constant beside which the rest is small has so many more digits (`spans`: variable -> half its span).
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
    """Return how many digits each coefficient needs: a constant beside which the rest is small needs more."""
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
    """Print a factor, a power of a centred variable as `(x - centre)^2`."""
    centre = scale.pair(f.variable)[0]
    if f.function or not centre:
        return str(f)
    inner = f"({f.signal} {'+' if centre < 0 else '-'} {abs(centre):.15g})"
    return inner if f.power == 1 else f"{inner}^{f.power}"
