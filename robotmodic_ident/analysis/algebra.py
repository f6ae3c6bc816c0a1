"""Algebra of sums of terms: add, multiply, shift in time, differentiate, integrate, substitute.

A `Sum` maps a term, with its factors in a fixed order, to a coefficient. All operations are exact except for rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.terms import Factor, Term, Terms, canonical_key, term_name
from robotmodic_ident.types import Floats

Sum = dict[Term, float]
ANALYSED_FUNCTIONS = ("", "cos", "sin")


def ordered(factors: Iterable[Factor]) -> Term:
    """Return the product of factors in a fixed order, with equal factors merged."""
    powers: dict[Factor, int] = {}
    for f in factors:
        base = replace(f, power=1)
        powers[base] = powers.get(base, 0) + f.power
    chosen = [replace(base, power=p) for base, p in powers.items() if p]
    return tuple(
        sorted(chosen, key=lambda f: (f.variable, -1 if f.lag is None else f.lag, f.function, f.harmonic))
    )


def sum_of(model: Narmax) -> Sum:
    """Return the deterministic part of a model in the units of the user."""
    plain = deterministic(model)
    return collect((ordered(term), float(c)) for term, c in zip(plain.terms, plain.theta, strict=True))


def deterministic(model: Narmax) -> Narmax:
    """Return a polynomial model in the units of the user without its noise terms."""
    if model.is_magnitude:
        raise IdentError(
            f"the analysis requires a polynomial; this model predicts only the magnitude of {model.output}. For the "
            "signed output, use replace(model, is_magnitude=False)"
        )
    if model.limits != UNLIMITED:
        low, high = model.limits
        raise IdentError(
            f"the analysis requires a polynomial; this model limits {model.output} to {low:g} ... {high:g}. If the "
            "limits are not reached, use replace(model, limits=(-inf, inf))"
        )
    return polynomial_part(model if len(model.denominator) else model.in_user_units())


def polynomial_part(plain: Narmax) -> Narmax:
    """Return a polynomial model without its noise terms, without conversion of units."""
    if len(plain.denominator):
        raise IdentError(
            "the analysis requires a polynomial; this model has a denominator. Fit a model without one"
        )
    k = len(plain.terms)
    for term in plain.terms:
        for f in term:
            if f.function not in ANALYSED_FUNCTIONS:
                raise IdentError(
                    f"term {term_name(term)!r} has the function {f.function!r}; "
                    "the analysis supports powers, cos and sin"
                )
    return replace(plain, covariance=plain.covariance[:k, :k], noise_terms=Terms(()), noise_theta=np.empty(0))


def collect(parts: Iterable[tuple[Term, float]]) -> Sum:
    """Add the coefficients of equal terms; terms that cancel exactly are removed."""
    total: Sum = {}
    for term, value in parts:
        total[term] = total.get(term, 0.0) + value
    return {term: value for term, value in total.items() if value != 0.0}


def plus(a: Sum, b: Sum) -> Sum:
    """Add two sums."""
    return collect([*a.items(), *b.items()])


def times(a: Sum, b: Sum) -> Sum:
    """Multiply two sums."""
    return collect((ordered(s + t), u * v) for s, u in a.items() for t, v in b.items())


def scaled(a: Sum, factor: float) -> Sum:
    """Multiply a sum by a number."""
    return collect((term, factor * value) for term, value in a.items())


def shifted(term: Term, samples: int) -> Term:
    """Increase all lags by `samples`; factors without a lag are unchanged."""
    return ordered(f if f.lag is None else replace(f, lag=f.lag + samples) for f in term)


def split(term: Term, signal: str) -> tuple[Term, Term]:
    """Return the factors of `signal`, and the other factors."""
    return tuple(f for f in term if f.signal == signal), tuple(f for f in term if f.signal != signal)


def partial(term: Term, signal: str) -> Sum:
    """Differentiate a term by one signal such as `u(k-1)`."""
    mine, rest = split(term, signal)
    out: list[tuple[Term, float]] = []
    for i, f in enumerate(mine):
        others = rest + mine[:i] + mine[i + 1 :]
        lower = (replace(f, power=f.power - 1),) if f.power > 1 else ()
        if not f.function:
            out.append((ordered(others + lower), float(f.power)))
        else:
            turned = replace(f, power=1, function="sin" if f.function == "cos" else "cos")
            sign = -1.0 if f.function == "cos" else 1.0
            out.append((ordered((*others, *lower, turned)), sign * f.power * f.harmonic))
    return collect(out)


def antiderivative(term: Term, signal: str) -> Sum:
    """Integrate a term over one signal with an integration constant of 0: u^2 becomes u^3/3, cos(u) becomes sin(u)."""
    mine, rest = split(term, signal)
    if not mine:
        (like,) = Terms.parse(signal)
        return {ordered(rest + like): 1.0}
    if len(mine) > 1 or (mine[0].function and mine[0].power > 1):
        raise IdentError(
            f"{term_name(term)!r} has no antiderivative over {signal} as a sum of such terms; integrate numerically"
        )
    (f,) = mine
    if not f.function:
        return {ordered((*rest, replace(f, power=f.power + 1))): 1.0 / (f.power + 1)}
    turned = replace(f, function="sin" if f.function == "cos" else "cos")
    return {ordered((*rest, turned)): (1.0 if f.function == "cos" else -1.0) / f.harmonic}


def substituted(term: Term, signals: Mapping[str, Sum]) -> Sum:
    """Replace each given signal by a sum; only powers of a signal can be replaced."""
    result: Sum = {(): 1.0}
    for f in term:
        if f.signal not in signals:
            result = times(result, {(f,): 1.0})
            continue
        if f.function:
            raise IdentError(f"{f} cannot be replaced by a sum; only powers of {f.signal} can")
        for _ in range(f.power):
            result = times(result, signals[f.signal])
    return result


def transformed(
    model: Narmax, change: Callable[[Term], Sum], *, output: str, offset: Sum | None = None
) -> Narmax:
    """Apply a linear transformation to every term of a model, and propagate the covariance of its coefficients.

    `offset` is added without uncertainty.
    """
    plain = deterministic(model)
    columns = [change(ordered(term)) for term in plain.terms]
    fixed = offset or {}
    names = sorted({term for column in [*columns, fixed] for term in column}, key=canonical_key)
    linear = np.array([[column.get(term, 0.0) for column in columns] for term in names]).reshape(
        len(names), -1
    )
    theta = linear @ plain.theta + np.array([fixed.get(term, 0.0) for term in names])
    covariance = linear @ plain.covariance @ linear.T
    keep = [
        i for i in range(len(names)) if abs(theta[i]) > 1e-13 * np.abs(theta).max() or covariance[i, i] > 0
    ]
    return replace(
        plain,
        output=output,
        terms=Terms(tuple(names[i] for i in keep)),
        theta=theta[keep],
        covariance=covariance[np.ix_(keep, keep)],
        err=np.full(len(keep), np.nan),
    )


def evaluate(total: Sum, columns: Mapping[str, Floats]) -> Floats:
    """Evaluate a sum for signals given by name; the columns are broadcast."""
    shape = np.broadcast_shapes(*(np.shape(values) for values in columns.values())) if columns else ()
    out = np.zeros(shape)
    for term, value in total.items():
        product = np.full(shape, value)
        for f in term:
            x = np.asarray(columns[f.signal], dtype=np.float64)
            if f.function:
                x = np.cos(f.harmonic * x) if f.function == "cos" else np.sin(f.harmonic * x)
            product = product * x**f.power
        out = out + product
    return out
