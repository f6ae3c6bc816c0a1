"""Sobol indices of a model in closed form: the shares of the output variance that are due to each signal.

For independent signals, a sum of products is a finite expansion `Σ c_α Ψ_α` in an orthonormal product basis (Sudret,
Reliability Engineering & System Safety 93, 2008). The share of a set of signals is `Σ c_α²` over the basis functions of
exactly these signals, divided by `Σ c_α²` over all non-constant ones. Lagged signals of a robot are dependent. The
indices then describe the model under independent signals, and `dependence` measures the correlation in the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from robotmodic_ident.analysis.algebra import Sum, split, sum_of
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.scale import size_of
from robotmodic_ident.terms import Term
from robotmodic_ident.types import Floats

N_GAUSS_NODES = 64
"""Number of nodes of the Gauss rule, which is exact for polynomials up to degree 127, that is for powers up to 63."""


@dataclass(frozen=True)
class Distribution:
    """The distribution of one signal: `uniform` from a to b, or `normal` with mean a and standard deviation b."""

    kind: Literal["uniform", "normal"]
    a: float
    b: float

    def nodes(self) -> tuple[Floats, Floats]:
        """Return the nodes and weights (n,) of the quadrature for expectations."""
        if self.kind == "uniform":
            x, w = np.polynomial.legendre.leggauss(N_GAUSS_NODES)
            return self.a + (self.b - self.a) * (x + 1) / 2, w / w.sum()
        x, w = np.polynomial.hermite_e.hermegauss(N_GAUSS_NODES)
        return self.a + self.b * x, w / w.sum()


@dataclass(frozen=True, kw_only=True, eq=False)
class SobolIndices:
    """Shares of the variance of the output."""

    variance: float
    """[units of the output, squared] variance of the output for independent signals."""
    first: Mapping[str, float]
    """Signal -> share due to this signal alone."""
    total: Mapping[str, float]
    """Signal -> share due to this signal, including its interactions."""
    pairs: Mapping[tuple[str, str], float]
    """Two signals -> share due to their interaction."""
    dependence: float | None
    """Largest absolute correlation of two signals in the data; None if distributions were given."""

    def __str__(self) -> str:
        lines = [
            f"{s}: {100 * self.first[s]:.1f} % alone, {100 * self.total[s]:.1f} % in total"
            for s in self.first
        ]
        if self.dependence is not None and self.dependence > 0.3:
            lines.append(
                f"signals have correlations up to {self.dependence:.2f}, but the indices assume independent signals"
            )
        return "; ".join(lines)


def sobol(model: Narmax, signals: Mapping[str, Distribution] | Mapping[str, Floats]) -> SobolIndices:
    """Return the Sobol indices of one step of a model.

    Parameters
    ----------
    signals : signal such as `u(k-1)` -> its distribution, or data (n,) for a uniform distribution over their range
    """
    total = sum_of(model)
    names = model.terms.signals
    if missing := [s for s in names if s not in signals]:
        raise IdentError(f"no distribution of {', '.join(missing)}; give one for each signal of the model")
    spread, dependence = _spread(signals, names)
    coefficients = _expanded(total, names, spread)
    unit = size_of(list(coefficients.values()))
    if not np.isfinite(unit):
        raise IdentError("the values of the model overflow over these distributions; use narrower ones")
    shares: dict[frozenset[str], float] = {}
    for place, value in coefficients.items():
        key = frozenset(s for s, i in zip(names, place, strict=True) if i)
        if key:
            shares[key] = shares.get(key, 0.0) + (value / unit) ** 2
    variance = sum(shares.values())
    whole = variance if variance > 0 else 1.0
    return SobolIndices(
        variance=variance * unit * unit,
        first={s: shares.get(frozenset((s,)), 0.0) / whole for s in names},
        total={s: sum(v for key, v in shares.items() if s in key) / whole for s in names},
        pairs={(a, b): shares.get(frozenset((a, b)), 0.0) / whole for a, b in combinations(names, 2)},
        dependence=dependence,
    )


def _spread(
    signals: Mapping[str, Distribution] | Mapping[str, Floats], names: tuple[str, ...]
) -> tuple[dict[str, Distribution], float | None]:
    spread: dict[str, Distribution] = {}
    columns: list[Floats] = []
    for s in names:
        given = signals[s]
        if isinstance(given, Distribution):
            spread[s] = given
            continue
        values = np.asarray(given, dtype=np.float64)
        spread[s] = Distribution("uniform", float(np.nanmin(values)), float(np.nanmax(values)))
        columns.append(values)
    if len(columns) < 2:
        return spread, None
    table = np.stack(columns)
    table = table[:, np.isfinite(table).all(axis=0)]
    table = table[np.ptp(table, axis=1) > 0]
    if len(table) < 2:
        return spread, None
    return spread, float(np.abs(np.corrcoef(table) - np.eye(len(table))).max())


def _expanded(
    total: Sum, names: tuple[str, ...], spread: Mapping[str, Distribution]
) -> dict[tuple[int, ...], float]:
    """Return the coefficients c_α in the orthonormal product basis: one index per signal, 0 for its constant."""
    functions: dict[str, list[Term]] = {s: [()] for s in names}
    for term in total:
        for s in names:
            mine, _ = split(term, s)
            if mine not in functions[s]:
                functions[s].append(mine)
    factors = {s: _orthonormal(functions[s], spread[s]) for s in names}
    out: dict[tuple[int, ...], float] = {}
    for term, value in total.items():
        partial: dict[tuple[int, ...], float] = {(): value}
        for s in names:
            column = factors[s][:, functions[s].index(split(term, s)[0])]
            partial = {
                (*place, i): c * float(column[i])
                for place, c in partial.items()
                for i in np.flatnonzero(column).tolist()
            }
        for place, c in partial.items():
            out[place] = out.get(place, 0.0) + c
    return out


def _orthonormal(functions: list[Term], spread: Distribution) -> Floats:
    """Return R (n, n), whose column j represents function j in an orthonormal basis with the first member 1."""
    x, weight = spread.nodes()
    table = np.ones((len(x), len(functions)))
    for j, term in enumerate(functions):
        for f in term:
            value = x
            if f.function:
                value = np.cos(f.harmonic * x) if f.function == "cos" else np.sin(f.harmonic * x)
            table[:, j] *= value**f.power
    return np.asarray(np.linalg.qr(table * np.sqrt(weight)[:, None], mode="r"), dtype=np.float64)
