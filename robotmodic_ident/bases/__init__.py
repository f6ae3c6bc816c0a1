"""Families of terms; registry BASES. Products of families: `polynomial(...) * fourier(...)`."""

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
"""Name -> (signals, degree) -> Terms; degree counts intervals of splines and levels of wavelets."""

__all__ = ["BASES", "bspline", "chebyshev", "fourier", "legendre", "polynomial", "wavelet"]
