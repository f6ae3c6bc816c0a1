"""Harmonics of angles: 1, cos(phi), sin(phi), cos(2*phi), ..., which avoid the dependence cos² + sin² = 1."""

from __future__ import annotations

from collections.abc import Sequence

from robotmodic_ident.terms import Terms


def fourier(signals: Sequence[str], degree: int) -> Terms:
    """Return the constant and both harmonics of every signal [rad] up to `degree`, lower ones first."""
    if degree < 0:
        raise ValueError(f"degree is {degree}, expected 0 or more")
    names = ["1"]
    for h in range(1, degree + 1):
        inner = "" if h == 1 else f"{h}*"
        names += [f"{function}({inner}{signal})" for signal in signals for function in ("cos", "sin")]
    return Terms.parse(*names)
