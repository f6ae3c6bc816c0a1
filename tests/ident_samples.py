"""Systems from the literature, written out; each with its source."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from robotmodic_ident import Moments, Scale, Terms, lagged, lags, polynomial

Signals = dict[str, np.ndarray]

CUBIC = polynomial(lags("y", 1, 2) + lags("u", 0, 2), 3)
"""56 candidates."""

# K. Z. Mao and S. A. Billings, Int. J. Control 68 (1997) 311-330, as used by many later papers
MAO_BILLINGS = {
    "y(k-1)^3": 0.2,
    "y(k-1)*u(k-1)": 0.7,
    "u(k-2)^2": 0.6,
    "y(k-2)": -0.5,
    "y(k-2)*u(k-2)^2": -0.7,
}
# L. Piroddi and W. Spinelli, Int. J. Control 76 (2003) 1767-1781: deterministic part, with its slow input below;
# also in Guo, Guo, Billings and Wei, Int. J. Systems Science 46 (2015) 776-789, which introduced iOFR
PIRODDI_SPINELLI = {"u(k-1)": 1.0, "u(k-2)": 0.5, "u(k-1)*u(k-2)": 0.25, "u(k-1)^3": -0.3}


def slow_input(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return 0.3 / (1 - 1.6 z^-1 + 0.64 z^-2) times white noise, settled."""
    return lfilter([0.3], [1, -1.6, 0.64], rng.normal(size=n + 200))[200:]


def white_input(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return white noise in [-0.8, 0.8], where the systems here are stable."""
    return rng.uniform(-0.8, 0.8, n)


def simulate(truth: dict[str, float], inputs: Signals, noise: np.ndarray, *, ma: float = 0.0) -> Signals:
    """Run y(k) = sum of terms + e(k) + ma e(k-1); inputs by name."""
    parsed = Terms.parse(*truth)
    n, start = len(noise), parsed.max_lag
    signals = {**inputs, "y": np.zeros(n)}
    rows = [
        (value, [(signals[f.variable], f.lag or 0, f.power) for f in term])
        for value, term in zip(truth.values(), parsed, strict=True)
    ]
    y = signals["y"]
    for k in range(max(start, 1), n):
        total = noise[k] + ma * noise[k - 1]
        for value, factors in rows:
            for source, lag, power in factors:
                value *= source[k - lag] ** power
            total += value
        y[k] = total
    return signals


def moments_of(record: Signals, terms: Terms, output: str = "y") -> Moments:
    """Return moments with variables divided by their size."""
    rows = lagged(record, terms, [output])
    scale = Scale.of({v: record[v] for v in terms.variables}, centre=False)
    return Moments(terms, 1, scale=scale).add(rows.columns, rows.targets)


def exact(found: Terms, truth: dict[str, float]) -> bool:
    """Tell whether the terms are the true ones, no more and no less."""
    return {frozenset(t) for t in found} == {frozenset(t) for t in Terms.parse(*truth)}


Input = Callable[[np.random.Generator, int], np.ndarray]
