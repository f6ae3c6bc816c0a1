"""Terms: which products of lagged signals and harmonics a model is made of, with names that parse back."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.scale import UNSCALED, Scale

Floats = NDArray[np.float64]

CONSTANT = "1"
_SIGNAL = r"(?P<variable>[A-Za-z_]\w*)(?:\(\s*k\s*(?:-\s*(?P<lag>\d+)\s*)?(?P<lagged>\)))?"
_FACTOR = re.compile(
    rf"\s*(?:(?P<function>cos|sin)\(\s*(?:(?P<harmonic>\d+)\s*\*\s*)?)?{_SIGNAL}\s*(?P<close>\))?"
    r"\s*(?:\^\s*(?P<power>\d+))?\s*(?P<more>\*|$)"
)


@dataclass(frozen=True)
class Factor:
    """One signal, its lag, and what is done to it: a power, or a harmonic."""

    variable: str
    lag: int | None = None
    """[samples]; None: a static variable, printed without `(k)`."""
    power: int = 1
    function: str = ""
    """`cos`, `sin`, or nothing."""
    harmonic: int = 1

    @property
    def signal(self) -> str:
        """The column that it reads: `y(k-1)`, `u(k)`, `x`."""
        return signal_name(self.variable, self.lag)

    @property
    def degree(self) -> int:
        """Power of a plain signal; the harmonic counts as a degree."""
        return self.power * self.harmonic

    def __str__(self) -> str:
        inner = self.signal
        if self.function:
            inner = f"{self.function}({'' if self.harmonic == 1 else f'{self.harmonic}*'}{inner})"
        return inner if self.power == 1 else f"{inner}^{self.power}"


Term = tuple[Factor, ...]


def signal_name(variable: str, lag: int | None) -> str:
    """Name the column of a variable at a lag."""
    if lag is None:
        return variable
    return f"{variable}(k)" if lag == 0 else f"{variable}(k-{lag})"


def _parse_term(text: str) -> Term:
    if text.strip() == CONSTANT:
        return ()
    factors: list[Factor] = []
    position = 0
    while True:
        match = _FACTOR.match(text, position)
        found = match and match["variable"] not in ("cos", "sin")
        if not match or not found or bool(match["function"]) != bool(match["close"]):
            raise IdentError(
                f"cannot read the term {text!r} at {text[position:]!r}; "
                "expected a form like y(k-1)*u(k)^2, x^2*y, cos(2*phi) or 1"
            )
        lag = int(match["lag"] or 0) if match["lagged"] else None
        power, harmonic = int(match["power"] or 1), int(match["harmonic"] or 1)
        if power < 1 or harmonic < 1:
            raise IdentError(f"term {text!r} has a power or harmonic of 0; leave that factor out")
        factors.append(Factor(match["variable"], lag, power, match["function"] or "", harmonic))
        position = match.end()
        if match["more"] != "*":
            return _merged(factors)


def _merged(factors: Iterable[Factor]) -> Term:
    """Add up the powers of equal factors, in the order of first appearance."""
    powers: dict[tuple[str, int | None, str, int], int] = {}
    for f in factors:
        key = (f.variable, f.lag, f.function, f.harmonic)
        powers[key] = powers.get(key, 0) + f.power
    return tuple(Factor(v, lag, power, fn, h) for (v, lag, fn, h), power in powers.items())


def term_name(term: Term) -> str:
    """Print a term as `Terms.parse` reads it."""
    return "*".join(map(str, term)) or CONSTANT


def canonical_key(term: Term) -> tuple[int, int, int, str]:
    """Order terms by degree, largest lag, sum of lags, name: the rule that resolves ties."""
    lags = [f.lag or 0 for f in term]
    return sum(f.degree for f in term), max(lags, default=0), sum(lags), term_name(term)


@dataclass(frozen=True)
class Terms:
    """An immutable table of terms."""

    table: tuple[Term, ...]

    def __post_init__(self) -> None:
        seen: dict[frozenset[Factor], Term] = {}
        for term in self.table:
            if (key := frozenset(term)) in seen:
                raise IdentError(
                    f"term {term_name(term)!r} is the same as {term_name(seen[key])!r}; give it once"
                )
            seen[key] = term

    @classmethod
    def parse(cls, *names: str) -> Terms:
        """Read terms from their names, one name a term."""
        return cls(tuple(map(_parse_term, names)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(n_terms,) printable names; `1` is the constant."""
        return tuple(map(term_name, self.table))

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """The columns that the terms read, in order of first appearance."""
        return tuple(dict.fromkeys(f.signal for term in self.table for f in term))

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """The variables behind the signals, whatever their lags."""
        return tuple(dict.fromkeys(f.variable for term in self.table for f in term))

    @cached_property
    def max_lag(self) -> int:
        """[samples] the farthest look back."""
        return max((f.lag or 0 for term in self.table for f in term), default=0)

    @cached_property
    def canonical_order(self) -> NDArray[np.intp]:
        """(n_terms,) indices that sort the terms by `canonical_key`."""
        keys = [canonical_key(term) for term in self.table]
        return np.array(sorted(range(len(keys)), key=keys.__getitem__), dtype=np.intp)

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[Term]:
        return iter(self.table)

    def __getitem__(self, indices: Iterable[int]) -> Terms:
        """Keep the terms at these indices, in this order."""
        return Terms(tuple(self.table[i] for i in indices))

    def __add__(self, other: Terms) -> Terms:
        """Unite: terms of both, each once."""
        seen = {frozenset(term) for term in self.table}
        return Terms(self.table + tuple(t for t in other.table if frozenset(t) not in seen))

    def __mul__(self, other: Terms) -> Terms:
        """Multiply every term of one with every term of the other.

        Harmonics of one variable are never multiplied with each other: such products are sums of
        other harmonics (cos² + sin² = 1), and the columns would depend on each other exactly.
        """
        both = _harmonic_signals(self) & _harmonic_signals(other)
        if both:
            raise IdentError(
                f"both factors hold harmonics of {', '.join(sorted(both))}, whose products depend on each "
                "other exactly; use one basis with more harmonics instead"
            )
        product: dict[frozenset[Factor], Term] = {}
        for a in self.table:
            for b in other.table:
                term = _merged(a + b)
                product.setdefault(frozenset(term), term)
        return Terms(tuple(product.values()))

    def matrix(
        self, columns: Mapping[str, Floats], scale: Scale = UNSCALED, *, n: int | None = None
    ) -> Floats:
        """Evaluate every term on signals given by name.

        Parameters
        ----------
        columns : signal (`y(k-1)`, `x`) -> (n,) values in the user's units
        scale : applied to plain signals; a signal inside cos or sin stays in radians
        n : count of rows, needed only where `columns` is empty

        Returns
        -------
        (n, n_terms), column-major
        """
        missing = [name for name in self.signals if name not in columns]
        if missing:
            raise IdentError(f"no column {', '.join(missing)}; got {', '.join(columns) or 'none'}")
        n = len(next(iter(columns.values()))) if columns else int(n or 0)
        phi = np.empty((n, len(self)), order="F")
        known: dict[Term, Floats] = {}  # products of leading factors are shared between terms
        for j, term in enumerate(self.table):
            if not term:
                phi[:, j] = 1.0
            else:
                phi[:, j] = _product(term, columns, scale, known)
        return phi


def _harmonic_signals(terms: Terms) -> set[str]:
    return {f.signal for term in terms.table for f in term if f.function}


def _product(term: Term, columns: Mapping[str, Floats], scale: Scale, known: dict[Term, Floats]) -> Floats:
    if term in known:
        return known[term]
    if len(term) > 1:
        head = _product(term[:-1], columns, scale, known)
        value = head * _product(term[-1:], columns, scale, known)
    else:
        (f,) = term
        if f.power > 1:
            lower = (Factor(f.variable, f.lag, f.power - 1, f.function, f.harmonic),)
            first = (Factor(f.variable, f.lag, 1, f.function, f.harmonic),)
            value = _product(lower, columns, scale, known) * _product(first, columns, scale, known)
        elif f.function:
            angle = f.harmonic * np.asarray(columns[f.signal], dtype=np.float64)
            value = np.cos(angle) if f.function == "cos" else np.sin(angle)
        else:
            value = scale.apply(f.variable, columns[f.signal])
    known[term] = value
    return value
