"""Functions of one scaled variable in [-1, 1] other than powers: names, values; letters as printed in terms.

`P3(x)` Legendre and `T3(x)` Chebyshev polynomials; `B3_2of8(x)` the third of eight cubic B-splines on uniform
knots; `W2_1(x)` the Mexican-hat wavelet of level 2 (four times narrower than level 0) at its second place.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev, legendre
from scipy.interpolate import BSpline

from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats

SHAPES = {"P": "Legendre polynomial", "T": "Chebyshev polynomial", "B": "B-spline", "W": "wavelet"}


def shape_name(letter: str, order: int, part: tuple[int, int]) -> str:
    """Print a shape as terms do: `P3`, `B3_2of8`, `W2_1`."""
    tail = {"B": f"_{part[0]}of{part[1]}", "W": f"_{part[0]}"}.get(letter, "")
    return f"{letter}{order}{tail}"


def check_shape(
    letter: str, has_first: bool, has_second: bool, part: tuple[int, int], order: int, text: str
) -> None:
    """Refuse a shape whose numbers do not make sense."""
    expected = {"P": (False, False), "T": (False, False), "B": (True, True), "W": (True, False)}[letter]
    if (has_first, has_second) != expected:
        example = shape_name(letter, 2, (1, 5))
        raise IdentError(f"term {text!r}: a {SHAPES[letter]} is written like {example}(x)")
    if letter == "B" and not (part[0] < part[1] and order < part[1]):
        raise IdentError(f"term {text!r}: no spline {part[0]} among {part[1]} of degree {order}")


def evaluate(letter: str, order: int, part: tuple[int, int], t: Floats) -> Floats:
    """Evaluate a shape at scaled values t (n,); outside [-1, 1] splines are 0 and polynomials grow."""
    if letter == "P":
        return np.asarray(legendre.legval(t, _unit(order)), dtype=np.float64)
    if letter == "T":
        return np.asarray(chebyshev.chebval(t, _unit(order)), dtype=np.float64)
    if letter == "W":
        r = 2.0**order * (t + 1.0) / 2.0 - part[0]
        return np.asarray((1.0 - r * r) * np.exp(-0.5 * r * r), dtype=np.float64)
    index, count = part
    x = (t + 1.0) / 2.0 * (count - order) - index + order
    element = BSpline.basis_element(np.arange(order + 2.0), extrapolate=False)
    values = np.nan_to_num(element(x), nan=0.0)
    return np.where(np.isnan(t), np.nan, np.where(np.abs(t) <= 1.0, values, 0.0))


def _unit(order: int) -> Floats:
    out = np.zeros(order + 1)
    out[order] = 1.0
    return out
