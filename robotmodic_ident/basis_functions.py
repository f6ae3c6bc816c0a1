"""Basis functions of one scaled variable t in [-1, 1] other than powers: names and values.

* `P3(x)`: Legendre polynomial of degree 3.
* `T3(x)`: Chebyshev polynomial of degree 3.
* `B3_2of8(x)`: Cubic B-spline with index 2, the third of eight on uniform knots.
* `W2_1(x)`: Mexican-hat wavelet (1 - r²) exp(-r² / 2), r = 2^level (t + 1) / 2 - shift, here level 2 and shift 1.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev, legendre

from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats

SHAPES = {"P": "Legendre polynomial", "T": "Chebyshev polynomial", "B": "B-spline", "W": "wavelet"}


def shape_name(letter: str, order: int, part: tuple[int, int]) -> str:
    """Return the name of a shape as printed in terms: `P3`, `B3_2of8`, `W2_1`."""
    tail = {"B": f"_{part[0]}of{part[1]}", "W": f"_{part[0]}"}.get(letter, "")
    return f"{letter}{order}{tail}"


def check_shape(
    letter: str, has_first: bool, has_second: bool, part: tuple[int, int], order: int, text: str
) -> None:
    """Reject a shape with invalid numbers."""
    expected = {"P": (False, False), "T": (False, False), "B": (True, True), "W": (True, False)}[letter]
    if (has_first, has_second) != expected:
        example = shape_name(letter, 2, (1, 5))
        raise IdentError(f"term {text!r} is not a valid {SHAPES[letter]}; expected the form {example}(x)")
    if letter == "B" and not (part[0] < part[1] and order < part[1]):
        raise IdentError(
            f"term {text!r}: there is no spline {part[0]} of {part[1]} with degree {order}; "
            "expected an index and a degree below the number of splines"
        )


def evaluate(letter: str, order: int, part: tuple[int, int], t: Floats) -> Floats:
    """Evaluate a shape at scaled values t (n,); outside [-1, 1], splines are 0 and polynomials grow."""
    if letter == "P":
        return np.asarray(legendre.legval(t, _unit(order)), dtype=np.float64)
    if letter == "T":
        return np.asarray(chebyshev.chebval(t, _unit(order)), dtype=np.float64)
    if letter == "W":
        r = 2.0**order * (t + 1.0) / 2.0 - part[0]
        return np.asarray((1.0 - r * r) * np.exp(-0.5 * r * r), dtype=np.float64)
    from scipy.interpolate import BSpline  # slow to import, and rarely needed

    index, count = part
    x = (t + 1.0) / 2.0 * (count - order) - index + order
    element = BSpline.basis_element(np.arange(order + 2.0), extrapolate=False)
    values = np.nan_to_num(element(x), nan=0.0)
    return np.where(np.isnan(t), np.nan, np.where(np.abs(t) <= 1.0, values, 0.0))


def _unit(order: int) -> Floats:
    out = np.zeros(order + 1)
    out[order] = 1.0
    return out
