"""Models as text: the form in which the digits printed say what the model says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.terms import CONSTANT, Factor, Terms
from robotmodic_ident.types import Floats

if TYPE_CHECKING:
    from robotmodic_ident.model import Narmax

ONE = Terms.parse(CONSTANT)


def equation(model: Narmax, digits: int, *, scaled: bool) -> str:
    """Print a model; see `Narmax.equation`."""
    form = model if scaled else legible(model, most_of(digits))
    scale = UNSCALED if scaled else form.scale
    left = f"{form.output}(k)" if form.is_dynamic else form.output
    text = sum_text(form.terms, form.theta, digits=digits, scale=scale, spans=form.spans)
    if len(form.denominator):
        theta = np.r_[1.0, form.denominator_theta]
        below = sum_text(ONE + form.denominator, theta, digits=digits, scale=scale)
        text = f"({text}) / ({below})"
    if len(form.noise_terms):
        tail = sum_text(form.noise_terms, form.noise_theta, digits=digits, scale=scale)
        text += f" - {tail[1:]}" if tail.startswith("-") else f" + {tail}"
    return f"{left} = {text}"


def most_of(digits: int) -> float:
    """Return how much larger than the model its terms may be where `digits` digits shall hold it to 1 %."""
    return 2 * 10.0 ** (digits - 3)


def legible(model: Narmax, most: float) -> Narmax:
    """Return the form to print: in the user's units, or of (x - centre) where multiplying out would lose digits.

    `most`: how many times larger than the model itself the terms that cancel may be.
    """
    if not any(model.scale.centres):
        return model.in_user_units()
    centred = model.without_widths()
    if len(model.denominator):  # multiplied out it would have a constant below the line
        return centred
    plain = model.in_user_units()
    own, multiplied = _size(model, centred, around_0=False), _size(model, plain, around_0=True)
    return centred if multiplied > most * own else plain


def _size(model: Narmax, form: Narmax, *, around_0: bool) -> float:
    """Return the sum of the largest sizes that the terms of a form had in the fit; of what varies in them."""
    total = 0.0
    for term, theta in zip(form.terms, form.theta.tolist(), strict=True):
        if not term:
            continue
        for f in term:
            centre, width = model.scale.pair(f.variable)
            largest = model.spans.get(f.variable, width) + (abs(centre) if around_0 else 0.0)
            theta *= 1.0 if f.function else largest**f.power
        total += abs(theta)
    return total


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
    for name, value, some in zip(names, values, digits_of(terms, values, digits, spans or {}), strict=True):
        size = f"{abs(value):.{some}g}"
        body = size if name == CONSTANT else (name if size == "1" else f"{size}*{name}")
        sign = "-" if value < 0 else "+"
        parts.append(f"{sign} {body}" if parts else (f"-{body}" if value < 0 else body))
    return " ".join(parts) or "0"


def digits_of(terms: Terms, theta: Sequence[float], digits: int, spans: Mapping[str, float]) -> list[int]:
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
