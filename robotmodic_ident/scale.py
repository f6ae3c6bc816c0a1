"""Scale: centre and width of every variable, which keep sums well conditioned for any coordinate offset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats


@dataclass(frozen=True)
class Scale:
    """Map a variable v to (v - centre) / width; other variables are unchanged."""

    variables: tuple[str, ...] = ()
    centres: tuple[float, ...] = ()
    """[units of the variable]"""
    widths: tuple[float, ...] = ()
    """[units of the variable] half the span, positive."""

    def __post_init__(self) -> None:
        if not len(self.variables) == len(self.centres) == len(self.widths):
            raise ValueError(
                f"a scale has {len(self.variables)} variables, {len(self.centres)} centres and {len(self.widths)} "
                "widths; expected equal numbers"
            )
        if not (np.isfinite(self.centres).all() and np.isfinite(self.widths).all()):
            raise IdentError(
                "a scale has a centre or width that is not finite; remove the samples that cause it"
            )
        if not all(width > 0 for width in self.widths):
            raise IdentError(f"widths are {self.widths}, expected positive numbers")

    @classmethod
    def between(cls, bounds: Mapping[str, tuple[float, float]], *, centre: bool = True) -> Scale:
        """Map (low, high) of each variable to (-1, 1); without `centre`, only divide by the larger magnitude."""
        centres, widths = [], []
        for name, (low, high) in bounds.items():
            if not low <= high:
                raise IdentError(f"bounds of {name} are ({low}, {high}), expected low <= high")
            centres.append((low + high) / 2 if centre else 0.0)
            width = (high - low) / 2 if centre else max(abs(low), abs(high))
            widths.append(width if width > 0 else 1.0)
        return cls(tuple(bounds), tuple(map(float, centres)), tuple(map(float, widths)))

    @classmethod
    def of(cls, data: Mapping[str, ArrayLike], *, centre: bool = True) -> Scale:
        """Return the scale with bounds from data; values that are not finite are ignored."""
        bounds = {}
        for name, values in data.items():
            finite = np.asarray(values, dtype=np.float64)
            finite = finite[np.isfinite(finite)]
            if len(finite) == 0:
                raise IdentError(f"variable {name} has no finite value; a scale requires at least one")
            bounds[name] = (float(finite.min()), float(finite.max()))
        return cls.between(bounds, centre=centre)

    def apply(self, variable: str, values: ArrayLike) -> Floats:
        """Scale the values of one variable."""
        values = np.asarray(values, dtype=np.float64)
        if variable not in self.variables:
            return values
        centre, width = self.pair(variable)
        return (values - centre) / width

    def pair(self, variable: str) -> tuple[float, float]:
        """Return (centre, width) of a variable; (0, 1) if it is not scaled."""
        if variable not in self.variables:
            return 0.0, 1.0
        i = self.variables.index(variable)
        return self.centres[i], self.widths[i]

    def to_dict(self) -> dict[str, list[float]]:
        """Return variable -> [centre, width], for JSON."""
        rows = zip(self.variables, self.centres, self.widths, strict=True)
        return {name: [centre, width] for name, centre, width in rows}

    @classmethod
    def from_dict(cls, data: Mapping[str, tuple[float, float] | list[float]]) -> Scale:
        """Restore a scale from the data of `to_dict`."""
        pairs = [(float(centre), float(width)) for centre, width in data.values()]
        return cls(tuple(data), tuple(c for c, _ in pairs), tuple(w for _, w in pairs))


UNSCALED = Scale()


def size_of(*arrays: ArrayLike) -> float:
    """Return the largest absolute value of all arrays, or 1 if they are empty or 0, as a unit for squares.

    Squares of values above about 1e154 overflow, and those below 1e-162 underflow; squares of value / size do not.
    """
    size = max((float(np.max(np.abs(a), initial=0.0)) for a in arrays), default=0.0)
    return size or 1.0


def root_mean_square(values: Floats) -> float:
    """Return sqrt(mean(values²)) of values (n,) without overflow or underflow; nan without values."""
    if not len(values):
        return float("nan")
    size = size_of(values)
    return size * float(np.sqrt(np.mean((values / size) ** 2)))
