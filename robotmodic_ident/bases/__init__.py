"""Families of candidate terms; registry BASES. Families can be multiplied: `polynomial(...) * fourier(...)`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robotmodic_ident.bases.fourier import fourier
from robotmodic_ident.bases.local import bspline, wavelet
from robotmodic_ident.bases.orthogonal import chebyshev, legendre
from robotmodic_ident.bases.polynomial import polynomial
from robotmodic_ident.terms import Terms

BASES: dict[str, Callable[[Sequence[str], int], Terms]] = {
    "polynomial": polynomial,
    "legendre": legendre,
    "chebyshev": chebyshev,
    "fourier": fourier,
    "bspline": bspline,
    "wavelet": wavelet,
}
"""Name -> function (signals, degree) -> Terms; degree is the number of spline intervals or wavelet levels."""

__all__ = ["BASES", "bspline", "chebyshev", "fourier", "legendre", "polynomial", "wavelet"]
