"""Terms: the products of lagged signals and functions in a model, with names that can be parsed again."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.basis_functions import SHAPES, check_shape, evaluate, shape_name
from robotmodic_ident.errors import IdentError
from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.types import Floats

CONSTANT = "1"
PLAIN_FUNCTIONS = ("cos", "sin", "abs", "tanh")
"""Functions of a signal in the units of the user."""
_SIGNAL = r"(?P<variable>[A-Za-z_]\w*)(?:\(\s*k\s*(?:-\s*(?P<lag>\d+)\s*)?(?P<lagged>\)))?"
_MINUS = r"(?:\s*-\s*(?P<same>[A-Za-z_]\w*)\(\s*k\s*-\s*(?P<minus>\d+)\s*\))?"
_NUMBER = r"\d+\.?\d*(?:e[+-]?\d+)?"
_WAVE = r"(?P<wave>cos|sin|abs|tanh)\(\s*(?:(?P<times>\d+)\s*\*\s*)?"
_SHAPE = r"(?P<shape>[PTBW])(?P<order>\d+)(?:_(?P<first>\d+))?(?:of(?P<second>\d+))?\((?!\s*k\s*[-)])\s*"
_DOMAIN = rf"(?:\s*(?P<sign>[+-])\s*(?P<centre>{_NUMBER}))?\s*\)\s*/\s*(?P<width>{_NUMBER})\s*"
_FACTOR = re.compile(
    rf"\s*(?:(?:{_WAVE}|{_SHAPE})(?P<open>\()?)?{_SIGNAL}{_MINUS}(?:{_DOMAIN})?\s*(?P<close>\))?"
    r"\s*(?:\^\s*(?P<power>\d+))?\s*(?P<more>\*|$)"
)


@dataclass(frozen=True)
class Factor:
    """One signal with its lag, and the function applied to it: a power, a harmonic or another basis function."""

    variable: str
    lag: int | None = None
    """[samples]; None: a static variable, printed without `(k)`."""
    power: int = 1
    function: str = ""
    """`cos`, `sin`, `abs`, `tanh`, a letter of `basis_functions.SHAPES`, or empty."""
    harmonic: int = 1
    """Harmonic of cos and sin, degree of a polynomial or spline, or level of a wavelet."""
    part: tuple[int, int] = (0, 0)
    """Index and number of splines, or shift of a wavelet."""
    domain: tuple[float, float] | None = None
    """(centre, width) of the argument of tanh or of a basis function; None: the scale of the model applies."""
    minus: int | None = None
    """[samples] larger lag whose value is subtracted inside abs and tanh, as in the speed `abs(y(k-1)-y(k-2))`."""

    @property
    def signal(self) -> str:
        """Name of its column: `y(k-1)`, `u(k)`, `x`, `y(k-1)-y(k-2)`."""
        name = signal_name(self.variable, self.lag)
        return name if self.minus is None else f"{name}-{signal_name(self.variable, self.minus)}"

    @property
    def look_back(self) -> int:
        """[samples] largest lag of the factor."""
        return max(self.lag or 0, self.minus or 0)

    @property
    def degree(self) -> int:
        """Power of a plain signal, times the harmonic; the level of a wavelet counts from 1."""
        return self.power * (self.harmonic + (self.function == "W"))

    @property
    def width(self) -> float:
        """[units of the signal] width of a tanh, which approximates the sign of larger values."""
        return 1.0 if self.domain is None else self.domain[1]

    @property
    def is_shape(self) -> bool:
        """Return whether it is a function of the scaled variable other than a power."""
        return self.function in SHAPES

    @property
    def is_scaled(self) -> bool:
        """Return whether it uses the variable as scaled by the model."""
        return self.domain is None and self.function not in PLAIN_FUNCTIONS

    def __str__(self) -> str:
        inner = self.signal
        if self.is_shape:
            inner = f"{shape_name(self.function, self.harmonic, self.part)}({_argument(inner, self.domain)})"
        elif self.function == "tanh":
            inner = f"tanh(({inner})/{self.width!r})"
        elif self.function:
            inner = f"{self.function}({'' if self.harmonic == 1 else f'{self.harmonic}*'}{inner})"
        return inner if self.power == 1 else f"{inner}^{self.power}"


Term = tuple[Factor, ...]
Step = tuple[int | None, Factor | None, int | None, int | None]
"""(column, factor, head, tail): a factor or the constant, or the product of two earlier steps, and its column."""


def _argument(signal: str, domain: tuple[float, float] | None) -> str:
    if domain is None:
        return signal
    centre, width = domain
    return f"({signal}{'+' if centre < 0 else '-'}{abs(centre)!r})/{width!r}"


def signal_name(variable: str, lag: int | None) -> str:
    """Return the column name of a variable at a lag."""
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
        if not match or match["variable"] in PLAIN_FUNCTIONS or not _is_closed(match):
            raise IdentError(
                f"cannot read the term {text!r} at {text[position:]!r}; "
                "expected a form like y(k-1)*u(k)^2, x^2*y, cos(2*phi), P3(x), B3_0of8(x), W2_1(x) or 1"
            )
        factors.append(_factor(match, text))
        position = match.end()
        if match["more"] != "*":
            return _merged(factors)


def _is_closed(match: re.Match[str]) -> bool:
    """Return whether all brackets match and each function has a valid argument."""
    wave, is_wide = match["wave"], match["width"] is not None
    if (match["open"] is not None) != is_wide or (is_wide and wave and wave != "tanh"):
        return False
    if (is_wide and (match["sign"] is None) != (wave == "tanh")) or ((wave == "tanh") and not is_wide):
        return False
    if match["same"] and (match["same"] != match["variable"] or wave not in ("abs", "tanh")):
        return False
    if match["times"] and wave not in ("cos", "sin"):
        return False
    return bool(match["wave"] or match["shape"]) == bool(match["close"])


def _factor(match: re.Match[str], text: str) -> Factor:
    lag = int(match["lag"] or 0) if match["lagged"] else None
    power = int(match["power"] or 1)
    harmonic = int(match["order"] or match["times"] or 1)
    part = (int(match["first"] or 0), int(match["second"] or 0))
    domain = None
    if match["width"]:
        centre = float(match["sign"] + match["centre"]) * -1.0 if match["sign"] else 0.0
        domain = centre, float(match["width"])
    minus = int(match["minus"]) if match["minus"] else None
    if (minus is not None and (lag is None or minus <= lag)) or (domain and domain[1] <= 0):
        raise IdentError(
            f"term {text!r} has an invalid difference or width; expected a difference from an earlier sample, and a "
            "width above 0"
        )
    function = match["shape"] or match["wave"] or ""
    if power < 1 or (harmonic < 1 and function not in ("B", "W")):
        raise IdentError(f"term {text!r} has a power or harmonic of 0; leave that factor out")
    if match["shape"]:
        check_shape(function, match["first"] is not None, match["second"] is not None, part, harmonic, text)
    return Factor(match["variable"], lag, power, function, harmonic, part, domain, minus)


def _merged(factors: Iterable[Factor]) -> Term:
    """Merge equal factors by adding their powers, in the order of first appearance."""
    powers: dict[Factor, int] = {}
    for f in factors:
        base = replace(f, power=1)
        powers[base] = powers.get(base, 0) + f.power
    return tuple(replace(f, power=power) for f, power in powers.items())


def term_name(term: Term) -> str:
    """Return the name of a term as read by `Terms.parse`."""
    return "*".join(map(str, term)) or CONSTANT


def canonical_key(term: Term) -> tuple[int, int, int, str]:
    """Return the key that orders terms by degree, largest lag, sum of lags and name, and resolves ties."""
    lags = [f.look_back for f in term]
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
        """Parse terms from their names.

        Raises
        ------
        IdentError
            If a name is not a term, or a term is given twice.
        """
        return cls(tuple(map(_parse_term, names)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(n_terms,) printable names; `1` is the constant."""
        return tuple(map(term_name, self.table))

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """The columns of the terms, in order of first appearance."""
        return tuple(dict.fromkeys(f.signal for term in self.table for f in term))

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """The variables of the signals, without lags."""
        return tuple(dict.fromkeys(f.variable for term in self.table for f in term))

    @cached_property
    def max_lag(self) -> int:
        """[samples] largest lag of all terms."""
        return max((f.look_back for term in self.table for f in term), default=0)

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
        """Return the terms at these indices, in this order."""
        return Terms(tuple(self.table[i] for i in indices))

    def __add__(self, other: Terms) -> Terms:
        """Return the union of both sets of terms."""
        seen = {frozenset(term) for term in self.table}
        return Terms(self.table + tuple(t for t in other.table if frozenset(t) not in seen))

    def __mul__(self, other: Terms) -> Terms:
        """Multiply every term of one set by every term of the other.

        Functions of one signal are never multiplied by each other. Such products are sums of other functions of the
        family (cos² + sin² = 1), so the columns would be exactly dependent.
        """
        both = _harmonic_signals(self) & _harmonic_signals(other)
        if both:
            raise IdentError(
                f"both factors contain functions of {', '.join(sorted(both))}, whose products are exactly dependent; "
                "use one basis of a higher degree instead"
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
        """Evaluate every term.

        Parameters
        ----------
        columns : Signal (`y(k-1)`, `x`) -> (n,) values in the units of the user.
        scale : Scale of plain signals; a signal inside cos or sin stays in radians.
        n : Number of rows, required only if `columns` is empty.

        Returns
        -------
        (n, n_terms), column-major
        """
        missing = [name for name in self.signals if name not in columns]
        if missing:
            raise IdentError(f"no column {', '.join(missing)}; got {', '.join(columns) or 'none'}")
        n = len(next(iter(columns.values()))) if columns else int(n or 0)
        phi = np.empty((n, len(self)), order="F")
        values: list[Floats] = []  # of every step
        for column, factor, head, tail in self._steps:
            value = np.empty(n) if column is None else phi[:, column]
            if tail is not None and head is not None:
                np.multiply(values[head], values[tail], out=value)
            else:
                value[:] = 1.0 if factor is None else _values(factor, columns[factor.signal], scale)
            values.append(value)
        return phi

    @cached_property
    def _steps(self) -> tuple[Step, ...]:
        """Steps of the evaluation; products of leading factors, and lower powers, are computed once for all terms."""
        column: dict[Term, int] = {term: j for j, term in enumerate(self.table)}
        place: dict[Term, int] = {}
        steps: list[Step] = []

        def evaluated(term: Term) -> int:
            if term not in place:
                head, tail = _halves(term)
                parts = (None, None) if tail is None else (evaluated(head), evaluated(tail))
                factor = term[0] if term and tail is None else None
                place[term] = len(steps)
                steps.append((column.get(term), factor, *parts))
            return place[term]

        for term in self.table:
            evaluated(term)
        return tuple(steps)


def _harmonic_signals(terms: Terms) -> set[str]:
    return {f.signal for term in terms.table for f in term if f.function}


def _halves(term: Term) -> tuple[Term, Term | None]:
    """Return two terms whose product is the term; (term, None) for a single factor or the constant."""
    if len(term) > 1:
        return term[:-1], term[-1:]
    if term and term[0].power > 1:
        return (replace(term[0], power=term[0].power - 1),), (replace(term[0], power=1),)
    return term, None


def _values(f: Factor, signal: Floats, scale: Scale) -> Floats:
    """Evaluate a factor of power 1 at the values of its signal (n,)."""
    signal = np.asarray(signal, dtype=np.float64)
    if f.function in ("cos", "sin"):
        angle = f.harmonic * signal
        return np.cos(angle) if f.function == "cos" else np.sin(angle)
    if f.function in ("abs", "tanh"):
        return np.abs(signal) if f.function == "abs" else np.tanh(signal / f.width)
    if f.domain is not None:
        scaled = (signal - f.domain[0]) / f.domain[1]
    else:
        scaled = scale.apply(f.variable, signal)
    return evaluate(f.function, f.harmonic, f.part, scaled) if f.is_shape else scaled
