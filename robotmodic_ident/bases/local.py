"""Local functions of each scaled signal: cubic B-splines, and wavelets of several resolutions.

Both give functions of single signals; `bspline(["x"], 6) * bspline(["y"], 6)` gives their products.
"""

from __future__ import annotations

from collections.abc import Sequence

from robotmodic_ident.terms import Terms

SPLINE_DEGREE = 3


def bspline(signals: Sequence[str], degree: int) -> Terms:
    """Return the constant and cubic B-splines of every signal on `degree` equal intervals of [-1, 1].

    The splines of a signal sum to 1, so the last one of each signal is left out.
    """
    if degree < 0:
        raise ValueError(f"number of intervals is {degree}, expected 0 or more")
    count = degree + SPLINE_DEGREE if degree else 1
    names = [f"B{SPLINE_DEGREE}_{i}of{count}({signal})" for signal in signals for i in range(count - 1)]
    return Terms.parse("1", *names)


def wavelet(signals: Sequence[str], degree: int) -> Terms:
    """Return the constant and Mexican-hat wavelets of every signal of levels 0 to degree - 1, wide ones first.

    Level j has 2^j + 1 shifts over [-1, 1] (multiresolution NARX: Billings and Wei 2005).
    """
    if degree < 0:
        raise ValueError(f"number of levels is {degree}, expected 0 or more")
    names = [f"W{j}_{i}({signal})" for j in range(degree) for signal in signals for i in range(2**j + 1)]
    return Terms.parse("1", *names)
