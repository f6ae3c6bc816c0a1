"""Families of terms, one file each; registry BASES. Products of families: `polynomial(...) * fourier(...)`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robotmodic_ident.bases.fourier import fourier
from robotmodic_ident.bases.polynomial import polynomial
from robotmodic_ident.terms import Terms

BASES: dict[str, Callable[[Sequence[str], int], Terms]] = {
    "polynomial": polynomial,
    "fourier": fourier,
}
"""Name -> (signals, degree) -> Terms."""

__all__ = ["BASES", "fourier", "polynomial"]
