"""Differentiate and integrate a model over time or over a signal; the result is a model, or values for data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from robotmodic_ident.analysis.algebra import (
    Sum,
    antiderivative,
    collect,
    evaluate,
    partial,
    scaled,
    shifted,
    substituted,
    sum_of,
    transformed,
)
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.terms import Factor, Term
from robotmodic_ident.types import Floats


def partial_model(model: Narmax, signal: str) -> Narmax:
    """Return the derivative of the model by one signal, such as `u(k-1)`, as a model `d_y`."""
    _check_signal(model, signal)
    return transformed(model, lambda term: partial(term, signal), output=f"d_{model.output}")


def antiderivative_model(model: Narmax, signal: str) -> Narmax:
    """Return the integral of the model over one signal; its derivative by that signal is the model."""
    return transformed(model, lambda term: antiderivative(term, signal), output=f"int_{model.output}")


def derivative(model: Narmax, period: float, output: str) -> Narmax:
    """Convert a model of speed to one of acceleration: output(k) = (y(k) - y(k-1)) / period.

    A model f without past outputs becomes (f(k) - f(k-1)) / period, a model of its inputs only. A model with past
    outputs becomes (f - y(k-1)) / period, with the same past outputs. Both are exact.

    Parameters
    ----------
    period : [s] between samples
    output : name of the new output
    """
    _check_period(period, output, model.output)
    past: Term = (Factor(model.output, 1),)
    if model.output in model.terms.variables:
        return _scaled_sigma(
            transformed(
                model, lambda term: {term: 1.0 / period}, output=output, offset={past: -1.0 / period}
            ),
            period,
        )

    def change(term: Term) -> Sum:
        return collect([(term, 1.0 / period), (shifted(term, 1), -1.0 / period)])

    return _scaled_sigma(transformed(model, change, output=output), period)


def integral(model: Narmax, period: float, output: str) -> Narmax:
    """Convert a model of acceleration to one of speed: output(k) = output(k-1) + period * y(k).

    Past values of the old output become differences of the new one. This is the exact inverse of `derivative`.
    """
    _check_period(period, output, model.output)
    lags = {f.lag for term in model.terms for f in term if f.variable == model.output and f.lag}
    place: dict[str, Sum] = {
        Factor(model.output, lag).signal: {
            (Factor(output, lag),): 1.0 / period,
            (Factor(output, lag + 1),): -1.0 / period,
        }
        for lag in lags
    }
    past: Term = (Factor(output, 1),)
    result = transformed(
        model, lambda term: scaled(substituted(term, place), period), output=output, offset={past: 1.0}
    )
    return replace(result, sigma=model.sigma * period)


def jacobian(model: Narmax, signals: Sequence[str] | None = None) -> dict[str, Sum]:
    """Return the derivatives by all signals of the model, as sums of terms."""
    total = sum_of(model)
    return {
        s: collect(
            (t, value * share) for term, value in total.items() for t, share in partial(term, s).items()
        )
        for s in (signals if signals is not None else model.terms.signals)
    }


def sensitivity(model: Narmax, columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Evaluate the Jacobian for data: signal -> (n,) change of the output per unit of the signal."""
    return {s: evaluate(total, columns) for s, total in jacobian(model).items()}


def surface(
    model: Narmax, across: tuple[str, Floats], along: tuple[str, Floats], at: Mapping[str, float]
) -> Floats:
    """Evaluate the model over two of its signals with the others fixed; return (n_along, n_across) for a figure."""
    (a, u), (b, v) = across, along
    columns: dict[str, Floats] = {name: np.asarray(value, dtype=np.float64) for name, value in at.items()}
    columns |= {a: np.asarray(u, dtype=np.float64)[None, :], b: np.asarray(v, dtype=np.float64)[:, None]}
    if missing := [s for s in model.terms.signals if s not in columns]:
        raise IdentError(f"the surface needs a value for {', '.join(missing)}; give it in `at`")
    return np.broadcast_to(evaluate(sum_of(model), columns), (len(v), len(u))).copy()


def _scaled_sigma(model: Narmax, period: float) -> Narmax:
    return replace(model, sigma=model.sigma / period)


def _check_period(period: float, output: str, old: str) -> None:
    if not (np.isfinite(period) and period > 0):
        raise ValueError(f"period is {period}, expected seconds above 0")
    if output == old:
        raise ValueError(f"the new output has the name {output!r} of the old one; use another name")


def _check_signal(model: Narmax, signal: str) -> None:
    if signal not in model.terms.signals:
        raise IdentError(
            f"the model has no signal {signal}; its signals are {', '.join(model.terms.signals)}"
        )
