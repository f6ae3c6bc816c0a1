"""Generalised frequency response functions H_n(omega_1, ..., omega_n) of a model with one input.

Harmonic probing (Bedrosian and Rice 1971; Billings and Peyton Jones, Int. J. Control 52, 1990) uses an input of n
exponentials, `u(k) = Σ_i exp(j omega_i k)`. A signal is stored as one amplitude Y(S) per set S of exponentials.

* For a product of signals, the amplitude is the sum over all partitions of S.
* For the output, `Y(S) = driven(S) / (1 - Σ_lag c_lag exp(-j omega lag))` with `omega = Σ_S omega_i`. Here c_lag are
  the coefficients of the linear terms y(k - lag), and driven(S) is the amplitude of all other terms.
* The result is `H_n = Y({1, ..., n}) / n!`. Sets are evaluated from small to large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robotmodic_ident.analysis.algebra import Sum, collect, evaluate, partial, substituted, sum_of
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.terms import Factor, Term

Complexes = NDArray[np.complex128]
Amplitudes = dict[frozenset[int], Complexes]


def gfrf(model: Narmax, *omegas: ArrayLike, input: str, at: tuple[float, float] = (0.0, 0.0)) -> Complexes:
    """Return H_n at n frequencies [rad/sample], n = len(omegas); the frequencies are broadcast.

    Parameters
    ----------
    input : the input; the model may have no other one
    at : (input, output) of the equilibrium about which the model is expanded
    """
    if not omegas:
        raise ValueError("there is no frequency; give one for each order")
    linear, rest = _about(model, input, at)
    w = [np.asarray(omega, dtype=np.float64) for omega in omegas]
    shape = np.broadcast_shapes(*(part.shape for part in w))
    n = len(w)
    y: Amplitudes = {}
    for size in range(1, n + 1):
        for chosen in combinations(range(n), size):
            key = frozenset(chosen)
            omega = np.broadcast_to(sum(w[i] for i in chosen), shape)
            driven = np.zeros(shape, dtype=np.complex128)
            for term, value in rest.items():
                driven = driven + value * _amplitude(_signals(term, input), key, y, w, shape)
            loop = sum((c * np.exp(-1j * omega * lag) for lag, c in linear.items()), np.zeros(shape, complex))
            y[key] = driven / (1.0 - loop)
    return np.asarray(y[frozenset(range(n))] / math.factorial(n), dtype=np.complex128)


def rest_point(model: Narmax, input: str, level: float, guess: float = 0.0) -> tuple[float, float]:
    """Return the equilibrium (input, output) for a constant input, by Newton's method from `guess`."""
    total = sum_of(model)
    y = guess
    for _ in range(100):
        columns = {f.signal: np.array(level if f.variable == input else y) for t in total for f in t}
        slope = math.fsum(
            value * float(evaluate(partial(term, s), columns))
            for term, value in total.items()
            for s in {f.signal for f in term if f.variable == model.output}
        )
        step = (float(evaluate(total, columns)) - y) / (1.0 - slope) if slope != 1.0 else np.nan
        y += step
        if abs(step) < 1e-13 * max(1.0, abs(y)):
            return level, y
    raise IdentError(f"no rest point found near {guess} at {input} = {level}; try another guess")


def _about(model: Narmax, input: str, at: tuple[float, float]) -> tuple[dict[int, float], Sum]:
    """Expand a model about an equilibrium: coefficients of y(k-i) by lag, and all other terms."""
    total = sum_of(model)
    level = {input: at[0], model.output: at[1]}
    for term in total:
        for f in term:
            if f.variable not in level or f.function:
                raise IdentError(
                    f"{f} is neither a power of {input} nor of {model.output}; a GFRF requires a model of these only"
                )
    place: dict[str, Sum] = {
        f.signal: {(f1,): 1.0, (): level[f.variable]}
        for term in total
        for f in term
        for f1 in [Factor(f.variable, f.lag or 0)]
    }
    moved = collect(
        (t, value * c) for term, value in total.items() for t, c in substituted(term, place).items()
    )
    constant = moved.pop((), 0.0) - at[1]
    size = max((abs(v) for v in moved.values()), default=1.0)
    if abs(constant) > 1e-6 * max(size, 1.0):
        raise IdentError(
            f"({at[0]:g}, {at[1]:g}) is not a rest point, the model moves by {constant:.3g}; find one with rest_point"
        )
    linear = {t[0].lag or 0: v for t, v in moved.items() if _is_linear(t, model.output)}
    return linear, {t: v for t, v in moved.items() if not _is_linear(t, model.output)}


def _is_linear(term: Term, output: str) -> bool:
    return len(term) == 1 and term[0].power == 1 and term[0].variable == output


def _signals(term: Term, input: str) -> list[tuple[bool, int]]:
    """Return (is the input, lag) of each factor, with powers as repeated factors."""
    return [(f.variable == input, f.lag or 0) for f in term for _ in range(f.power)]


def _amplitude(
    factors: Sequence[tuple[bool, int]],
    key: frozenset[int],
    y: Amplitudes,
    w: Sequence[NDArray[np.float64]],
    shape: tuple[int, ...],
) -> Complexes:
    """Return the amplitude of a product for one set of exponentials: the sum over all partitions of the set."""
    if not factors:
        return np.full(shape, 0.0 if key else 1.0, dtype=np.complex128)
    (is_input, lag), *rest = factors
    out = np.zeros(shape, dtype=np.complex128)
    most = 1 if is_input else len(key) - len(rest)
    for size in range(1, most + 1):
        for chosen in combinations(sorted(key), size):
            mine = frozenset(chosen)
            if len(key) - size < len(rest) or (not rest and size != len(key)):
                continue
            own = np.exp(-1j * lag * np.asarray(sum(w[i] for i in chosen)))
            if not is_input:
                own = own * y[mine]
            out = out + own * _amplitude(rest, key - mine, y, w, shape)
    return out
